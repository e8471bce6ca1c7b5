"""Reproduce the paper from its published numbers: tables, figures, and every claim with its verdict."""

from __future__ import annotations

import argparse

from percept.commands.analysis import Working

EXAMPLE = "percept reproduce --out results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--out", default="reproduction", metavar="DIR", help="folder to write (reproduction)")
    parser.add_argument("--table", metavar="FILE", help="published limits (the paper's Table 1)")
    parser.add_argument("--scene", metavar="FILE", help="device, coupling and range (the paper's, with them)")
    parser.add_argument("--json", action="store_true", help="print the claims as JSON")
    parser.add_argument("--quiet", action="store_true", help="print the page's path only")


def run(arguments: argparse.Namespace) -> int:
    """Write the reproduction, and print every verdict and the page's path."""
    from percept.reproduce import load_published, write_reproduction

    published = load_published(arguments.table, arguments.scene)
    with Working("judging the claims", shown=not arguments.quiet):
        written = write_reproduction(published, arguments.out)
    if arguments.json:
        print((written.folder / "claims.json").read_text(encoding="utf-8"))
        return 0
    if not arguments.quiet:
        for claim in written.claims:
            print(f"{claim.verdict:<18}“{claim.quote}”")
    print(written.page)
    return 0
