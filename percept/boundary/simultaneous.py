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
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from percept.boundary.law import between, cell_and_fraction
from percept.boundary.limits import Magnitude, density, level_of, score_of
from percept.errors import RefusalError

__all__ = ["SimultaneousLevel", "simultaneous_level"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]

# SDs of a normal to which the score is searched: about 0.1 % of the half-width of usual bands,
# 2.6 SDs, and far below the Monte Carlo error.
_ACCURACY = 0.003
# Least distance of two scores that the slope of log p is taken between: between nearer ones the
# search's own error decides.
_SLOPE_BASE = _ACCURACY
# Each step out is this much longer than the one before, until curves stay inside. The first step
# follows the slope of a normal's tail and is mostly enough, so that the factor hardly matters.
_LONGER = 1.5
# Steps out before the farthest score is taken: the last would be 1e5 times the first.
_MOST_STEPS = 30
# The least probability with a logarithm: from far out no curve may leave at all.
_TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class SimultaneousLevel:
    """The level of limits at single frequencies that hold whole curves."""

    level: float
    error: float  # Monte Carlo standard error
    shifts: Array  # (B,) by how many SDs each batch of draws would move the limits out


@dataclass(frozen=True, eq=False)
class _Intervals:
    """Intervals of k that balls cover at M frequencies on N lines; ends as F(k, b) of the table."""

    start: Array  # (C, N, M) by each of C tables
    end: Array  # (C, N, M)


@dataclass(frozen=True, eq=False)
class _Gaps:
    """What outer intervals share outside all holes, on N lines, from left to right."""

    size: Array  # (C, N, M + 1) probability of each gap; zero where holes overlap
    closing: Indices  # (C, N, M) frequency whose hole begins where a gap ends; not of the last gap
    opening: Indices  # (C, N, M) frequency whose hole ends where a gap begins; not of the first


@dataclass(frozen=True, eq=False)
class _Leaving:
    """Curves that leave their limits."""

    probability: Array  # (C,) for each of C tables
    binding: Flags  # (M,) frequencies at which some curve leaves that stays inside elsewhere


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
    def leaving_at(score: float) -> _Leaving:
        return _curves_leaving(magnitude, magnitude.log_limits(score)[None], table)

    @functools.cache
    def log_excess(score: float) -> float:
        """Return the log of how many times too many curves leave."""
        (probability,) = leaving_at(score).probability
        ratio = max(probability, _TINY) / allowed
        return float(np.log(ratio))

    if first > farthest or log_excess(farthest) > 0.0:
        raise RefusalError(f"no limits at single frequencies hold whole curves at {level:g}.")
    score = first
    # How fast log p falls with the score. A normal's log tail falls by about its own score.
    fall = first
    first_excess = log_excess(first)
    if first_excess > 0.0:
        end = _score_that_holds(log_excess, first, first_excess / fall, farthest)
        solved = optimize.brentq(log_excess, first, end, xtol=_ACCURACY)
        score = min(max(solved, first + _SLOPE_BASE), farthest)
        fall = (first_excess - log_excess(score)) / (score - first)
    # Where the first score suffices, curves leave less often than allowed. The level then stands at
    # its least, and its error is that of a level which just suffices: more than it has.
    binding = leaving_at(score).binding
    # The level is what is reported, and `limits(level)` starts from its score: rounding makes that
    # another number in the last digit, for which limits are solved here once and then found again.
    score = score_of(level_of(score))
    changes = _batch_changes(magnitude, score, binding)
    shifts = changes / (fall * allowed)
    levels_per_score = 2.0 * float(density(score))
    error = levels_per_score * float(magnitude.law.standard_error(shifts))
    return SimultaneousLevel(level_of(score), error, shifts)


def _score_that_holds(
    log_excess: Callable[[float], float], first: float, step: float, farthest: float
) -> float:
    """Step out from the first score until curves stay inside; they do at the farthest."""
    for _ in range(_MOST_STEPS):
        score = min(first + step, farthest)
        if log_excess(score) <= 0.0:
            return score
        step *= _LONGER
    return farthest


