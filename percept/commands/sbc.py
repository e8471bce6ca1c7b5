"""Simulation-based calibration: whether fits find the values that studies were simulated from."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from percept.commands.analysis import add_worker_arguments
from percept.errors import UsageError

EXAMPLE = "percept sbc --fits 1000 --out reports/calibration"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--fits", type=int, default=100, metavar="N", help="fits per design (100)")
    parser.add_argument(
        "--designs", nargs="+", metavar="NAME", help="designs (all); verdicts on others in DIR stay"
    )
    parser.add_argument("--fault", default="none", metavar="NAME", help="a deliberate error to catch (none)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the studies (1)")
    add_worker_arguments(parser)
    parser.add_argument("--seconds", type=float, metavar="S", help="hand out no more fits after so long")
    parser.add_argument(
        "--out", default="calibration", metavar="DIR", help="folder to write into (calibration)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write DIR/sbc.json and DIR/sbc.md; an interrupted run goes on from DIR/fits.jsonl."""
    from percept.calibration.placing import SBC_DESIGNS
    from percept.calibration.sbc import calibrate_designs, write_calibrations
    from percept.workers import open_mapper

    def told(design: str, done: int, fits: int) -> None:
        if sys.stderr.isatty():
            print(f"\r{design}: {done} of {fits} fits ", end="", file=sys.stderr, flush=True)

    if arguments.seed < 0:
        raise UsageError("a seed is not negative.", key="--seed", value=arguments.seed)
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    with open_mapper(arguments.workers, arguments.scheduler) as mapper:
        calibrations = calibrate_designs(
            arguments.fits,
            designs=tuple(arguments.designs or SBC_DESIGNS),
            fault=arguments.fault,
            seed=arguments.seed,
            mapper=mapper,
            checkpoint=out / "fits.jsonl",
            seconds=arguments.seconds,
            progress=told,
        )
    write_calibrations(calibrations, out)
    print(out / "sbc.md")
    return 0
