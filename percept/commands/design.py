"""`percept plan`, `calibrate` and `zwidth`: the next study, what it covers, and the device."""

from __future__ import annotations

import argparse
import inspect
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands import JSON, Command, argument, folder, number
from percept.commands.analysis import (
    STUDY,
    WORKERS,
    Working,
    open_mapper,
    open_study,
    print_json,
    print_table,
    show,
)
from percept.errors import RefusalError, UsageError

if TYPE_CHECKING:
    from percept.judge import CoveragePlan, Method
    from percept.planning import Plan
    from percept.results import Verdict, ZWidth


# Of the points of an edge, every sixteenth is printed: nine rows.
_STEP = 16
_KINDS = ("mean", "user", "share", "contrast", "equivalent", "verdicts")
# Arguments of a study that plans have in a form of their own.
_OF_PLANS = ("sessions", "--level", "--family")
_SOURCES = {"fit": "the values fitted to it", "prior": "the prior"}
_REFITTED = {
    "classical": "the classical method",
    "bayesian": "the Bayesian one to a tolerance of {:g} %",
}
_HEAD = """# Coverage

All studies behind this table are simulated: with the references of {paths}, {trials}, and {source},
refitted by {methods}.{curves}
Of the scene's other settings level, share, confidence, family, method and seed are kept; `[model]`,
modes and hold are not.

`stated` is what a row claims, `real` the fraction of its claims that were true, over environments
and parameters together, and ± its standard error over the studies. Normal intervals of lognormal
users, and the other way round, show what the wrong family costs. An environment of normal users in
which a value is not positive has no lognormal row, so `studies` can be few. Boundaries are of the
scene's family, and of the other one in environments without it: rows of that family speak of these
alone. Shares that are `refused` or `withheld` are of all studies. A study whose values no file may
hold is refused.

"""
_CURVES = """ Curves belong to a device of {device.mass:g} kg and {device.damping:g} N·s/m at a \
period of
{device.period:g} s, at {frequency.points} frequencies from {frequency.lower:g} to \
{frequency.upper:g} rad/s."""


def _plan(arguments: argparse.Namespace) -> None:
    """Print the smallest number of subjects and what it promises."""
    kind = arguments.kind
    if kind == "verdicts":
        _decide(arguments)
        return
    if arguments.by:
        _pilot(arguments)
        return
    if arguments.sessions:
        hint = "Add one of them, or leave the sessions out."
        raise UsageError("sessions are for --kind verdicts and for --by.", hint=hint)
    from percept import planning

    planners: dict[str, Callable[..., Plan]] = {
        "mean": planning.plan_mean,
        "user": planning.plan_user,
        "share": planning.plan_share,
        "contrast": planning.plan_contrast,
        "equivalent": planning.plan_equivalent,
    }
    planner = planners[kind]
    taken = inspect.signature(planner).parameters
    known = {name for one in planners.values() for name in inspect.signature(one).parameters}
    options = {name: getattr(arguments, name) for name in sorted(known - {"assurance"})}
    given = {name: value for name, value in options.items() if value is not None}
    needed = [name for name, parameter in taken.items() if parameter.default is parameter.empty]
    _refuse(kind, "needs", [name for name in needed if name not in given])
    _refuse(kind, "has no use for", [name for name in given if name not in taken])
    plan = planner(**given, assurance=arguments.assurance)
    if arguments.json:
        print_json(plan)
    else:
        print(plan.covers)


def _pilot(arguments: argparse.Namespace) -> None:
    """Print how many subjects show a difference between the levels of a column of a pilot study."""
    import numpy as np

    from percept.planning import pilot_sds, plan_contrast

    if arguments.kind != "contrast":
        raise UsageError("--by is for --kind contrast.")
    if not arguments.sessions or arguments.difference is None:
        raise UsageError("--by needs the sessions of a pilot study and --difference.")
    column = arguments.by
    arguments.method = "classical"
    with Working("reading", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress, by=column)
        levels = [row for row in study.levels if row.factor == column and row.environment is None]
    inference = study.scene.inference
    planned: list[dict[str, object]] = []
    for first, second in itertools.combinations(levels, 2):
        if first.parameter != second.parameter:
            continue
        values = [np.array(row.values, dtype=float) for row in (first, second)]
        sds = pilot_sds(*values, within=first.within, family=inference.family)
        if sds is None:
            continue
        plans = [
            plan_contrast(
                arguments.difference,
                sd=stated[0],
                other_sd=None if first.within else stated[1],
                level=inference.level,
                assurance=arguments.assurance,
                family=inference.family,
            )
            for stated in sds
        ]
        plan, cautious = plans
        names = {"parameter": first.parameter, "first": first.level, "second": second.level}
        planned.append({**names, "plan": plan, "cautious": cautious})
        if not arguments.json:
            label = study.sessions.quantities[first.parameter].label
            show(f"{label}, {second.level} against {first.level}: {plan.covers}")
            show(f"  If the true SDs are at their upper 80 % limits, it takes {cautious.n}.")
    if not planned:
        hint = "Two subjects or more must have both levels at all references."
        raise RefusalError("the pilot gives no SD of a contrast.", column=column, hint=hint)
    if arguments.json:
        print_json({"plans": planned})


