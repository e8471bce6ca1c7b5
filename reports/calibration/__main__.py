"""`python -m reports.calibration`: whether fits find the values that studies were drawn from."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from percept.provenance import made_by
from percept.workers import processes
from reports.calibration import factor_peers, factors, sbc
from reports.calibration.uniformity import Calibration, Place, Plan, calibrate
from reports.command import run, say, write_page

_PLANS = {"sbc": tuple(Plan(kind=name) for name in sbc.DESIGNS), "factors": factors.PLANS}
_PLACES: dict[str, Place] = {"sbc": sbc.place_study, "factors": factors.place_study}


def main(words: Sequence[str] | None = None) -> int:
    """Fit what is not kept yet, and write the page of one part."""
    parser = argparse.ArgumentParser("python -m reports.calibration", description=__doc__)
    parser.add_argument("part", choices=("sbc", "factors", "peers"), help="the page to make")
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--fits", type=int, default=300, help="studies of each kind (300)")
    parser.add_argument("--kinds", nargs="+", help="of studies (all)")
    parser.add_argument("--workers", type=int, default=1, help="processes (1)")
    parser.add_argument("--draws", type=int, default=4000, help="of peers, of each chain (4000)")
    return run(parser, _run, words)


def _run(arguments: argparse.Namespace) -> int:
    out = arguments.out
    if arguments.part == "peers":
        differ, text = factor_peers.compared(arguments.draws, out, arguments.typed)
        write_page(out / "factors_peers.md", text)
        return int(differ)
    calibrations = _calibrated(arguments)
    made = made_by(arguments.typed)
    if arguments.part == "factors":
        write_page(out / "factors.md", factors.page(calibrations, arguments.fits, made))
    else:
        write_page(out / "sbc.json", sbc.verdicts_json(calibrations))
        write_page(out / "sbc.md", sbc.page(calibrations, made))
    return 0


def _calibrated(arguments: argparse.Namespace) -> list[Calibration]:
    """Judge every kind of study of a part."""
    calibrations = []
    mapper = processes(arguments.workers)
    for plan in _PLANS[arguments.part]:
        if arguments.kinds and plan.name not in arguments.kinds:
            continue
        calibrations.append(
            calibrate(
                plan,
                _PLACES[arguments.part],
                arguments.fits // factors.WRONG_SHARE if plan.wrong else arguments.fits,
                folder=arguments.out,
                mapper=mapper,
                progress=_progress(plan.name),
            )
        )
    return calibrations


def _progress(name: str) -> Callable[[int, int], None]:
    return lambda done, fits: say(f"{name}: {done} of {fits}")


if __name__ == "__main__":
    sys.exit(main())
