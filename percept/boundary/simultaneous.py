"""Limits between which whole curves of abs(Z_h) lie: the level that they need at single frequencies.

Limits at a higher level than asked for hold whole curves at the level asked for. The level is
searched for by the probability that a curve leaves its limits at one frequency or more. On a line of
one value of b a curve is one value of k. Those that stay inside lie within the intervals of all
upper limits and outside the intervals of all lower ones. Their probability is a sum over gaps, and
the sum over all lines follows from the law's tables.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from percept.boundary.law import steps
from percept.boundary.limits import Magnitude, density, level_of, score_of
from percept.errors import RefusalError

__all__ = ["SimultaneousLevel", "simultaneous_level"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# SDs of a normal to which the level is searched: a hundredth of a per cent of usual bands.
_ACCURACY = 0.003
# Each step out is so much longer than the one before, until curves stay inside.
_LONGER = 1.5
_TINY = np.finfo(np.float64).tiny


@dataclasses.dataclass(frozen=True, eq=False)
class SimultaneousLevel:
    """The level of limits at single frequencies that hold whole curves."""

    level: float
    error: float  # Monte Carlo standard error
    shifts: Array  # (B,) by how many SDs each batch of draws would move the limits out


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
    table = magnitude.law.cumulated[0][None]

    @functools.cache
    def leaving(score: float) -> _Leaving:
        return _leaving(magnitude, magnitude.log_limits(score)[None], table)

    @functools.cache
    def excess(score: float) -> float:
        """Return the log of how many times too many curves leave."""
        return float(np.log(np.maximum(leaving(score).probability[0], _TINY) / allowed))

    farthest = magnitude.farthest_score
    if first > farthest or excess(farthest) > 0.0:
        raise RefusalError(f"no limits at single frequencies hold whole curves at {level:g}.")
    score = first
    # The log tail of a normal falls about as fast as its score.
    fall = first
    too_many = excess(first)
    if too_many > 0.0:
        step = min(too_many / fall, farthest - first)
        while excess(first + step) > 0.0:
            step = min(_LONGER * step, farthest - first)
        solved = float(optimize.brentq(excess, first, first + step, xtol=_ACCURACY))
        score = max(first + _ACCURACY, solved)
        fall = (too_many - excess(score)) / (score - first)
    binding = leaving(score).binding
    # `limits` will ask for this score, which has the level's own rounding.
    score = score_of(level_of(score))
    changes = _batch_changes(magnitude, score, binding)
    shifts = changes / (fall * allowed)
    levels_per_score = 2.0 * float(density(score))
    error = levels_per_score * float(magnitude.law.standard_error(shifts))
    return SimultaneousLevel(level_of(score), error, shifts)


def _batch_changes(magnitude: Magnitude, score: float, binding: Flags) -> Array:
    """Return by how much each batch of draws changes the probability that a curve leaves, (B,).

    A batch moves the limits, along their curve over the score, and the probabilities alike.
    """
    shifts = np.moveaxis(magnitude.batch_shifts(score), -1, 0)
    moved = magnitude.log_limits_between(score + shifts)
    logs = np.concatenate([magnitude.log_limits(score)[None], moved])
    tables = np.moveaxis(magnitude.law.by_batch[0], -1, 0)
    probability = _leaving(magnitude, logs, tables, binding).probability
    return np.asarray(probability[1:] - probability[0])


def _leaving(
    magnitude: Magnitude, logs: Array, tables: Array, chosen: Flags | slice = slice(None)
) -> _Leaving:
    """Return the curves that leave log limits (C, 2, M) at some of the chosen frequencies.

    The C tables (C, N, inner) hold the probability of k up to a place, on N lines of one b each.
    """
    k = magnitude.balls.k.at(chosen)
    b = magnitude.balls.b.at(chosen)
    lines = np.linspace(0.0, 1.0, tables.shape[1])
    squared = b.of_place(lines[:, None]) ** 2
    radius_squared = np.exp(2.0 * logs[..., chosen][:, :, None])
    # A ball that does not reach the line leaves it an interval without width.
    leg = np.sqrt(np.maximum(radius_squared - squared, 0.0))
    start = _probability_at(tables, k.place(-leg))
    end = _probability_at(tables, k.place(leg))
    # Inside all upper limits: between the last start and the first end.
    low = start[:, 1].max(axis=-1, keepdims=True)
    high = end[:, 1].min(axis=-1, keepdims=True)
    # Outside all lower limits: in the gaps between their intervals, sorted by where they start.
    order = start[:, 0].argsort(axis=-1)
    hole_start = np.take_along_axis(start[:, 0], order, -1)
    hole_end = np.take_along_axis(end[:, 0], order, -1)
    covered = np.maximum.accumulate(hole_end, axis=-1)
    gap_start = np.maximum(np.concatenate([low, covered], axis=-1), low)
    gap_end = np.minimum(np.concatenate([hole_start, high], axis=-1), high)
    gaps = np.maximum(gap_end - gap_start, 0.0)
    staying = np.trapezoid(gaps.sum(axis=-1), dx=lines[1], axis=-1)
    binding = np.zeros(order.shape[-1], dtype=bool)
    binding[start[:, 1].argmax(axis=-1)] = True
    binding[end[:, 1].argmin(axis=-1)] = True
    # A lower limit binds where its interval ends a gap, or has reached farthest before one.
    binding[order[gaps[..., :-1] > 0.0]] = True
    position = np.where(hole_end == covered, np.arange(order.shape[-1]), 0)
    reaches_farthest = np.take_along_axis(order, np.maximum.accumulate(position, axis=-1), -1)
    binding[reaches_farthest[gaps[..., 1:] > 0.0]] = True
    return _Leaving(1.0 - staying, binding)


def _probability_at(tables: Array, place: Array) -> Array:
    """Interpolate the rows of tables (C, N, inner) at places (C, 2, N, M)."""
    count, rows, columns = tables.shape
    column, part = steps(place, columns)
    table = np.arange(count)[:, None, None, None]
    row = np.arange(rows)[:, None]
    index = (table * rows + row) * columns + column
    flat = tables.ravel()
    left = flat.take(index)
    return np.asarray(left + part * (flat.take(index + 1) - left))
