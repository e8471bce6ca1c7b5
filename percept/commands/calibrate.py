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
_METHODS = {"both": ("classical", "bayesian")}
_REFITTED = {"classical": "the classical method", "bayesian": "the Bayesian one to a tolerance of {:g} %"}
_HEAD = """# Coverage

All studies behind this table are simulated: with the references of {paths}, {trials},
and {source}, refitted by {methods}. Curves are those of a device of {mass:g} kg and
{damping:g} N·s/m at a period of {period:g} s, at {points} frequencies from {low:g} to {high:g} rad/s.
Of the scene's other settings level, share, confidence, family, method and seed are kept; `[model]`,
modes and hold are not.

`stated` is what the interval or boundary claims. `real` is the fraction of the claims that were true, over
environments and parameters together. ± is its standard error over the studies, which is the binomial one
where a study has one claim. Normal intervals of lognormal users, and the other way round, show what
the wrong family costs. A study of normal users in which a value is not positive has no lognormal row, so
`studies` can be few.

"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    parser.add_argument("--studies", type=int, default=100, metavar="N", help="studies per design (100)")
    parser.add_argument(
        "--classical",
        type=int,
        metavar="N",
        help="of the classical method alone (--studies)",
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="begin no more studies after so long")
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
    import time

    import pandas as pd

    from percept.calibration.coverage import FILE, coverage, coverage_markdown, gather
    from percept.workers import open_mapper

    out = Path(arguments.out)
    plans = _plans(arguments, out)
    shared: dict[str, Any] = {"progress": Counting("studies", shown=not arguments.quiet)}
    with open_mapper(arguments.workers, arguments.scheduler) as mapper:
        shared["mapper"] = mapper
        if arguments.advice:
            table = gather(tuple(plans), out / "judged.jsonl", **shared)
            table.to_csv(out / FILE, index=False)
            print(out / FILE)
            return 0
        rows = []
        stop = None if arguments.seconds is None else time.monotonic() + arguments.seconds
        for done, plan in enumerate(plans):
            # Every plan has an equal share of the time that is left.
            left = None if stop is None else (stop - time.monotonic()) / (len(plans) - done)
            classical = arguments.classical if plan.method == "classical" else None
            studies = arguments.studies if classical is None else classical
            rows += coverage(plan, studies, checkpoint=out / "judged.jsonl", seconds=left, **shared)
    rows.sort(key=lambda row: (row.truth, row.subjects))
    methods = dict.fromkeys(plan.method for plan in plans)
    out.mkdir(parents=True, exist_ok=True)
    head = _HEAD.format(
        paths=" ".join(Path(path).name for path in arguments.sessions),
        trials="one trial each" if arguments.subjects else "its subjects and trials",
        source=_SOURCES[arguments.source],
        methods=" and ".join(_REFITTED[name] for name in methods).format(100 * plans[0].tolerance),
        mass=plans[0].device[0],
        damping=plans[0].device[1],
        period=plans[0].period,
        low=plans[0].frequencies[0],
        high=plans[0].frequencies[1],
        points=plans[0].frequencies[2],
    )
    (out / "coverage.md").write_text(head + coverage_markdown(rows), encoding="utf-8")
    pd.DataFrame([dataclasses.asdict(row) for row in rows]).to_csv(out / "coverage.csv", index=False)
    print(out / "coverage.md")
    return 0


def _plans(arguments: argparse.Namespace, out: Path) -> list[CoveragePlan]:
    """Plan studies of each number of subjects and distribution of users, for each method by itself."""
    from percept.calibration.coverage import advice_plans, kept_values, plan_like, refuse_unfit

    with Working("fitting the truth", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        refuse_unfit(study)
        if arguments.advice:
            return list(advice_plans(study))
        values = kept_values(study, out) if arguments.source == "fit" else None
    return [
        plan_like(study, subjects, truth=truth, values=values, method=method)
        for method in _METHODS.get(study.scene.inference.method, (study.scene.inference.method,))
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
