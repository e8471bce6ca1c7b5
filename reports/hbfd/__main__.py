"""`python -m reports.hbfd`: the paper, claim by claim, from its published numbers."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from reports.command import run
from reports.hbfd.published import load_published
from reports.hbfd.write import write_reproduction


def main(words: Sequence[str] | None = None) -> int:
    """Write tables, figures and every claim with its verdict; print the verdicts and the page."""
    parser = argparse.ArgumentParser("python -m reports.hbfd", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder to write into")
    parser.add_argument("--quiet", action="store_true", help="print no verdicts")
    return run(parser, _reproduce, words)


def _reproduce(arguments: argparse.Namespace) -> None:
    claims = write_reproduction(load_published(), arguments.out, command=arguments.typed)
    if not arguments.quiet:
        for claim in claims:
            print(f"{claim.verdict:<18}“{claim.quote}”")


if __name__ == "__main__":
    sys.exit(main())
