"""`python -m reports.evidence`: verdicts beside a grid and beside motion; what factors cost."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from percept.provenance import made_by
from reports.command import run, write_page
from reports.evidence import factor_costs, loop, throughout


def main(words: Sequence[str] | None = None) -> int:
    """Write one page."""
    parser = argparse.ArgumentParser("python -m reports.evidence", description=__doc__)
    parser.add_argument(
        "part", choices=("throughout", "loop", "factor_costs"), help="the page to make"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--scenes", type=int, help="scenes (50 of throughout, 500 of loop)")
    parser.add_argument("--points", type=int, default=20_000, help="of the grid (20000)")
    parser.add_argument("--couplings", type=int, default=200, help="of loop (200)")
    parser.add_argument("--repeats", type=int, default=3, help="of factor_costs, processes (3)")
    return run(parser, _run, words)


def _run(arguments: argparse.Namespace) -> int:
    differ = False
    made = made_by(arguments.typed)
    path = arguments.out / f"{arguments.part}.md"
    if arguments.part == "factor_costs":
        write_page(path, factor_costs.page(arguments.repeats, made))
        return 0
    if arguments.part == "loop":
        text = loop.page(arguments.scenes or 500, arguments.couplings)
    else:
        differ, text = throughout.page(arguments.scenes or 50, arguments.points)
    write_page(path, f"{text}{made.sentence}\n")
    return int(differ)


if __name__ == "__main__":
    sys.exit(main())
