"""Simulate studies like yours, refit them, and report the real coverage of every interval and boundary."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands.analysis import Working, add_analysis_arguments, add_worker_arguments, open_study

if TYPE_CHECKING:
    from percept.calibration.judge import CoveragePlan

# What curves are drawn for where the scene has no rigid device: kg, N·s/m and s.
_DEVICE, _PERIOD = (1.0, 5.0), 0.001
EXAMPLE = "percept calibrate sessions.csv --studies 200 --subjects 3 10 30 --out reports/coverage"

_SOURCES = {"fit": "the values fitted to it", "prior": "the prior"}
_METHODS = {
    "both": "both methods (the posterior to a tolerance of {:g} %)", "classical": "the classical method",
}  # fmt: skip
_HEAD = """# Coverage

All studies behind this table are simulated: with the subjects and references of {paths}, one trial each,
and {source}, refitted by {methods}. Curves are those of a device of {mass:g} kg and
{damping:g} N·s/m at a period of {period:g} s. Of the scene's other settings level, share, confidence,
family, method and seed are kept; `[model]`, modes, hold, missing cells and repeats are not. `real` is the
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
    add_worker_arguments(parser)
    parser.add_argument("--out", default="coverage", metavar="DIR", help="folder to write into (coverage)")


def run(arguments: argparse.Namespace) -> int:
    """Write DIR/coverage.md and DIR/coverage.csv; an interrupted run goes on from DIR/judged.jsonl."""
    import dataclasses

    import pandas as pd

    from percept.calibration.coverage import coverage, coverage_markdown
    from percept.workers import open_mapper

    out = Path(arguments.out)
    plans = _plans(arguments)
    rows = []
    with open_mapper(arguments.workers, arguments.scheduler) as mapper:
        for plan in plans:
            name = f"n = {plan.subjects}, {plan.truth} users"

            def told(done: int, studies: int, name: str = name) -> None:
                if not arguments.quiet and sys.stderr.isatty():
                    print(f"\r{name}: {done} of {studies} studies ", end="", file=sys.stderr, flush=True)

            rows += coverage(
                plan, arguments.studies, mapper=mapper, checkpoint=out / "judged.jsonl", progress=told
            )
    out.mkdir(parents=True, exist_ok=True)
    head = _HEAD.format(
        paths=" ".join(Path(path).name for path in arguments.sessions),
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
    from percept.calibration.coverage import fitted_values, refuse_unfit
    from percept.calibration.judge import CoveragePlan

    with Working("fitting the truth", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        refuse_unfit(study)
        values = fitted_values(study) if arguments.source == "fit" else None
    inference, device = study.scene.inference, study.scene.device
    rigid, period = _DEVICE, _PERIOD
    if device is not None and device.mass is not None and device.damping is not None:
        rigid, period = (device.mass, device.damping), device.period
    return [
        CoveragePlan(
            references=tuple((study.reference["k", e], study.reference["b", e]) for e in study.environments),
            subjects=subjects,
            truth=truth,
            family=inference.family,
            method="classical" if inference.method == "classical" else "both",
            level=inference.level,
            share=inference.held_share,
            confidence=inference.confidence,
            tolerance=max(inference.tolerance, 0.05),
            values=values,
            seed=inference.seed,
            device=rigid,
            period=period,
        )
        for subjects in arguments.subjects or [len(study.sessions.subjects)]
        for truth in arguments.truth
    ]
