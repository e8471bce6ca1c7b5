"""Roots of increasing functions that are dear to evaluate and about straight."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_ITERATIONS = 60


def root(
    function: Callable[[Array], tuple[Array, Array]],
    start: Array,
    low: Array,
    high: Array,
    scale: Array,
    exact: float,
) -> Array:
    """Find the roots of Q increasing functions side by side.

    Newton's method, from the second step on by the cubic through the last two places and slopes, taken the
    other way round: x as a function of the value. Its error is of the order of the product of the squares of
    the last two steps. A step that leaves the bracket is replaced by its middle.
    """
    x, before = start, None
    last = np.ones(x.shape)
    for _ in range(_ITERATIONS):
        value, slope = function(x)
        low = np.where(value < 0, x, low)
        high = np.where(value < 0, high, x)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            newton = x - value / slope
            cubic = newton if before is None else _cubic(*before, x, value, slope)
        fast, safe = ((place >= low) & (place <= high) for place in (cubic, newton))
        after = np.where(fast, cubic, np.where(safe, newton, 0.5 * (low + high)))
        moved = np.abs(after - x) / scale
        # Of steps that are not the cubic's nothing is known but their own length.
        if np.all(moved * np.where(fast, np.minimum(last, 1.0), 1.0) <= exact):
            return after
        before, last, x = (x, value, slope), moved, after
    return x


def _cubic(x0: Array, value0: Array, slope0: Array, x1: Array, value1: Array, slope1: Array) -> Array:
    """Place of the value zero on the cubic x(value) through two places; NaN where that is far off."""
    rise = value1 - value0
    t = -value0 / rise
    back = 1.0 - t
    place = x1 + back * (back * (1.0 + 2.0 * t) * (x0 - x1) + rise * t * (back / slope0 - t / slope1))
    return np.where(np.abs(value1) < 0.5 * np.abs(value0), place, np.nan)
