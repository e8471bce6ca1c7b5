"""Fit the model and write the intervals: fit.json (in report.json's schema) and the posterior."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from percept.commands.analysis import (
    Working,
    add_analysis_arguments,
    add_check_arguments,
    open_study,
    verdict,
)
from percept.errors import printable

if TYPE_CHECKING:
    from percept.study import Study

EXAMPLE = "percept fit sessions.csv --scene scene.toml --out results --json"
_COLUMNS = ["environment", "parameter", "kind", "method", "family", "joint", "lower", "upper", "unit"]
_MOST_ROWS = 30


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    add_check_arguments(parser)
    parser.add_argument("--out", default="fit", metavar="DIR", help="folder to write into (fit)")
    parser.add_argument(
        "--all", action="store_true", help="print every interval: both families, joint ones too"
    )
    parser.add_argument("--json", action="store_true", help="print fit.json")


def run(arguments: argparse.Namespace) -> int:
    """Fit, write DIR/fit.json and DIR/posterior.nc, and print the intervals."""
    from percept.report import write_fit

    with Working("fitting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        path = write_fit(study, arguments.out)
    if arguments.json:
        print(path.read_text(encoding="utf-8"))
        return verdict(study)
    _print_intervals(study, every=arguments.all)
    for row in json.loads(path.read_text(encoding="utf-8"))["skipped"]:
        print(printable(f"Left out: {row['what']} ({row['why'].removesuffix('.')})."))
    _print_checks(study)
    print(path)
    return verdict(study)


def _print_intervals(study: Study, *, every: bool) -> None:
    """Print both methods side by side, or a row per interval."""
    table = study.intervals[_COLUMNS] if every else study.summary(None)
    if table.empty:
        return
    count = len(study.intervals)
    table["environment"] = table["environment"].map(printable)
    if not every:
        table = table.head(_MOST_ROWS)
        for method in study.intervals["method"].unique():
            low, high = (table.pop(f"{method}_{side}") for side in ("lower", "upper"))
            table[method] = [
                "–" if low != low else f"{low:.5g} to {high:.5g}" for low, high in zip(low, high, strict=True)
            ]
            del table[f"{method}_estimate"]
    print(table.to_string(index=False, float_format="{:.6g}".format))
    if not every:
        print(f"--all prints all {count} intervals: both families, and those that hold together.")


def _print_checks(study: Study) -> None:
    """Print what the checks say in words, where they were asked for."""
    options = study.scene.checks
    if options is None or study.checks is None:
        return
    loo = study.checks.loo
    print(f"Predictive density of the subjects left out: {loo.elpd:.1f} ± {loo.se:.1f} nats.")
    for message in loo.messages or ("No subject is influential or an outlier.",):
        print(message)
    sensitivity = study.checks.sensitivity
    for row in sensitivity[sensitivity["diagnosis"] != ""].itertuples():
        print(f"{row.environment} {row.parameter}, {row.quantity}: {row.diagnosis} ({row.prior:.2f}).")
    if options.compare and len(study.environments) > 1:
        print(study.model_choice.table.to_string(index=False, float_format="{:.1f}".format))
        print(study.model_choice.sentence)
