"""Probability that a displayed impedance feels real, from posterior draws of the population of users.

Each draw of the posterior is a population: limits of stiffness and of damping between which a level
of all users have their points of equality. What is displayed is realistic under that draw where it
lies inside, in magnitude (the exact range of abs(Z_h) over the limits) or, more strictly, in
stiffness and damping both. Each draw is judged at every omega of a range, so that the only error
left is that of the number of draws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from percept.haptics.containment import ON_LIMIT, Boxes, departures, plane_departures
from percept.haptics.records import Display
from percept.html import NotebookRecord


@dataclass(frozen=True)
class Realism(NotebookRecord):
    """Probability of being realistic at every omega of a range, with its Monte Carlo error over the draws."""

    magnitude: float  # By abs(Z_h)
    plane: float  # By stiffness and damping both
    magnitude_error: float  # With the fraction of the draws that no search decided
    plane_error: float
    draws: int


def realism(display: Display, populations: Boxes, lower: float, upper: float) -> Realism:
    """Count the draws, a box each, under which a display stays inside between two frequencies, rad/s.

    A display on its limit, to within rounding, counts as inside. So does one that no search
    decides, which the error counts too.
    """
    draws = populations.size
    plane = plane_departures(display, populations, lower, upper).largest <= 0.0
    # Inside in stiffness and damping is inside in magnitude: only the others need a search.
    magnitude, rest, undecided = plane.copy(), np.flatnonzero(~plane), 0
    if rest.size:
        found = departures(display, populations.select(rest), lower, upper, throughout=True)
        magnitude[rest] = found.largest <= ON_LIMIT
        undecided = int((magnitude[rest] & (found.bound > ON_LIMIT)).sum())
    # Where all draws agree the binomial error counts as one draw.
    p, q = float(magnitude.mean()), float(plane.mean())
    p_error, q_error = (max(float(np.sqrt(x * (1.0 - x) / draws)), 1.0 / draws) for x in (p, q))
    return Realism(p, q, p_error + undecided / draws, q_error, draws)
