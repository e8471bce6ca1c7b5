"""`python -m reports.evidence`: what is called renderable, beside motion in time."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from percept.provenance import made_by
from reports.command import run, write_page
from reports.evidence import loop


def main(words: Sequence[str] | None = None) -> int:
    """Write the page."""
    parser = argparse.ArgumentParser("python -m reports.evidence", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--loops", type=int, default=500, help="loops (500)")
    parser.add_argument("--plain", type=int, default=200, help="loops without modes (200)")
    return run(parser, _run, words)


def _run(arguments: argparse.Namespace) -> None:
    text = loop.page(arguments.loops, arguments.plain)
    made = made_by(arguments.typed)
    write_page(arguments.out / "loop.md", f"{text}{made.sentence}\n")


if __name__ == "__main__":
    sys.exit(main())
