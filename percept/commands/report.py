"""Analyse sessions and write the report: page, report.json, tables, figures and posterior."""

from __future__ import annotations

import argparse
import json

from percept.commands.analysis import (
    Working,
    add_analysis_arguments,
    add_check_arguments,
    open_study,
    verdict,
)
from percept.errors import printable

EXAMPLE = "percept report sessions/ --scene scene.toml --out results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    add_check_arguments(parser, usual=True)
    parser.add_argument("--out", default="report", metavar="DIR", help="folder to write into (report)")
    parser.add_argument(
        "--why", action="store_true", help="say why the methods differ; samples the models between them"
    )
    parser.add_argument("--pdf", action="store_true", help="also write report.pdf (needs Chromium)")
    parser.add_argument(
        "--formats",
        nargs="+",
        choices=("svg", "pdf", "png"),
        default=["svg"],
        metavar="FORM",
        help="files of the figures: svg, pdf, png (svg)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the report, with what the gate does not withhold; and print its findings, warnings and path."""
    from percept.report import write_report

    with Working("writing the report", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        asked = {"formats": arguments.formats, "pdf": arguments.pdf, "why": arguments.why}
        page = write_report(study, arguments.out, **asked)
    if not arguments.quiet:
        summary = json.loads((page.parent / "report.json").read_text(encoding="utf-8"))["summary"]
        # What `verdict` says stands on standard error.
        told = ("There are no Bayesian intervals", "The Monte Carlo error reached")
        warnings = [f"warning: {said}" for said in summary["cautions"] if not said.startswith(told)]
        print("\n".join(map(printable, [*summary["overview"]["sentences"], *warnings])))
    print(page)
    return verdict(study)
