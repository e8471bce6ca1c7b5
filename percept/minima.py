"""Minima of many functions side by side: each dip on a grid, refined inside its bracket."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Lowest", "lowest", "section_minimum"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Values nearer than this fraction differ by rounding: they show no dip.
_ROUNDING = 1e-12
# With sixteen points at once a bracket shrinks to 2/17, in eleven rounds to a relative 6e-11;
# a minimum is flat, so its value is off by the square of that.
_POINTS = 16
_ROUNDS = 11


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


def section_minimum(function: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Return a minimum of each of n functions, by many points of its bracket at a time.

    Parameters
    ----------
    function : callable
        Takes and returns arrays of shape (points, n).
    low, high : ndarray, shape (n,)
        Brackets.

    Returns
    -------
    ndarray, shape (n,)
        Where several points are equally low, near the first.
    """
    fractions = np.linspace(0.0, 1.0, _POINTS + 2)[:, None]
    column = np.arange(low.size)
    for _ in range(_ROUNDS):
        x = low + fractions * (high - low)
        best = function(x[1:-1]).argmin(axis=0) + 1
        low = x[best - 1, column]
        high = x[best + 1, column]
    return (low + high) / 2
