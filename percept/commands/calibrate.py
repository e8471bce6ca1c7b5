"""Simulate studies like yours, refit them, and report the real coverage of every interval and boundary."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from percept.commands import Command
from percept.commands.analysis import (
    Counting,
    Working,
    add_analysis_arguments,
    add_worker_arguments,
    open_study,
)
from percept.errors import UsageError

if TYPE_CHECKING:
    from percept.calibration.judge import CoveragePlan

EXAMPLE = "percept calibrate sessions.csv --studies 200 --subjects 3 10 30 --out reports/coverage"

_SOURCES = {"fit": "the values fitted to it", "prior": "the prior"}
_METHODS = {
    "both": "both methods (the posterior to a tolerance of {:g} %)", "classical": "the classical method",
}  # fmt: skip
_HEAD = """# Coverage

All studies behind this table are simulated: with the references of {paths}, {trials},
and {source}, refitted by {methods}. Curves are those of a device of {mass:g} kg and
{damping:g} N·s/m at a period of {period:g} s. Of the scene's other settings level, share, confidence,
family, method and seed are kept; `[model]`, modes and hold are not. `real` is the
share of them in which the claim held, over environments and parameters together,
in per cent with its standard error; `stated` is what the interval or boundary claims. Normal intervals
of lognormal users, and the other way round, show what the wrong family costs; a study of normal users
in which somebody's value is not positive has no lognormal row, so `studies` can be few.

"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    parser.add_argument("--studies", type=int, default=100, metavar="N", help="studies per design (100)")
    parser.add_argument("--subjects", type=int, nargs="+", metavar="N", help="subjects (the study's own)")
    parser.add_argument(
        "--from", dest="source", choices=("fit", "prior"), default="fit", help="simulate from (fit)"
    )
    parser.add_argument(
        "--truth",
        nargs="+",
        choices=("lognormal", "normal"),
        default=["lognormal"],
        help="distribution of the simulated users (lognormal); the family of the model is --family",
    )
    parser.add_argument(
        "--advice",
        action="store_true",
        help="simulate what percept compare recommends a method by (half an hour on two cores)",
    )
    add_worker_arguments(parser)
    parser.add_argument("--out", default="coverage", metavar="DIR", help="folder to write into (coverage)")


def run(arguments: argparse.Namespace) -> int:
    """Write DIR/coverage.md and DIR/coverage.csv; an interrupted run goes on from DIR/judged.jsonl."""
    import dataclasses

    import pandas as pd

    from percept.calibration.coverage import FILE, coverage, coverage_markdown, gather
    from percept.workers import open_mapper

    out = Path(arguments.out)
    plans = _plans(arguments)

    told = Counting("studies", shown=not arguments.quiet)
    with open_mapper(arguments.workers, arguments.scheduler) as mapper:
        asked: dict[str, Any] = {"mapper": mapper, "progress": told}
        if arguments.advice:
            table = gather(tuple(plans), out / "judged.jsonl", **asked)
            table.to_csv(out / FILE, index=False)
            print(out / FILE)
            return 0
        kept = out / "judged.jsonl"
        rows = [row for plan in plans for row in coverage(plan, arguments.studies, checkpoint=kept, **asked)]
    out.mkdir(parents=True, exist_ok=True)
    head = _HEAD.format(
        paths=" ".join(Path(path).name for path in arguments.sessions),
        trials="one trial each" if arguments.subjects else "its subjects and trials",
        source=_SOURCES[arguments.source],
        methods=_METHODS[plans[0].method].format(100 * plans[0].tolerance),
        mass=plans[0].device[0],
        damping=plans[0].device[1],
        period=plans[0].period,
    )
    (out / "coverage.md").write_text(head + coverage_markdown(rows), encoding="utf-8")
    pd.DataFrame([dataclasses.asdict(row) for row in rows]).to_csv(out / "coverage.csv", index=False)
    print(out / "coverage.md")
    return 0


def _plans(arguments: argparse.Namespace) -> list[CoveragePlan]:
    from percept.calibration.coverage import advice_plans, fitted_values, plan_like, refuse_unfit

    with Working("fitting the truth", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        refuse_unfit(study)
        if arguments.advice:
            return list(advice_plans(study))
        values = fitted_values(study) if arguments.source == "fit" else None
    method = "classical" if study.scene.inference.method == "classical" else "both"
    return [
        plan_like(study, subjects, truth=truth, values=values, method=method)
        for subjects in arguments.subjects or [None]
        for truth in arguments.truth
    ]


def _add_sbc(parser: argparse.ArgumentParser) -> None:
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


def _run_sbc(arguments: argparse.Namespace) -> int:
    """Write DIR/sbc.json and DIR/sbc.md; an interrupted run goes on from DIR/fits.jsonl."""
    from percept.calibration.placing import SBC_DESIGNS
    from percept.calibration.sbc import calibrate_designs, write_calibrations
    from percept.workers import open_mapper

    count = Counting("fits", shown=True)
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
            progress=lambda design, done, fits: count(done, fits, design),
        )
    write_calibrations(calibrations, out)
    print(out / "sbc.md")
    return 0


SBC = Command(
    "Simulation-based calibration: whether fits find the values that studies were simulated from.",
    "percept sbc --fits 1000 --out reports/calibration",
    _add_sbc,
    _run_sbc,
)
