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
from numpy.typing import NDArray

from percept.haptics.containment import ON_LIMIT, Boxes, departures, plane_departures
from percept.haptics.records import Display
from percept.html import NotebookRecord

__all__ = ["Realism", "realism"]


@dataclass(frozen=True)
class Realism(NotebookRecord):
    """Probability of being realistic at every omega of a range, with its Monte Carlo error."""

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
    in_plane = plane_departures(display, populations, lower, upper).largest <= 0.0
    # Inside in stiffness and damping is inside in magnitude: only the others need a search.
    in_magnitude = in_plane.copy()
    undecided = 0
    (rest,) = np.nonzero(~in_plane)
    if rest.size:
        departed = departures(display, populations.select(rest), lower, upper, throughout=True)
        in_magnitude[rest] = departed.largest <= ON_LIMIT
        undecided = int((in_magnitude[rest] & (departed.bound > ON_LIMIT)).sum())
    draws = populations.size
    return Realism(
        magnitude=float(in_magnitude.mean()),
        plane=float(in_plane.mean()),
        magnitude_error=_binomial_error(in_magnitude) + undecided / draws,
        plane_error=_binomial_error(in_plane),
        draws=draws,
    )


def _binomial_error(inside: NDArray[np.bool_]) -> float:
    """Return the standard error of a share; where all draws agree it counts as one draw."""
    share = float(inside.mean())
    return max(float(np.sqrt(share * (1.0 - share) / inside.size)), 1.0 / inside.size)
