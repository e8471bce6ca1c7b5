"""Local minima of a function of one variable, refined from a grid."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.haptics._arrays import FloatArray

IntArray: TypeAlias = NDArray[np.intp]

_GOLDEN = (np.sqrt(5) - 1) / 2
# A minimum is flat: a relative 1e-9 in its place is 1e-18 in its value.
_NARROWINGS = 48
# With sixteen places at once a bracket shrinks to 2/17: eleven rounds are worth as many narrowings.
_PLACES = 16
_ROUNDS = 11
# Newton's error is squared by the next step: after one so short the place is exact.
_LAST_STEP = 1e-9
_STEPS = 60


def local_minima(function: Callable[[FloatArray], FloatArray], grid: FloatArray) -> FloatArray:
    """Return where `function` has a local minimum, one place for each dip seen on an increasing grid."""
    seen = function(grid)
    padded = np.concatenate([[np.inf], seen, [np.inf]])
    dips = np.flatnonzero((seen <= padded[:-2]) & (seen <= padded[2:]) & np.isfinite(seen))
    low, high = grid[np.maximum(dips - 1, 0)], grid[np.minimum(dips + 1, grid.size - 1)]
    return golden_section(function, low, high)


def golden_section(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a minimum of `function` inside each bracket (low, high)."""
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left, at_right = function(left), function(right)
    for _ in range(_NARROWINGS):
        falls = at_left <= at_right
        low, high = np.where(falls, low, left), np.where(falls, right, high)
        # One of the two inner places is kept; only the other is new.
        new = np.where(falls, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        at_new = function(new)
        left, right = np.where(falls, new, right), np.where(falls, left, new)
        at_left, at_right = np.where(falls, at_new, at_right), np.where(falls, at_left, at_new)
    return (low + high) / 2


def wide_section(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a minimum of `function` inside each bracket (low, high), by many places at a time.

    As near as `golden_section` in a quarter of the calls, for a function that costs little more at many
    places; it takes and returns arrays of shape (places, n). Where several places are equally low, the first
    decides.
    """
    shares = np.linspace(0.0, 1.0, _PLACES + 2)[:, None]
    every = np.arange(low.size)
    for _ in range(_ROUNDS):
        places = low + shares * (high - low)
        best = function(places[1:-1]).argmin(axis=0) + 1
        low, high = places[best - 1, every], places[best + 1, every]
    return (low + high) / 2


def stationary_points(
    slopes: Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]], seen: FloatArray, reach: float
) -> FloatArray:
    """Return a minimum within `reach` of each place `seen`, by Newton's method kept inside its bracket."""
    place, low, high = seen.copy(), seen - reach, seen + reach
    left = np.arange(seen.size)
    for _ in range(_STEPS):
        here = place[left]
        first, second = slopes(left, here)
        low[left] = np.where(first < 0, here, low[left])
        high[left] = np.where(first > 0, here, high[left])
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = here - first / second
        inside = (second > 0) & (newton >= low[left]) & (newton <= high[left])
        after = np.where(inside, newton, (low[left] + high[left]) / 2)
        place[left] = np.where(first == 0, here, after)
        left = left[np.abs(place[left] - here) > _LAST_STEP]
        if not left.size:
            break
    return place
