"""How many subjects the next study needs for an interval of a wanted width."""

from __future__ import annotations

import argparse

EXAMPLE = "percept plan --kind mean --half-width 0.1 --sd 0.2 --family lognormal"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--kind", choices=("mean", "user", "share"), default="mean", help="what the interval covers (mean)"
    )
    parser.add_argument(
        "--half-width", type=float, metavar="X", help="kind mean: in the unit of --sd, or as a fraction"
    )
    parser.add_argument(
        "--sd", type=float, metavar="X", help="kind mean: SD between users, or their coefficient of variation"
    )
    parser.add_argument(
        "--ratio", type=float, metavar="X", help="kinds user and share: width over that of all users, above 1"
    )
    parser.add_argument("--level", type=float, default=0.99, metavar="X", help="confidence level (0.99)")
    parser.add_argument("--share", type=float, default=0.99, metavar="X", help="share of users held (0.99)")
    parser.add_argument("--confidence", type=float, default=0.95, metavar="X", help="of kind share (0.95)")
    parser.add_argument(
        "--assurance", type=float, default=0.8, metavar="X", help="probability of the width (0.8)"
    )
    parser.add_argument("--family", choices=("normal", "lognormal"), default="normal", help="of kind mean")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the smallest number of subjects and what it promises."""
    from percept.errors import UsageError
    from percept.planning import plan_mean, plan_share, plan_user

    needed = ("half_width", "sd") if arguments.kind == "mean" else ("ratio",)
    for name in needed:
        if getattr(arguments, name) is None:
            raise UsageError(f"kind {arguments.kind} needs --{name.replace('_', '-')}.", column=name)
    assurance = arguments.assurance
    if arguments.kind == "mean":
        found = plan_mean(
            arguments.half_width,
            sd=arguments.sd,
            level=arguments.level,
            assurance=assurance,
            family=arguments.family,
        )
    elif arguments.kind == "user":
        found = plan_user(arguments.ratio, level=arguments.level, assurance=assurance)
    else:
        found = plan_share(
            arguments.ratio, share=arguments.share, confidence=arguments.confidence, assurance=assurance
        )
    if arguments.json:
        from percept.report.plain import dumps, plain

        print(dumps({**plain(found), "covers": found.covers}), end="")
    else:
        print(found.covers)
    return 0
