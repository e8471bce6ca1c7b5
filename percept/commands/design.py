"""`percept plan`, `percept calibrate` and `percept sbc`: the next study, and what intervals of it cover."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from percept.commands import Command
from percept.commands.analysis import (
    Working,
    add_analysis_arguments,
    add_worker_arguments,
    open_study,
    print_json,
)
from percept.errors import UsageError

if TYPE_CHECKING:
    from percept.calibration.judge import CoveragePlan

# By kind: what must be given, and what may be.
_OPTIONS = {
    "mean": (("half_width", "sd"), ("level", "family")),
    "user": (("ratio",), ("level",)),
    "share": (("ratio",), ("share", "confidence")),
}
_NAMES = ("half_width", "sd", "family", "ratio", "level", "share", "confidence")

_SOURCES = {"fit": "the values fitted to it", "prior": "the prior"}
_METHODS = {"both": ("classical", "bayesian")}
_REFITTED = {"classical": "the classical method", "bayesian": "the Bayesian one to a tolerance of {:g} %"}
_HEAD = """# Coverage

All studies behind this table are simulated: with the references of {paths}, {trials},
and {source}, refitted by {methods}.{curves}
Of the scene's other settings level, share, confidence, family, method and seed are kept; `[model]`,
modes and hold are not.

`stated` is what a row claims. `real` is the fraction of the claims that were true, over
environments and parameters together. ± is its standard error over the studies, which is the binomial one
where a study has one claim. Normal intervals of lognormal users, and the other way round, show what
the wrong family costs. A study of normal users in which a value is not positive has no lognormal row, so
`studies` can be few.

