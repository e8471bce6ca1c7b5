"""Roots and minima of many functions side by side, for functions whose every call is expensive.

Newton's method needs a value and a slope. From the second step on there are two of each, and the
cubic through them, taken as x over the value, is far more accurate. Posterior limits take two to
four calls this way, and twelve by `scipy.optimize.elementwise.find_root`, which uses no slopes.
Of minima each dip on a grid is refined inside its bracket.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Calls before the search ends with what it has: so many halvings of a bracket use up a double.
_MOST_STEPS = 60
#: Largest ratio of the last two values at which the cubic is trusted: the value must shrink.
_MOST_REMAINING = 0.5
#: Newton's error is squared by the next step: after one so short the root is exact.
_LAST_STEP = 1e-9
#: Bisection alone would need as many to settle a double.
_STEPS = 80
# Values nearer than this fraction differ by rounding: they show no dip.
_ROUNDING = 1e-12
# With sixteen points at once a bracket shrinks to 2/17, in eleven rounds to a relative 6e-11;
# a minimum is flat, so its value is off by the square of that.
_POINTS = 16
_ROUNDS = 11


@dataclass(frozen=True, eq=False)
class _Evaluation:
    """Values and slopes of Q functions at one point each, all (Q,)."""

    x: Array
    value: Array
    slope: Array


def root(
    function: Callable[[Array], tuple[Array, Array]],
    start: Array,
    low: Array,
    high: Array,
    scale: Array,
    most_step_product: float,
) -> Array:
    """Find the roots of Q increasing functions side by side.

    Parameters
    ----------
    function : callable
        Takes a point per function, shape (Q,); returns their values and slopes, each (Q,). Slopes
        may be poor or NaN, at the price of more calls.
    start : ndarray
        First points, shape (Q,).
    low, high : ndarray
        Brackets of the roots, shape (Q,). A step that leaves its bracket is replaced by the
        bracket's middle.
    scale : ndarray
        Unit of steps for each function, shape (Q,).
    most_step_product : float
        The search ends when the product of the last two steps, in units of `scale`, is no larger.
        The error is then about its square.

    Returns
    -------
    ndarray
        Roots, shape (Q,). They are one step past the points of the last call. After `_MOST_STEPS`
        calls the search ends without an error, with the points it has then.
    """
    x = start
    previous: _Evaluation | None = None
    # In units of `scale`. There is no step before the first: one leaves that step as it is.
    previous_step = np.ones(x.shape)
    for _ in range(_MOST_STEPS):
        current = _Evaluation(x, *function(x))
        negative = current.value < 0
        low = np.where(negative, x, low)
        high = np.where(negative, high, x)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            newton = x - current.value / current.slope
            cubic = newton if previous is None else _inverse_cubic(previous, current)
        use_cubic = (cubic >= low) & (cubic <= high)
        use_newton = (newton >= low) & (newton <= high)
        middle = 0.5 * (low + high)
        safe = np.where(use_newton, newton, middle)
        following = np.where(use_cubic, cubic, safe)
        step = np.abs(following - x) / scale
        # Only the cubic's error is known to fall with the step before.
        shrinkage = np.minimum(previous_step, 1.0)
        factor = np.where(use_cubic, shrinkage, 1.0)
        if np.all(step * factor <= most_step_product):
            return following
        previous = current
        previous_step = step
        x = following
    return x


def _inverse_cubic(first: _Evaluation, second: _Evaluation) -> Array:
    """Root of the cubic x(value) through two evaluations; NaN where the second is hardly nearer."""
    rise = second.value - first.value
    t = -first.value / rise
    back = 1.0 - t
    chord = back * (1.0 + 2.0 * t) * (first.x - second.x)
    bend = rise * t * (back / first.slope - t / second.slope)
    x = second.x + back * (chord + bend)
    nearer = np.abs(second.value) < _MOST_REMAINING * np.abs(first.value)
    return np.where(nearer, x, np.nan)


def rising_root(
    function: Callable[[Indices, Array], tuple[Array, Array]],
    start: Array,
    low: Array,
    high: Array,
) -> Array:
    """Return where each of n functions rises through zero, by Newton's method kept inside brackets.

    Parameters
    ----------
    function : callable
        Takes which of the functions to evaluate, shape (m,), and x of each; returns values and
        slopes.
    start, low, high : ndarray, shape (n,)
        First x, and the bracket it is kept in.

    Returns
    -------
    ndarray, shape (n,)
    """
    x = start.copy()
    low = low.copy()
    high = high.copy()
    open_roots = np.arange(x.size)
    for _ in range(_STEPS):
        before = x[open_roots]
        value, slope = function(open_roots, before)
        low[open_roots] = np.where(value < 0, before, low[open_roots])
        high[open_roots] = np.where(value > 0, before, high[open_roots])
        bottom = low[open_roots]
        top = high[open_roots]
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = before - value / slope
        inside = (slope > 0) & (newton >= bottom) & (newton <= top)
        after = np.where(inside, newton, (bottom + top) / 2)
        after = np.where(value == 0, before, after)
        x[open_roots] = after
        moved = np.abs(after - before) > _LAST_STEP * np.abs(after)
        open_roots = open_roots[moved]
        if not open_roots.size:
            break
    return x


def secant_root(
    function: Callable[[Indices, Array], Array],
    start: Array,
    low: Array,
    high: Array,
    *,
    known: tuple[Array, Array] | None = None,
) -> Array:
    """Return what `rising_root` does, of functions whose slopes are not known.

    The slope is that through the last two points.

    Parameters
    ----------
    function : callable
        Takes which of the functions to evaluate, shape (m,), and x of each; returns values.
    start, low, high : ndarray, shape (n,)
        First x, and the bracket it is kept in.
    known : pair of ndarray, shape (n,), optional
        A point of each function, x and its value: it gives the first step its slope.

    Returns
    -------
    ndarray, shape (n,)
    """
    unknown = np.full((2, low.size), np.nan)
    last_x, last_value = unknown if known is None else np.array(known)

    def with_slope(which: Indices, x: Array) -> tuple[Array, Array]:
        value = function(which, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (value - last_value[which]) / (x - last_x[which])
        last_x[which] = x
        last_value[which] = value
        return value, slope

    return rising_root(with_slope, start, low, high)


class Lowest(NamedTuple):
    """Least values of n functions, shape (n,), and where they are."""

    value: Array
    x: Array


def lowest(function: Callable[[Array, Indices], Array], grid: Array, count: int) -> Lowest:
    """Return the least value of each of many functions; each dip on a grid is refined.

    All dips are refined: on the grid the wrong one may look lower.

    Parameters
    ----------
    function : callable
        Takes x, shape (points, n), and which n of the functions to evaluate; returns values of that
        shape.
    grid : ndarray, shape (m,)
        Increasing x, fine enough to see every dip.
    count : int
        Number of functions.

    Returns
    -------
    Lowest
        Of shape (count,).
    """
    on_grid = function(grid[:, None], np.arange(count))
    on_grid = np.broadcast_to(on_grid, (grid.size, count))
    with np.errstate(invalid="ignore"):
        fall = on_grid[:-1] - on_grid[1:]
        falls = fall > _ROUNDING * np.abs(on_grid[1:])
    ends = np.ones((1, count), dtype=bool)
    falls_before = np.concatenate([ends, falls])
    rises_after = np.concatenate([~falls, ends])
    dips, index = np.nonzero(falls_before & rises_after)
    low = grid[np.maximum(dips - 1, 0)]
    high = grid[np.minimum(dips + 1, grid.size - 1)]
    between = section_minimum(lambda x: function(x, index), low, high)
    refined = function(between[None], index)[0]
    # The grid's own point stays where it is as low: at the ends of the range a section stops short.
    dip_values = on_grid[dips, index]
    better = refined < dip_values
    values = np.where(better, refined, dip_values)
    x = np.where(better, between, grid[dips])
    order = np.lexsort((values, index))
    _, first_of_each = np.unique(index[order], return_index=True)
    first = order[first_of_each]
    return Lowest(values[first], x[first])


def section_minimum(
    function: Callable[[Array], Array], low: Array, high: Array, *, rounds: int = _ROUNDS
) -> Array:
    """Return a minimum of each of n functions, by many points of its bracket at a time.

    Parameters
    ----------
    function : callable
        Takes and returns (points, n).
    low, high : ndarray, shape (n,)
        Brackets.
    rounds : int
        Each shrinks the brackets to 2/17.

    Returns
    -------
    ndarray, shape (n,)
        Where several points are equally low it is near the first.
    """
    fractions = np.linspace(0.0, 1.0, _POINTS + 2)[:, None]
    column = np.arange(low.size)
    for _ in range(rounds):
        x = low + fractions * (high - low)
        best = function(x[1:-1]).argmin(axis=0) + 1
        low = x[best - 1, column]
        high = x[best + 1, column]
    return (low + high) / 2
