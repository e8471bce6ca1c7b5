"""Analyse sessions and write the report: page, report.json, tables, figures and posterior."""

from __future__ import annotations

import argparse

from percept.commands.analysis import (
    Working,
    add_analysis_arguments,
    add_check_arguments,
    open_study,
    verdict,
)

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
    """Write the report, with what the gate does not withhold; the last line printed is the page's path."""
    from percept.report import write_report

    with Working("writing the report", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        asked = {"formats": arguments.formats, "pdf": arguments.pdf, "why": arguments.why}
        page = write_report(study, arguments.out, **asked)
    print(page)
    return verdict(study)
