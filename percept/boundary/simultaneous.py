"""Limits between which whole curves of abs(Z_h) lie: the level that they need at single frequencies.

Limits at a higher level than requested hold whole curves at the requested level. The level is
searched for by the probability that a curve leaves its limits at one frequency or more.

On a line of one value of b a curve is one value of k. Its limits at one frequency are two balls, and
each ball covers an interval of the line. A curve stays inside if k lies in the outer interval of
every frequency and in none of the inner ones, called holes. What is left of the line are gaps:

    outer intervals    [-----------------------------------]
                    [----------------------------------]
    common part        |low                            |high
    holes                    ####      ######
                                          #####
    gaps               |0----|  |1-----|       |2------|

The tables hold the probability of k up to a place on each line. So the probability of a gap is a
difference of two of their values, and the curves that stay are the sum of all gaps over all lines.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

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
# 2.6 SDs. The score also moves by at least so much, which keeps the quotient of differences finite.
_ACCURACY = 0.003
# Each step out is so much longer than the one before, until curves stay inside.
_LONGER = 1.5
# Steps out before the farthest score is taken: the last would be 1e5 times the first.
_MOST_STEPS = 30
_TINY = np.finfo(np.float64).tiny


@dataclasses.dataclass(frozen=True, eq=False)
class SimultaneousLevel:
    """The level of limits at single frequencies that hold whole curves."""

    level: float
    error: float  # Monte Carlo standard error
    shifts: Array  # (B,) by how many SDs each batch of draws would move the limits out


@dataclasses.dataclass(frozen=True, eq=False)
class _Intervals:
    """Intervals of k that balls cover at M frequencies on N lines; ends as probabilities of k."""

    start: Array  # (C, N, M) for each of C tables
    end: Array  # (C, N, M)


@dataclasses.dataclass(frozen=True, eq=False)
class _Gaps:
    """What the common part of outer intervals has outside all holes, on N lines."""

    size: Array  # (C, N, M + 1) probability between each hole and the next
    order: Indices  # (C, N, M) frequencies in the order in which their holes start
    deepest: Indices  # (C, N, M) frequency whose hole reaches farthest, of this and those before


@dataclasses.dataclass(frozen=True, eq=False)
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
    first = score_of(level)
    allowed = 1.0 - level
    farthest = magnitude.farthest_score
    table = magnitude.law.cumulated[0][None]

    @functools.cache
    def leaving_at(score: float) -> _Leaving:
        return _curves_leaving(magnitude, magnitude.log_limits(score)[None], table)

    @functools.cache
    def log_excess(score: float) -> float:
        """Return the log of how many times too many curves leave."""
        probability = float(leaving_at(score).probability[0])
        return float(np.log(max(probability, _TINY) / allowed))

    if first > farthest or log_excess(farthest) > 0.0:
        raise RefusalError(f"no limits at single frequencies hold whole curves at {level:g}.")
    score = first
    # The log tail of a normal falls about as fast as its score.
    fall = first
    first_excess = log_excess(first)
    if first_excess > 0.0:
        end = _score_that_holds(log_excess, first, first_excess / fall, farthest)
        solved = float(optimize.brentq(log_excess, first, end, xtol=_ACCURACY))
        # Two scores nearer each other would say nothing about the fall between them.
        score = max(first + _ACCURACY, solved)
        fall = (first_excess - log_excess(score)) / (score - first)
    binding = leaving_at(score).binding
    # Round-trip through the level, so `limits(level)` hits the cache.
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

    A batch moves the limits, along their curve over the score, and the probabilities alike.
    """
    shifts = np.moveaxis(magnitude.batch_shifts(score), -1, 0)
    moved = magnitude.log_limits_between(score + shifts)
    log_limits = np.concatenate([magnitude.log_limits(score)[None], moved])
    tables = np.moveaxis(magnitude.law.by_batch[0], -1, 0)
    probability = _curves_leaving(magnitude, log_limits, tables, binding).probability
    return np.asarray(probability[1:] - probability[0])


def _curves_leaving(
    magnitude: Magnitude, log_limits: Array, tables: Array, chosen: Flags | slice = slice(None)
) -> _Leaving:
    """Return the curves that leave log limits (C, 2, M) at some of the chosen frequencies.

    The C tables (C, N, inner) hold the probability of k up to a place, on N lines of one b each.
    """
    k = magnitude.balls.k.at(chosen)
    b = magnitude.balls.b.at(chosen)
    lines = np.linspace(0.0, 1.0, tables.shape[1])
    b_squared = b.of_place(lines[:, None]) ** 2

    def covered(log_radius: Array) -> _Intervals:
        radius_squared = np.exp(2.0 * log_radius[:, None])
        # A ball that does not reach the line leaves it an interval without width.
        leg = np.sqrt(np.maximum(radius_squared - b_squared, 0.0))
        start = _probability_up_to(tables, k.place(-leg))
        end = _probability_up_to(tables, k.place(leg))
        return _Intervals(start, end)

    holes = covered(log_limits[:, 0, chosen])
    outer = covered(log_limits[:, 1, chosen])
    gaps = _gaps(outer, holes)
    spacing = lines[1]
    staying = np.trapezoid(gaps.size.sum(axis=-1), dx=spacing, axis=-1)
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
    size = np.minimum(ends, high) - np.maximum(starts, low)
    position = np.arange(order.shape[-1])
    reaches_farthest = np.where(hole_end == farthest_end, position, 0)
    deepest = np.maximum.accumulate(reaches_farthest, axis=-1)
    return _Gaps(
        size=np.maximum(size, 0.0),
        order=order,
        deepest=np.take_along_axis(order, deepest, -1),
    )


def _binding(outer: _Intervals, gaps: _Gaps) -> Flags:
    """Return the frequencies (M,) whose limits end a gap on some line."""
    binding = np.zeros(gaps.order.shape[-1], dtype=bool)
    binding[outer.start.argmax(axis=-1)] = True
    binding[outer.end.argmin(axis=-1)] = True
    open_gaps = gaps.size > 0.0
    # Each gap but the last ends where a hole starts; each but the first starts where one ended.
    binding[gaps.order[open_gaps[..., :-1]]] = True
    binding[gaps.deepest[open_gaps[..., 1:]]] = True
    return binding


def _probability_up_to(tables: Array, place: Array) -> Array:
    """Interpolate the rows of tables (C, N, inner) at places (C, N, M)."""
    count, rows, columns = tables.shape
    cell, fraction = cell_and_fraction(place, columns)
    row = np.arange(count * rows).reshape(count, rows, 1)
    return between(tables.ravel(), row * columns + cell, fraction)
