"""Predict intervals and the boundary of an environment nobody tested."""

from __future__ import annotations

import argparse

from percept.commands.analysis import add_analysis_arguments, open_study
from percept.commands.progress import SamplerProgress

EXAMPLE = "percept predict sessions.csv --k 15000 --b 12 --scene scene.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    parser.add_argument("--k", type=float, metavar="N/m", help="stiffness of the untested environment")
    parser.add_argument("--b", type=float, metavar="N·s/m", help="damping of the untested environment")
    parser.add_argument("--json", action="store_true", help="print as JSON, with the boundaries")


def run(arguments: argparse.Namespace) -> int:
    """Print how far the environment lies from the tested ones, and its intervals."""
    from percept.study.prediction import predict

    with SamplerProgress(shown=not arguments.quiet) as progress:
        found = predict(open_study(arguments, progress), stiffness=arguments.k, damping=arguments.b)
    if arguments.json:
        from percept.report.plain import dumps, plain

        print(dumps(plain(found)), end="")
        return 0
    print(found.sentence)
    columns = ["parameter", "reference", "kind", "lower", "upper", "estimate", "unit", "monte_carlo"]
    print(found.intervals[columns].to_string(index=False, float_format="{:.6g}".format))
    return 0