def _batch_changes(magnitude: Magnitude, score: float, binding: Flags) -> Array:
    """Return by how much each batch of draws changes the probability that a curve leaves, (B,).

    A batch has its own limits at a score, and its own table. Those limits lie `batch_shifts`
    farther out along the curve of limits over the score, so that they need not be solved for. That
    curve goes through the scores solved so far, of which the search has left two or more. Limits
    that do not bind end no gap, and a small move of them changes nothing: they are left out.
    """
    shifts = magnitude.batch_shifts(score)
    shifts = np.moveaxis(shifts, -1, 0)
    moved = magnitude.log_limits_between(score + shifts)
    of_all_draws = magnitude.log_limits(score)
    log_limits = np.concatenate([of_all_draws[None], moved])
    of_k, _ = magnitude.law.by_batch
    tables = np.moveaxis(of_k, -1, 0)
    leaving = _curves_leaving(magnitude, log_limits, tables, binding)
    of_all, of_batches = np.split(leaving.probability, [1])
    return np.asarray(of_batches - of_all)


def _curves_leaving(
    magnitude: Magnitude, log_limits: Array, tables: Array, chosen: Flags | slice = slice(None)
) -> _Leaving:
    """Return the curves that leave log limits (C, 2, M) at some of the chosen frequencies.

    The C tables (C, N, inner) hold the probability of k up to a place, on N lines of one b each.
    """
    k = magnitude.balls.k.at(chosen)
    b = magnitude.balls.b.at(chosen)
    lines = np.linspace(0.0, 1.0, tables.shape[1])
    b_term = b.of_place(lines[:, None])
    b_squared = b_term**2

    def covered(log_radius: Array) -> _Intervals:
        radius_squared = np.exp(2.0 * log_radius[:, None])
        # A ball that does not reach the line leaves it an interval without width.
        difference = radius_squared - b_squared
        leg = np.sqrt(np.maximum(difference, 0.0))
        start = _probability_up_to(tables, k.place(-leg))
        end = _probability_up_to(tables, k.place(leg))
        return _Intervals(start, end)

    holes = covered(log_limits[:, 0, chosen])
    outer = covered(log_limits[:, 1, chosen])
    gaps = _gaps(outer, holes)
    on_line = gaps.size.sum(axis=-1)
    spacing = lines[1] - lines[0]
    staying = np.trapezoid(on_line, dx=spacing, axis=-1)
    return _Leaving(1.0 - staying, _binding(outer, gaps))


def _gaps(outer: _Intervals, holes: _Intervals) -> _Gaps:
    """Return the gaps between holes, within the common part of the outer intervals."""
    low = outer.start.max(axis=-1, keepdims=True)
    high = outer.end.min(axis=-1, keepdims=True)
    order = holes.start.argsort(axis=-1)
    hole_start = np.take_along_axis(holes.start, order, -1)
    hole_end = np.take_along_axis(holes.end, order, -1)
    # Holes overlap: a gap starts where the farthest end of all holes so far lies.
    farthest_end = np.maximum.accumulate(hole_end, axis=-1)
    starts = np.concatenate([low, farthest_end], axis=-1)
    ends = np.concatenate([hole_start, high], axis=-1)
    starts = np.maximum(starts, low)
    ends = np.minimum(ends, high)
    farthest = _index_of_running_maximum(hole_end, farthest_end)
    return _Gaps(
        size=np.maximum(ends - starts, 0.0),
        closing=order,
        # The hole that reaches farthest ends where the gap begins.
        opening=np.take_along_axis(order, farthest, -1),
    )


def _index_of_running_maximum(values: Array, running_maximum: Array) -> Indices:
    """Return where along the last axis each running maximum was met; of equals, the last place."""
    position = np.arange(values.shape[-1])
    met = np.where(values == running_maximum, position, 0)
    return np.maximum.accumulate(met, axis=-1)


def _binding(outer: _Intervals, gaps: _Gaps) -> Flags:
    """Return the frequencies (M,) whose limits end a gap on some line."""
    frequencies = gaps.closing.shape[-1]
    binding = np.zeros(frequencies, dtype=bool)
    binding[outer.start.argmax(axis=-1)] = True
    binding[outer.end.argmin(axis=-1)] = True
    is_open = gaps.size > 0.0
    closed_by_hole = is_open[..., :-1]
    opened_by_hole = is_open[..., 1:]
    binding[gaps.closing[closed_by_hole]] = True
    binding[gaps.opening[opened_by_hole]] = True
    return binding


def _probability_up_to(tables: Array, place: Array) -> Array:
    """Interpolate the rows of tables (C, N, inner) at places (C, N, M)."""
    count, rows, columns = tables.shape
    cell, fraction = cell_and_fraction(place, columns)
    first_of_row = np.arange(0, tables.size, columns)
    point = first_of_row.reshape(count, rows, 1) + cell
    return between(tables.ravel(), point, fraction)