def _decide(arguments: argparse.Namespace) -> None:
    """Print how many more subjects would decide each verdict of a study."""
    if not arguments.sessions:
        raise UsageError("kind verdicts needs the sessions of a study.")
    with Working("judging", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        verdicts = study.verdict_rows
        progress.stop()
    if not verdicts:
        raise RefusalError(
            "there is no verdict to decide.", hint="A scene with a device lets percept judge."
        )
    if arguments.json:
        print_json({"verdicts": verdicts})
        return
    subjects = study.scene.study.subject[1]
    for verdict in verdicts:
        rendered = "through the coupling" if verdict.coupled else "directly"
        show(f"{verdict.environment}, {rendered}: {_needed(verdict, subjects)}")


def _needed(verdict: Verdict, subjects: str) -> str:
    """Say how many more subjects would decide a verdict, if it is open."""
    more = verdict.more
    if more is None:
        return verdict.outcome
    if more.subjects is None:
        return f"{verdict.outcome}; more than {more.most:,} more {subjects} would be needed"
    return (
        f"{verdict.outcome}; about {more.subjects:,} more {subjects} would decide with probability"
        f" {more.assurance:g}"
    )


def _refuse(kind: str, what: str, names: list[str]) -> None:
    """Refuse a kind without the options it needs, or with others."""
    if names:
        flags = " and ".join(f"--{name.replace('_', '-')}" for name in names)
        raise UsageError(f"kind {kind} {what} {flags}.")


def _calibrate(arguments: argparse.Namespace) -> None:
    """Write DIR/coverage.md and coverage.csv; an interrupted run goes on from judged.jsonl."""
    import pandas as pd

    from percept.calibration import coverage, coverage_markdown
    from percept.provenance import made_by

    out = Path(arguments.out)
    plans = _plans(arguments)
    checkpoint = out / "judged.jsonl"
    with (
        Working("simulating", shown=not arguments.quiet) as working,
        open_mapper(arguments) as mapper,
    ):

        def told(done: int, total: int) -> None:
            working.show(f"{done} of {total} studies", done, total)

        tables = []
        for plan in plans:
            studies = arguments.studies
            if plan.asked.method == "classical" and arguments.classical is not None:
                studies = arguments.classical
            tables.append(
                coverage(plan, studies, mapper=mapper, checkpoint=checkpoint, progress=told)
            )
    table = pd.concat(tables).sort_values(["truth", "subjects"], kind="stable")
    out.mkdir(parents=True, exist_ok=True)
    made = made_by(arguments.typed)
    page = f"{_head(arguments, plans)}{made.sentence}\n\n{coverage_markdown(table)}"
    (out / "coverage.md").write_text(page, encoding="utf-8")
    table.to_csv(out / "coverage.csv", index=False)
    print(out / "coverage.md")


def _plans(arguments: argparse.Namespace) -> list[CoveragePlan]:
    """Plan studies for each method, number of subjects and distribution of users."""
    from percept.calibration import fitted_values, plan_like, refuse_unfit

    with Working("fitting the truth", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        refuse_unfit(study)
        values = fitted_values(study) if arguments.source == "fit" else None
    method = study.scene.inference.method
    methods: list[Method] = ["classical", "bayesian"] if method == "both" else [method]
    plans = []
    for judged_method in methods:
        for subjects in arguments.subjects or [None]:
            for truth in arguments.truth:
                plans.append(
                    plan_like(
                        study, subjects, users_family=truth, values=values, method=judged_method
                    )
                )
    return plans


def _head(arguments: argparse.Namespace, plans: list[CoveragePlan]) -> str:
    """Write what the page says before its table."""
    plan = plans[0]
    methods = dict.fromkeys(_REFITTED[plan.asked.method] for plan in plans)
    curves = ""
    if plan.scene.device is not None:
        curves = _CURVES.format(device=plan.scene.device, frequency=plan.scene.frequency)
    return _HEAD.format(
        paths=" ".join(Path(path).name for path in arguments.sessions),
        trials="one trial each" if arguments.subjects else "its subjects and trials",
        source=_SOURCES[arguments.source],
        methods=" and ".join(methods).format(100 * plan.asked.tolerance),
        curves=curves,
    )


def _zwidth(arguments: argparse.Namespace) -> None:
    """Print the edge and write its figure."""
    from percept.scene import Scene
    from percept.study.device import device_draws, device_of, loop_of
    from percept.study.rendering import z_width

    scene = Scene.load(arguments.scene)
    device = device_of(scene)
    if scene.device is None or device is None:
        hint = "Give its mass, damping and period."
        raise UsageError("there is no [device].", file=arguments.scene, hint=hint)
    width = z_width(loop_of(scene.device, device), {}, device_draws(scene))
    if arguments.json:
        print_json(width)
    else:
        _print(width)
    if arguments.out is not None:
        _draw(width, arguments.out)
        show(str(arguments.out))


def _print(width: ZWidth) -> None:
    """Print the largest stiffness of the edge, and a table of it."""
    edge = width.edge
    if edge is None:
        show(
            "The device's table does not tell: it begins late, or no `response_floor` is stated"
            " for what lies above its end."
        )
        return
    show(
        "With every passive hand, in time, directly or as a coupling with a rigid wall behind it:"
        f"\nup to {edge.stiffest:.6g} N/m (beside {edge.stiffest_damping:.4g} N·s/m), and up to"
        f" {edge.most_damping:.4g} N·s/m."
    )
    rows = {"damping, N·s/m": edge.damping[::_STEP], "stiffness, N/m": edge.stiffness[::_STEP]}
    print_table(rows, digits=6)
    if width.likely is not None:
        show(
            f"95 % of the device's posterior renders up to {width.likely.stiffest:.6g} N/m, and"
            f" up to {width.likely.most_damping:.4g} N·s/m."
        )


def _draw(width: ZWidth, path: Path) -> None:
    """Write the figure as SVG."""
    from percept.report.figures.canvas import drawn
    from percept.report.figures.couplings import stability_drawings

    drawings = stability_drawings(width, None)
    if not drawings:
        raise RefusalError(
            "the device's table does not tell what can be rendered, so there is no figure.",
            hint="State response_floor, or give mass and damping.",
        )
    path.write_bytes(drawn(drawings[0])["svg"])


PLAN = Command(
    "How many subjects the next study needs for an interval, a difference of levels, or verdicts.",
    "percept plan --kind mean --half-width 0.1 --sd 0.2 --family lognormal",
    (
        argument(
            "--kind",
            None,
            "what to plan for (mean): an interval of the average user, the next user or a share of"
            " users; a difference of levels; a bias smaller than one JND; undecided verdicts",
            choices=_KINDS,
            default="mean",
        ),
        number("--half-width", "X", "kind mean: in the unit of --sd, or as a fraction"),
        number("--difference", "X", "kind contrast: in the unit of --sd, or as a fraction"),
        number(
            "--sd",
            "X",
            "kinds mean, contrast and equivalent: SD between users (of their differences), or their"
            " coefficient of variation",
        ),
        number("--other-sd", "X", "kind contrast: SD of a second group, whose people are others"),
        argument(
            "--family",
            None,
            "kinds mean, contrast and equivalent: distribution between users (normal)",
            choices=("normal", "lognormal"),
        ),
        number("--ratio", "X", "kinds user and share: width over that of all users, above 1"),
        number("--level", "X", "kinds mean, user and contrast: level (0.99)"),
        number("--share", "X", "kind share: share of users held (0.99)"),
        number("--confidence", "X", "kind share: confidence (0.95)"),
        number(
            "--assurance",
            "X",
            "probability of the width, or of showing what is to be shown (0.8)",
            default=0.8,
        ),
        number("--jnd", "X", "kind equivalent: one JND, in the unit of --sd, or as a fraction"),
        number("--bias", "X", "kind equivalent: the true bias, in the terms of --jnd (0)"),
        number("--decision", "X", "kind equivalent: confidence that decides (0.95)"),
        argument("--by", "COLUMN", "kind contrast: take the SDs from sessions of a pilot study"),
        argument("sessions", "PATH", "kind verdicts, and --by: session files", nargs="*"),
        *(option for option in STUDY if option.name not in _OF_PLANS),
        JSON,
    ),
    _plan,
)
CALIBRATE = Command(
    "Simulate studies like yours, refit them, and report the real coverage of every interval and"
    " boundary.",
    "percept calibrate sessions.csv --studies 200 --subjects 3 10 30 --out reports/coverage",
    (
        *STUDY,
        number("--studies", "N", "studies per design (100)", default=100),
        number("--classical", "N", "of the classical method alone (--studies)"),
        number("--subjects", "N", "subjects (the study's own)", nargs="+"),
        argument(
            "--from", None, "simulate from (fit)", dest="source", choices=_SOURCES, default="fit"
        ),
        argument(
            "--truth",
            None,
            "distribution of the simulated users (lognormal); the family of the model is --family",
            nargs="+",
            choices=("lognormal", "normal"),
            default=["lognormal"],
        ),
        *WORKERS,
        folder("coverage"),
    ),
    _calibrate,
)
ZWIDTH = Command(
    "The largest stiffness and damping that a scene's device renders with every passive hand, in"
    " time: of walls, and of couplings with a rigid wall behind them. Needs no sessions.",
    "percept zwidth scene.toml --out zwidth.svg",
    (
        argument("scene", "SCENE", "TOML file with a [device]"),
        argument("--out", "FILE", "figure to write, SVG", type=Path),
        JSON,
    ),
    _zwidth,
)
