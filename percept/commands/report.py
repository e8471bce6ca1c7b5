"""Analyse sessions and write the report: page, report.json, tables, figures and posterior."""

from __future__ import annotations

import argparse
import gc
from collections.abc import Iterator
from contextlib import contextmanager

from percept.commands.analysis import add_analysis_arguments, open_study, verdict
from percept.commands.checks import add_check_arguments
from percept.commands.progress import Working

EXAMPLE = "percept report sessions/ --scene scene.toml --out results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    add_check_arguments(parser)
    parser.add_argument("--out", default="report", metavar="DIR", help="folder to write into (report)")
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

    with _rare_collections(), Working("writing the report", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        page = write_report(study, arguments.out, formats=arguments.formats, pdf=arguments.pdf)
    print(page)
    return verdict(study)


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Look for cycles of garbage less often.

    A report makes some hundred thousand small objects, of which most stay to the end: looking through them
    every seven hundred takes a twentieth of the time and finds a few megabytes.
    """
    usual = gc.get_threshold()
    gc.set_threshold(20_000, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)
