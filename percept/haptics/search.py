"""Where a search looks and how it ends: frequencies of a device; minima and roots."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from percept.errors import UsageError
from percept.haptics.arrays import FloatArray, IntArray
from percept.haptics.axis import omega_of_rate
from percept.haptics.loop import AnyHold, hold_of
from percept.haptics.records import AnyDevice, Device, Mode, TabulatedDevice

__all__ = [
    "Lowest",
    "covers_range",
    "lowest",
    "rising_root",
    "search_grid",
    "section_minimum",
]

# A table may leave out this fraction of the range up to Nyquist at either end.
_COVERED = 1e-3
# Points of a search between DC and Nyquist, evenly spaced and as many evenly in the logarithm.
_SPACED = 600
# Points to a sample of delay: what it asks for rises and falls once in two samples.
_SPACED_PER_SAMPLE = 40
# Where a mode is looked at, in its widths to either side of its resonance.
_OFFSETS = np.geomspace(1e-2, 1e3, 60)
# A mode without damping counts as this wide, as a fraction of its resonance.
_NARROWEST = 1e-6
# Values nearer than this fraction differ by rounding: they show no dip.
_ROUNDING = 1e-12
# With sixteen points at once a bracket shrinks to 2/17, in eleven rounds to a relative 6e-11;
# a minimum is flat, so its value is off by the square of that.
_POINTS = 16
_ROUNDS = 11
# Newton's error is squared by the next step: after one so short the root is exact.
_LAST_STEP = 1e-9
# Bisection alone would need as many to settle a double.
_STEPS = 80


def covers_range(device: AnyDevice, period: float) -> bool:
    """Say whether a device is known from DC to Nyquist.

    Parameters
    ----------
    device : Device or TabulatedDevice
        A table may leave out a thousandth of the range at either end.
    period : float
        Sampling period T, s.

    Returns
    -------
    bool
    """
    if isinstance(device, Device):
        return True
    nyquist = np.pi / period
    from_dc = device.omega[0] <= _COVERED * nyquist
    to_nyquist = device.omega[-1] >= (1 - _COVERED) * nyquist
    return bool(from_dc and to_nyquist)


def search_grid(device: AnyDevice, period: float, hold: AnyHold = "average") -> FloatArray:
    """Return ω at which no feature of a device or of a delay is missed.

    Parameters
    ----------
    device : Device or TabulatedDevice
        Its modes, or the rows of its table, add to an even grid.
    period : float
        Sampling period T, s.
    hold : {"average", "true"} or Hold
        A long delay adds to the even grid.

    Returns
    -------
    ndarray, shape (n,)
        rad/s, increasing, from DC to Nyquist or over the table.

    Raises
    ------
    UsageError
        The table begins above Nyquist.
    """
    nyquist = np.pi / period
    for_delay = int(np.ceil(_SPACED_PER_SAMPLE * hold_of(hold).delay))
    parts = [
        np.array([0.0]),
        np.geomspace(1e-6, 1, _SPACED) * nyquist,
        np.linspace(0, 1, max(_SPACED, for_delay)) * nyquist,
    ]
    first = 0.0
    last = nyquist
    if isinstance(device, TabulatedDevice):
        first = float(device.omega[0])
        last = min(float(device.omega[-1]), nyquist)
        if first > nyquist:
            raise UsageError(
                "the device's table begins above the Nyquist frequency.",
                value=first,
                hint="Check the sampling period and the unit of omega (rad/s, not Hz).",
            )
        parts.append(device.omega)
    else:
        parts += [_around(mode, period) for mode in device.modes if mode.resonance]
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= first) & (omega <= last)]


def _around(mode: Mode, period: float) -> FloatArray:
    """Return ω, rad/s, about the resonance of a mode."""
    width = mode.damping / mode.mass + _NARROWEST * mode.resonance
    rates = mode.resonance + width * np.concatenate([-_OFFSETS, [0.0], _OFFSETS])
    return omega_of_rate(np.maximum(rates, 0.0), period)


class Lowest(NamedTuple):
    """Least values of n functions, shape (n,), and where they are."""

    value: FloatArray
    x: FloatArray


def lowest(
    function: Callable[[FloatArray, IntArray], FloatArray], grid: FloatArray, count: int
) -> Lowest:
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
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
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


def rising_root(
    function: Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]],
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
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
