"""Frequencies at which straight lines in log-log between them stand for the curves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Largest relative distance of the lines from the curves.
TOLERANCE = 1e-3
#: Below this share of the largest curve at an omega a curve counts as this share: it may dip to zero, which
#: no number of lines in log-log can follow.
FLOOR = 1e-3
_PER_DECADE = 8
_ENDLESS = 1e300  # what a pole counts as that is hit on the way
_MOST = 4096
# A corner of a curve near one end of an interval lies up to twice as far from the lines through the middle,
# once that is a point, as the middle lay from the line before.
_CORNER = 2.0
#: Intervals of a smaller ratio of frequencies, less one, are not halved: around a pole no halving would do.
_NARROWEST = 1e-9


@dataclass(frozen=True, eq=False)
class Grid:
    """Curves at frequencies chosen for them."""

    omega: Array  # (M,) rad/s, increasing
    values: Array  # (C, M) The curves there
    departure: float


def adaptive_grid(
    curves: Callable[[Array], Array],
    lower: float,
    upper: float,
    *,
    tolerance: float = TOLERANCE,
    including: Array | None = None,
    followed: NDArray[np.bool_] | None = None,
) -> Grid:
    """Choose frequencies so that lines between them in log-log follow every curve.

    Intervals of log omega are halved until the curves at their middle lie within half the tolerance of the
    line between their ends. Those middles are kept: a smooth curve then lies within an eighth of the
    tolerance, one with a corner in the interval within all of it.
    """
    (grid,) = adaptive_grids(
        lambda _, omega: curves(omega),
        1,
        lower,
        upper,
        tolerance=tolerance,
        including=including,
        followed=followed,
    )
    return grid


def adaptive_grids(
    curves: Callable[[Indices, Array], Array],
    count: int,
    lower: float,
    upper: float,
    *,
    tolerance: float = TOLERANCE,
    including: Array | None = None,
    followed: NDArray[np.bool_] | None = None,
) -> list[Grid]:
    """Choose frequencies for several sets of curves, each set its own, in as few calls as for one."""
    if not 0.0 < lower < upper:
        raise UsageError("frequencies must satisfy 0 < lower < upper, in rad/s.", value=(lower, upper))
    if not 0.0 < tolerance < 1.0:
        raise UsageError("tolerance must lie in (0, 1).", value=tolerance)
    start = _start(lower, upper, including)
    # The points of all sets stand in one row, set after set.
    owner, omega = np.repeat(np.arange(count), start.size), np.tile(start, count)
    values = curves(owner, omega)
    rows = np.ones(len(values), dtype=bool) if followed is None else followed
    finite = np.isfinite(values).all(axis=0)
    owner, omega, values = owner[finite], omega[finite], values[:, finite]
    logs = _followed(omega, values[rows])
    left = np.flatnonzero(owner[:-1] == owner[1:])
    size, farthest = np.bincount(owner, minlength=count), np.zeros(count)
    while left.size:
        middle, whose = np.sqrt(omega[left] * omega[left + 1]), owner[left]
        found = curves(whose, middle)
        true = _followed(middle, found[rows])
        off = _CORNER * _departure(logs[:, left], logs[:, left + 1], true)
        wide = logs[0, left + 1] - logs[0, left] > _NARROWEST
        split = (off > tolerance) & (size[whose] < _MOST) & wide
        seen = ~split & wide
        np.maximum.at(farthest, whose[seen], off[seen])
        size += np.bincount(whose, minlength=count)
        at = left + 1
        owner, omega = np.insert(owner, at, whose), np.insert(omega, at, middle)
        values, logs = np.insert(values, at, found, axis=1), np.insert(logs, at, true, axis=1)
        new = left + np.arange(left.size)
        left = np.sort(np.concatenate([new[split], new[split] + 1]))
    finite = np.isfinite(values).all(axis=0)
    owner, omega, values = owner[finite], omega[finite], values[:, finite]
    ends = np.cumsum(np.bincount(owner, minlength=count))[:-1]
    parts = zip(np.split(omega, ends), np.split(values, ends, axis=1), farthest.tolist(), strict=True)
    return [Grid(*part) for part in parts]


def _start(lower: float, upper: float, including: Array | None) -> Array:
    count = max(3, int(np.ceil(_PER_DECADE * np.log10(upper / lower))) + 1)
    extra = np.empty(0) if including is None else np.asarray(including, dtype=float)
    extra = extra[(extra > lower) & (extra < upper)]
    return np.unique(np.concatenate([np.geomspace(lower, upper, count), extra]))


def _followed(omega: Array, values: Array) -> Array:
    """Logarithms of omega and, below it, of the curves; those below `FLOOR` of the largest count as that."""
    finite = np.minimum(values, _ENDLESS)
    return np.log(np.vstack([omega, np.maximum(finite, FLOOR * finite.max(axis=0))]))


def _departure(left: Array, right: Array, true: Array) -> Array:
    """Measure how far lines lie from curves between two points, the worst of them in each interval."""
    share = (true[0] - left[0]) / (right[0] - left[0])
    line = left[1:] + share * (right[1:] - left[1:])
    return np.asarray(np.abs(line - true[1:]).max(axis=0))
