"""How often two one-sided tests err at the edge, and how often they decide."""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from percept.inference.classical.equivalence import tost, tost_power
from percept.inference.classical.moments import Moments
from percept.provenance import made_by
from reports.command import run, write_page

SUBJECTS = (2, 3, 4, 10, 30)
#: True bias in JNDs: none, at the edge, and twice as large.
BIASES = (0.0, 1.0, 2.0)
#: SD between subjects in JNDs; with the largest, a mean passes either limit by chance.
SDS = (0.3, 1.0, 30.0)
SIZE = 0.05


@dataclass(frozen=True)
class Rates:
    """Shares of studies of one kind that say "within" and "beyond"."""

    subjects: int
    sd: float
    bias: float
    studies: int
    within: float
    beyond: float
    power: float  # Probability of "within" by quadrature

    @property
    def error(self) -> float:
        """Standard error of `within`, from what it should be."""
        return math.sqrt(self.power * (1.0 - self.power) / self.studies)


def rates(subjects: int, sd: float, bias: float, studies: int, seed: int = 1) -> Rates:
    """Simulate studies of normal users, and judge each; one JND is 1."""
    rng = np.random.default_rng([seed, subjects, int(10 * sd), int(10 * bias)])
    means = bias + sd / math.sqrt(subjects) * rng.standard_normal(studies)
    sds = sd * np.sqrt(rng.chisquare(subjects - 1, studies) / (subjects - 1))
    tests = tost(Moments(means, sds, subjects), -1.0, 1.0)
    within = float(np.mean(tests.p_within <= SIZE))
    beyond = float(np.mean(tests.p_beyond <= SIZE))
    root_n = math.sqrt(subjects) / sd
    power = tost_power((1.0 + bias) * root_n, (1.0 - bias) * root_n, subjects - 1.0, size=SIZE)
    return Rates(subjects, sd, bias, studies, within, beyond, power)


def page(found: list[Rates], sentence: str) -> str:
    """Write the table."""
    lines = [
        "# Within one JND?",
        "",
        f"All {found[0].studies:,} studies of a row are simulated: normal users, one trial each.",
        f"The tests have size {SIZE}. A bias of one JND is the edge, where either statement may be",
        f"made in at most {SIZE:.0%} of studies. `power` is that of `within`, by quadrature.",
        sentence,
        "",
        "| subjects | SD (JNDs) | bias (JNDs) | within | ± | power | beyond |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in found:
        lines.append(
            f"| {row.subjects} | {row.sd} | {row.bias} | {row.within:.4f} | {row.error:.4f}"
            f" | {row.power:.4f} | {row.beyond:.4f} |"
        )
    return "\n".join(lines) + "\n"


def main(words: Sequence[str] | None = None) -> int:
    """Simulate the studies, and write the page."""
    parser = argparse.ArgumentParser("python -m reports.equivalence", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--studies", type=int, default=20_000, help="of each row (20000)")
    return run(parser, _run, words)


def _run(arguments: argparse.Namespace) -> None:
    found = []
    for subjects, sd, bias in itertools.product(SUBJECTS, SDS, BIASES):
        found.append(rates(subjects, sd, bias, arguments.studies))
    text = page(found, made_by(arguments.typed).sentence)
    write_page(arguments.out / "equivalence.md", text)


if __name__ == "__main__":
    sys.exit(main())
