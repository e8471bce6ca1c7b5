"""Probability that a displayed impedance feels real, from posterior draws of the population of users.

Each draw of the posterior is a population: limits of stiffness and of damping between which a level of all
users have their points of equality. What is displayed is realistic under that draw where it lies inside, in
magnitude (the exact range of abs(Z_h) over the limits) or, more strictly, in stiffness and damping both. Each
draw is judged at every omega of a range, so that the only error left is that of the number of draws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.haptics.containment import ON_LIMIT, Boxes, departures, plane_departures
from percept.haptics.forms import Display
from percept.html import NotebookRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Populations:
    """Limits between which a level of the users of each of S posterior draws lie."""

    stiffness: tuple[Array, Array]  # (S,)
    damping: tuple[Array, Array]  # (S,)


@dataclass(frozen=True)
class Realism(NotebookRecord):
    """Probability of being realistic at every omega of a range, with its Monte Carlo error over the draws."""

    magnitude_throughout: float  # By abs(Z_h)
    plane_throughout: float  # By stiffness and damping both
    magnitude_error: float  # With the fraction of the draws that no search decided
    plane_error: float
    draws: int


def realism(display: Display, populations: Populations, lower: float, upper: float) -> Realism:
    """Count the draws under which a display stays inside between two frequencies, rad/s.

    A display on its limit, to within rounding, counts as inside. So does one that no search decides, which
    the error counts too.
    """
    draws = populations.stiffness[0].size
    if not draws:
        raise UsageError("probabilities need at least one posterior draw.")
    users = Boxes(populations.stiffness, populations.damping)
    plane = plane_departures(display, users, lower, upper)[0] <= 0.0
    # Inside in stiffness and damping is inside in magnitude: only the others need a search.
    magnitude, rest, undecided = plane.copy(), np.flatnonzero(~plane), 0
    if rest.size:
        found = departures(display, users.some(rest), lower, upper, throughout=True)
        magnitude[rest] = found.largest <= ON_LIMIT
        undecided = int((magnitude[rest] & (found.bound > ON_LIMIT)).sum())
    p, q = float(magnitude.mean()), float(plane.mean())
    return Realism(p, q, _error(p, draws) + undecided / draws, _error(q, draws), draws)


def _error(probability: float, draws: int) -> float:
    """Return the binomial error; where all draws agree it counts as one draw."""
    return max(float(np.sqrt(probability * (1.0 - probability) / draws)), 1.0 / draws)
