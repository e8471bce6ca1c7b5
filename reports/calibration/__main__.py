"""`python -m reports.calibration`: whether fits find the values that studies were drawn from."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from percept.provenance import made_by
from percept.workers import processes
from reports.calibration.fits import PLANS, WRONG_SHARE, page, place_study, verdicts_json
from reports.calibration.uniformity import Calibration, calibrate
from reports.command import run, say, write_page


def main(words: Sequence[str] | None = None) -> int:
    """Fit what is not kept yet, and write the page of one part."""
    parser = argparse.ArgumentParser("python -m reports.calibration", description=__doc__)
    parser.add_argument("part", choices=tuple(PLANS), help="the page to make")
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--fits", type=int, default=300, help="studies of each kind (300)")
    parser.add_argument("--kinds", nargs="+", help="of studies (all)")
    parser.add_argument("--workers", type=int, default=1, help="processes (1)")
    return run(parser, _run, words)


def _run(arguments: argparse.Namespace) -> None:
    out = arguments.out
    calibrations = _calibrated(arguments)
    write_page(out / f"{arguments.part}.json", verdicts_json(calibrations))
    write_page(out / f"{arguments.part}.md", page(calibrations, made_by(arguments.typed)))


def _calibrated(arguments: argparse.Namespace) -> list[Calibration]:
    """Judge every kind of study of a part."""
    calibrations = []
    mapper = processes(arguments.workers)
    for plan in PLANS[arguments.part]:
        if arguments.kinds and plan.name not in arguments.kinds:
            continue
        calibrations.append(
            calibrate(
                plan,
                place_study,
                arguments.fits // WRONG_SHARE if plan.wrong else arguments.fits,
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
