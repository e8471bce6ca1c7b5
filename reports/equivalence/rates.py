"""How often two one-sided tests err at the edge, and how often they decide."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from percept.inference.classical.contrasts import tost
from percept.inference.classical.fiducial import tost_power
from percept.inference.classical.moments import Moments
from reports.page import Page

SUBJECTS = (2, 3, 4, 10, 30)
#: True bias in JNDs: none, at the edge, and twice as large.
BIASES = (0.0, 1.0, 2.0)
#: SD between subjects in JNDs; with the largest, a mean passes either limit by chance.
SDS = (0.3, 1.0, 30.0)
SIZE = 0.05


@dataclass(frozen=True)
class Rates:
    """Shares of studies of one kind that say "within" and "beyond"."""

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
    return Rates(studies, within, beyond, power)


def page(out: Path, *, studies: int = 20_000) -> Page:
    """Simulate studies, and count what they say.

    Parameters
    ----------
    out : Path
        Folder of the page.
    studies : int
        Of each row.

    Returns
    -------
    Page
    """
    page = Page(
        "Within one JND?",
        f"All {studies:,} studies of a row are simulated: normal users, one trial each. The tests"
        f" have size {SIZE}. A bias of one JND is the edge, where either statement may be made in"
        f" at most {SIZE:.0%} of studies. `power` is that of `within`, by quadrature.",
    )
    rows = []
    for subjects, sd, bias in itertools.product(SUBJECTS, SDS, BIASES):
        found = rates(subjects, sd, bias, studies)
        told = (found.within, found.error, found.power, found.beyond)
        rows.append([subjects, sd, bias, *(f"{value:.4f}" for value in told)])
    heads = ["subjects", "SD (JNDs)", "bias (JNDs)", "within", "±", "power", "beyond"]
    page.table(heads, rows)
    return page