"""
_CURVES = """ Curves belong to a device of {0[0]:g} kg and
{0[1]:g} N·s/m at a period of {1:g} s, at {2[2]} frequencies from {2[0]:g} to {2[1]:g} rad/s."""


def _add_plan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--kind", choices=_OPTIONS, default="mean", help="what the interval covers (mean)")
    parser.add_argument(
        "--half-width", type=float, metavar="X", help="kind mean: in the unit of --sd, or as a fraction"
    )
    parser.add_argument(
        "--sd", type=float, metavar="X", help="kind mean: SD between users, or their coefficient of variation"
    )
    parser.add_argument(
        "--family", choices=("normal", "lognormal"), help="kind mean: distribution between users (normal)"
    )
    parser.add_argument(
        "--ratio", type=float, metavar="X", help="kinds user and share: width over that of all users, above 1"
    )
    parser.add_argument("--level", type=float, metavar="X", help="kinds mean and user: level (0.99)")
    parser.add_argument("--share", type=float, metavar="X", help="kind share: share of users held (0.99)")
    parser.add_argument("--confidence", type=float, metavar="X", help="kind share: confidence (0.95)")
    parser.add_argument(
        "--assurance", type=float, default=0.8, metavar="X", help="probability of the width (0.8)"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def _plan(arguments: argparse.Namespace) -> None:
    """Print the smallest number of subjects and what it promises."""
    from percept.planning import plan_mean, plan_share, plan_user
    from percept.report.plain import plain

    given = {name: value for name in _NAMES if (value := getattr(arguments, name)) is not None}
    _refuse_misplaced(arguments.kind, given)
    width = given.pop(_OPTIONS[arguments.kind][0][0])
    planners: dict[str, Any] = {"mean": plan_mean, "user": plan_user, "share": plan_share}
    plan = planners[arguments.kind](width, **given, assurance=arguments.assurance)
    if arguments.json:
        print_json({**plain(plan), "covers": plan.covers})
    else:
        print(plan.covers)


def _refuse_misplaced(kind: str, given: dict[str, object]) -> None:
    """Refuse options that a kind lacks or has no use for."""
    needed, useful = _OPTIONS[kind]
    for name in needed:
        if name not in given:
            raise UsageError(f"kind {kind} needs {_flag(name)}.")
    for name in given:
        if name not in (*needed, *useful):
            kinds = [other for other, (must, may) in _OPTIONS.items() if name in (*must, *may)]
            raise UsageError(
                f"kind {kind} has no use for {_flag(name)}, which is of kind {' or '.join(kinds)}."
            )


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _add_calibrate(parser: argparse.ArgumentParser) -> None:
    add_analysis_arguments(parser)
    parser.add_argument("--studies", type=int, default=100, metavar="N", help="studies per design (100)")
    parser.add_argument(
        "--classical", type=int, metavar="N", help="of the classical method alone (--studies)"
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
        help="simulate what percept compare recommends a method by; it resumes",
    )
    add_worker_arguments(parser)
    parser.add_argument("--out", default="coverage", metavar="DIR", help="folder to write into (coverage)")


def _calibrate(arguments: argparse.Namespace) -> None:
    """Write DIR/coverage.md and DIR/coverage.csv; an interrupted run goes on from DIR/judged.jsonl."""
    import time

    import pandas as pd

    from percept.calibration.coverage import FILE, coverage, coverage_markdown, gather
    from percept.provenance import made_by
    from percept.sessions.quantities import is_impedance
    from percept.workers import open_mapper

    out = Path(arguments.out)
    plans = _plans(arguments, out)
    with (
        Working("simulating", shown=not arguments.quiet) as working,
        open_mapper(arguments.workers, arguments.scheduler) as mapper,
    ):

        def told(done: int, total: int) -> None:
            working.show(f"{done} of {total} studies", done, total)

        shared: dict[str, Any] = {"mapper": mapper, "progress": told}
        if arguments.advice:
            table = gather(tuple(plans), out / "judged.jsonl", **shared)
            table.to_csv(out / FILE, index=False)
            print(out / FILE)
            return
        rows = []
        stop = None if arguments.seconds is None else time.monotonic() + arguments.seconds
        for done, plan in enumerate(plans):
            # Every plan has an equal share of the time that is left.
            left = None if stop is None else (stop - time.monotonic()) / (len(plans) - done)
            classical = arguments.classical if plan.method == "classical" else None
            studies = arguments.studies if classical is None else classical
            rows.append(coverage(plan, studies, checkpoint=out / "judged.jsonl", seconds=left, **shared))
    table = pd.concat(rows).sort_values(["truth", "subjects"], kind="stable")
    methods = dict.fromkeys(plan.method for plan in plans)
    out.mkdir(parents=True, exist_ok=True)
    head = _HEAD.format(
        paths=" ".join(Path(path).name for path in arguments.sessions),
        trials="one trial each" if arguments.subjects else "its subjects and trials",
        source=_SOURCES[arguments.source],
        methods=" and ".join(_REFITTED[name] for name in methods).format(100 * plans[0].tolerance),
        curves=_CURVES.format(plans[0].device, plans[0].period, plans[0].frequencies)
        if is_impedance(plans[0].parameters)
        else "",
    )
    page = f"{head}{made_by(arguments.typed).sentence}\n\n{coverage_markdown(table)}"
    (out / "coverage.md").write_text(page, encoding="utf-8")
    table.to_csv(out / "coverage.csv", index=False)
    print(out / "coverage.md")


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


def _sbc(arguments: argparse.Namespace) -> None:
    """Write DIR/sbc.json and DIR/sbc.md; an interrupted run goes on from DIR/fits.jsonl."""
    from percept.calibration.placing import SBC_DESIGNS
    from percept.calibration.sbc import calibrate_designs, write_calibrations
    from percept.provenance import made_by
    from percept.workers import open_mapper

    if arguments.seed < 0:
        raise UsageError("a seed is not negative.", key="--seed", value=arguments.seed)
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    with (
        Working("simulating", shown=True) as working,
        open_mapper(arguments.workers, arguments.scheduler) as mapper,
    ):

        def told(design: str, done: int, fits: int) -> None:
            working.show(f"{done} of {fits} fits, {design}", done, fits)

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
    write_calibrations(calibrations, out, made_by(arguments.typed))
    print(out / "sbc.md")


PLAN = Command(
    "How many subjects the next study needs for an interval of a wanted width.",
    "percept plan --kind mean --half-width 0.1 --sd 0.2 --family lognormal",
    _add_plan,
    _plan,
)
CALIBRATE = Command(
    "Simulate studies like yours, refit them, and report the real coverage of every interval and boundary.",
    "percept calibrate sessions.csv --studies 200 --subjects 3 10 30 --out reports/coverage",
    _add_calibrate,
    _calibrate,
)
SBC = Command(
    "Simulation-based calibration: whether fits find the values that studies were simulated from.",
    "percept sbc --fits 1000 --out reports/calibration",
    _add_sbc,
    _sbc,
)
