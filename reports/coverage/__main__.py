"""`python -m reports.coverage`: how often verdicts err."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from percept.provenance import made_by
from reports.command import run, write_page
from reports.coverage.verdict_rates import page


def main(words: Sequence[str] | None = None) -> int:
    """Simulate what is missing, and write the page; the same command goes on."""
    parser = argparse.ArgumentParser("python -m reports.coverage", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--studies", type=int, default=20_000, help="by stiffness and damping")
    parser.add_argument("--magnitude", type=int, default=400, help="studies by abs(Z_h)")
    parser.add_argument("--fits", type=int, default=300, help="of each number of subjects")
    return run(parser, _run, words)


def _run(arguments: argparse.Namespace) -> None:
    text = page(
        arguments.out,
        studies=arguments.studies,
        magnitude=arguments.magnitude,
        fits=arguments.fits,
    )
    sentence = made_by(arguments.typed).sentence
    write_page(arguments.out / "verdicts.md", f"{text}\n{sentence}\n")


if __name__ == "__main__":
    sys.exit(main())
