"""How many subjects the next study needs for an interval of a wanted width."""

from __future__ import annotations

import argparse
from typing import Any

from percept.commands.analysis import print_json
from percept.errors import UsageError

EXAMPLE = "percept plan --kind mean --half-width 0.1 --sd 0.2 --family lognormal"
# By kind: what must be given, and what may be.
_OPTIONS = {
    "mean": (("half_width", "sd"), ("level", "family")),
    "user": (("ratio",), ("level",)),
    "share": (("ratio",), ("share", "confidence")),
}
_NAMES = ("half_width", "sd", "family", "ratio", "level", "share", "confidence")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
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


def run(arguments: argparse.Namespace) -> int:
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
    return 0


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
