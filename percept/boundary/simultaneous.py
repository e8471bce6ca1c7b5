"""Limits between which whole curves of abs(Z_h) lie: their level at single frequencies.

A score s stands for the level 2 Phi(s) - 1 of the limits at every single frequency. Let p(s) be the
probability that a curve leaves its limits at one frequency or more. Whole curves stay inside at a
level P if p(s) = 1 - P. That s is searched for: log p(s) is close to a straight line.

A curve is one pair (k, b). On a line of one b it is a point k. The limits at one frequency are two
balls, and each ball covers an interval of the line. A curve stays inside if k lies in the outer
interval of every frequency and in none of the inner ones, called holes. The rest of the line are
gaps:

    outer intervals    [-----------------------------------]
                    [----------------------------------]
    common part        |low                            |high
    holes                    ####      ######
                                          #####
    gaps               |0----|  |1-----|       |2------|

A table holds F(k, b), the probability density of b times that of a smaller k given b. So on a line
a gap from k0 to k1 holds F(k1, b) - F(k0, b), and 1 - p is the integral over b of the sum over
gaps.

The Monte Carlo error comes from batches of posterior draws. Batch i changes p by dp_i at the same
s. It would need a score higher by dp_i / abs(dp/ds), and dp/ds = (1 - P) d(log p)/ds.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from percept.boundary.law import between, cell_and_fraction
from percept.boundary.limits import Magnitude, density, level_of
from percept.boundary.shares import score_of
from percept.errors import RefusalError

__all__ = ["SimultaneousLevel", "simultaneous_level"]

Array = NDArray[np.float64]

# SDs of a normal to which the score is searched: about 0.1 % of the half-width of usual bands,
# 2.6 SDs, and far below the Monte Carlo error.
_ACCURACY = 0.003
# Least distance of two scores that the slope of log p is taken between: between nearer ones the
# search's own error decides.
_SLOPE_BASE = _ACCURACY
# SDs of a normal to the scores beside the one found: batches of draws move limits by about as much.
_NEAR = 0.2
# The least probability with a logarithm: from far out no curve may leave at all.
_TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class SimultaneousLevel:
    """The level of limits at single frequencies that hold whole curves."""

    level: float
    error: float  # Monte Carlo standard error
    shifts: Array  # (B,) by how many SDs each batch of draws would move the limits out


def simultaneous_level(magnitude: Magnitude, level: float) -> SimultaneousLevel:
    """Search for the level at single frequencies whose limits hold whole curves.

    Parameters
    ----------
    magnitude : Magnitude
        Law of abs(Z_h), from posterior draws in batches.
    level : float
        Probability that a curve lies inside at all frequencies.

    Returns
    -------
    SimultaneousLevel

    Raises
    ------
    RefusalError
        No level that the law determines holds whole curves.
    """
    # Whole curves leave at least as often as they leave at one frequency: no lower score will do.
    first = score_of(level)
    allowed = 1.0 - level
    farthest = magnitude.farthest_score
    of_k, _ = magnitude.law.cumulated
    table = of_k[None]

    @functools.cache
    def log_excess(score: float) -> float:
        """Return the log of how many times too many curves leave."""
        (probability,) = _leaving(magnitude, magnitude.log_limits(score)[None], table)
        ratio = max(probability, _TINY) / allowed
        return float(np.log(ratio))

    if first > farthest or log_excess(farthest) > 0.0:
        raise RefusalError(f"no limits at single frequencies hold whole curves at {level:g}.")
    score = first
    # How fast log p falls with the score. A normal's log tail falls by about its own score.
    fall = first
    first_excess = log_excess(first)
    if first_excess > 0.0:
        solved = optimize.brentq(log_excess, first, farthest, xtol=_ACCURACY)
        score = min(max(solved, first + _SLOPE_BASE), farthest)
        fall = (first_excess - log_excess(score)) / (score - first)
    # Where the first score suffices, curves leave less often than allowed. The level then stands at
    # its least, and its error is that of a level which just suffices: more than it has.
    # The level is what is reported, and `limits(level)` starts from its score: rounding makes that
    # another number in the last digit, for which limits are solved here once and then found again.
    score = score_of(level_of(score))
    shifts = _batch_changes(magnitude, score) / (fall * allowed)
    levels_per_score = 2.0 * float(density(score))
    error = levels_per_score * float(magnitude.law.standard_error(shifts))
    return SimultaneousLevel(level_of(score), error, shifts)


def _batch_changes(magnitude: Magnitude, score: float) -> Array:
    """Return by how much each batch of draws changes the probability that a curve leaves, (B,).

    A batch has its own limits at a score, and its own table. Those limits lie `batch_shifts`
    farther out along the curve of limits over the score, so that they need not be solved for. The
    curve bends: it goes through the scores that the search solved for, and two near by.
    """
    for near in (score - _NEAR, min(score + _NEAR, magnitude.farthest_score)):
        magnitude.log_limits(near)
    moved = magnitude.log_limits_between(score + np.moveaxis(magnitude.batch_shifts(score), -1, 0))
    log_limits = np.concatenate([magnitude.log_limits(score)[None], moved])
    of_k, _ = magnitude.law.by_batch
    leaving = _leaving(magnitude, log_limits, np.moveaxis(of_k, -1, 0))
    return leaving[1:] - leaving[0]


def _leaving(magnitude: Magnitude, log_limits: Array, tables: Array) -> Array:
    """Return the probability (C,) that a curve leaves log limits (C, 2, M) at some frequency.

    The C tables (C, N, inner) hold the probability of k up to a place, on N lines of one b each.
    """
    k = magnitude.balls.k
    lines = np.linspace(0.0, 1.0, tables.shape[1])
    b_squared = magnitude.balls.b.of_place(lines[:, None]) ** 2

    def covered(log_radius: Array) -> tuple[Array, Array]:
        """Return where the balls' intervals start and end on the lines, as F(k, b), (C, N, M)."""
        radius_squared = np.exp(2.0 * log_radius[:, None])
        # A ball that does not reach the line leaves it an interval without width.
        leg = np.sqrt(np.maximum(radius_squared - b_squared, 0.0))
        start = _probability_up_to(tables, k.place(-leg))
        return start, _probability_up_to(tables, k.place(leg))

    outer_start, outer_end = covered(log_limits[:, 1])
    low = outer_start.max(axis=-1, keepdims=True)
    high = outer_end.min(axis=-1, keepdims=True)
    hole_start, hole_end = covered(log_limits[:, 0])
    order = hole_start.argsort(axis=-1)
    hole_start = np.take_along_axis(hole_start, order, -1)
    hole_end = np.take_along_axis(hole_end, order, -1)
    # Holes overlap: a gap starts where the farthest end of all holes so far lies.
    farthest_end = np.maximum.accumulate(hole_end, axis=-1)
    starts = np.concatenate([low, farthest_end], axis=-1)
    ends = np.concatenate([hole_start, high], axis=-1)
    gaps = np.minimum(ends, high) - np.maximum(starts, low)
    on_line = np.maximum(gaps, 0.0).sum(axis=-1)
    staying = np.trapezoid(on_line, dx=lines[1] - lines[0], axis=-1)
    return np.asarray(1.0 - staying)


def _probability_up_to(tables: Array, place: Array) -> Array:
    """Interpolate the rows of tables (C, N, inner) at places (C, N, M)."""
    count, rows, columns = tables.shape
    cell, fraction = cell_and_fraction(place, columns)
    first_of_row = np.arange(0, tables.size, columns)
    point = first_of_row.reshape(count, rows, 1) + cell
    return between(tables.ravel(), point, fraction)
