"""Frequencies at which straight lines in log-log between them stand for the curves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError

__all__ = ["FLOOR", "TOLERANCE", "Grid", "adaptive_grid", "departure"]

Array = NDArray[np.float64]

#: Largest relative distance of the lines from the curves.
TOLERANCE = 1e-3
#: Below this share of the largest curve at an omega a curve counts as this share: it may dip to zero, which
#: no number of lines in log-log can follow.
FLOOR = 1e-3
_PER_DECADE = 8
_MOST = 4096
# A corner of a curve near one end of an interval lies up to twice as far from the lines through the middle,
# once that is a point, as the middle lay from the line before.
_CORNER = 2.0


@dataclass(frozen=True, eq=False)
class Grid:
    """Curves at frequencies chosen for them.

    Attributes
    ----------
    omega : ndarray, shape (M,)
        rad/s, increasing.
    values : ndarray, shape (C, M)
        The curves there.
    departure : float
        Bound of the relative distance of lines between the points from the curves followed, by what was seen
        while halving; above the tolerance where 4096 points did not suffice.
    """

    omega: Array
    values: Array
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

    Parameters
    ----------
    curves : callable
        Frequencies (M,), rad/s, to curves (C, M), zero or more; asked for new frequencies only.
    lower, upper : float
        Range, rad/s, 0 < lower < upper.
    tolerance : float
        Largest relative distance from any curve.
    including : ndarray, optional
        Frequencies to start from as well, such as resonances; those outside the range are left out.
    followed : ndarray of bool, shape (C,), optional
        Which curves the points are chosen for; all by default. Quantiles of draws are rough on a small scale,
        and would ask for points without end.

    Returns
    -------
    Grid

    Raises
    ------
    UsageError
        A range that is not 0 < lower < upper, or a tolerance outside (0, 1).
    """
    if not 0.0 < lower < upper:
        raise UsageError("frequencies must satisfy 0 < lower < upper, in rad/s.", value=(lower, upper))
    if not 0.0 < tolerance < 1.0:
        raise UsageError("tolerance must lie in (0, 1).", value=tolerance)
    count = max(3, int(np.ceil(_PER_DECADE * np.log10(upper / lower))) + 1)
    extra = np.empty(0) if including is None else np.asarray(including, dtype=float)
    extra = extra[(extra > lower) & (extra < upper)]
    omega = np.unique(np.concatenate([np.geomspace(lower, upper, count), extra]))
    values = curves(omega)
    rows = np.ones(len(values), dtype=bool) if followed is None else followed
    left = np.arange(omega.size - 1)
    farthest = 0.0
    while left.size:
        middle = np.sqrt(omega[left] * omega[left + 1])
        found = curves(middle)
        off = _CORNER * departure(omega, values[rows], middle, found[rows])
        split = (off > tolerance) & (omega.size < _MOST)
        farthest = max(farthest, float(off[~split].max(initial=0.0)))
        at = left + 1
        omega, values = np.insert(omega, at, middle), np.insert(values, at, found, axis=1)
        new = left + np.arange(left.size)
        left = np.sort(np.concatenate([new[split], new[split] + 1]))
    return Grid(omega, values, farthest)


def departure(omega: Array, values: Array, at: Array, true: Array) -> Array:
    """Measure how far lines in log-log lie from curves, the worst of them at each frequency.

    Parameters
    ----------
    omega, values : ndarray, shapes (M,) and (C, M)
        Points of the lines.
    at, true : ndarray, shapes (N,) and (C, N)
        Where to look, and the curves there.

    Returns
    -------
    ndarray, shape (N,)
        Largest abs(log(line/curve)); values below `FLOOR` of the largest curve count as that.
    """
    x, where = np.log(omega), np.log(at)
    right = np.clip(np.searchsorted(x, where), 1, x.size - 1)
    share = (where - x[right - 1]) / (x[right] - x[right - 1])
    logs = np.log(_raised(values))
    line = logs[:, right - 1] + share * (logs[:, right] - logs[:, right - 1])
    return np.abs(line - np.log(_raised(true))).max(axis=0)


def _raised(values: Array) -> Array:
    return np.maximum(values, FLOOR * values.max(axis=0))
