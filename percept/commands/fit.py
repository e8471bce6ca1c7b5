"""Fit the model and write the intervals: fit.json (in report.json's schema) and the posterior."""

from __future__ import annotations

import argparse
import json

from percept.commands.analysis import add_analysis_arguments, open_study, verdict
from percept.commands.checks import add_check_arguments, print_checks
from percept.commands.progress import Working

EXAMPLE = "percept fit sessions.csv --scene scene.toml --out results --json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    add_check_arguments(parser)
    parser.add_argument("--out", default="fit", metavar="DIR", help="folder to write into (fit)")
    parser.add_argument("--json", action="store_true", help="print fit.json")


def run(arguments: argparse.Namespace) -> int:
    """Fit, write DIR/fit.json and DIR/posterior.nc, and print the intervals."""
    from percept.errors import printable
    from percept.report import write_fit

    with Working("fitting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        path = write_fit(study, arguments.out)
    if arguments.json:
        print(path.read_text(encoding="utf-8"))
        return verdict(study)
    columns = ["environment", "parameter", "kind", "method", "family", "joint", "lower", "upper", "unit"]
    table = study.intervals
    if len(table):
        table["environment"] = table["environment"].map(printable)
        print(table[columns].to_string(index=False, float_format="{:.6g}".format))
    for row in json.loads(path.read_text(encoding="utf-8"))["skipped"]:
        print(printable(f"Left out: {row['what']} ({row['why'].removesuffix('.')})."))
    print_checks(study)
    print(path)
    return verdict(study)
