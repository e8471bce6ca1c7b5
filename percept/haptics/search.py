"""Where a search looks and how it ends: frequencies of a device; minima, roots and intervals of curves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from percept.errors import UsageError
from percept.haptics.arrays import BoolArray, FloatArray, IntArray, ratio
from percept.haptics.impedance import omega_of_rate
from percept.haptics.records import AnyDevice, Device, Mode, TabulatedDevice

__all__ = [
    "Intervals",
    "Lowest",
    "covers_range",
    "lowest",
    "rising_root",
    "search_grid",
    "section_minimum",
    "where_positive",
]

# A table may leave out this fraction of the range up to Nyquist at either end.
_COVERED = 1e-3
# Points of a search between DC and Nyquist, evenly spaced and as many evenly in the logarithm.
_SPACED = 600
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


def search_grid(device: AnyDevice, period: float) -> FloatArray:
    """Return ω at which no feature of a device is missed.

    Parameters
    ----------
    device : Device or TabulatedDevice
        Its modes, or the rows of its table, add to an even grid.
    period : float
        Sampling period T, s.

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
    parts = [
        np.array([0.0]),
        np.geomspace(1e-6, 1, _SPACED) * nyquist,
        np.linspace(0, 1, _SPACED) * nyquist,
    ]
    first, last = 0.0, nyquist
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
        parts += [_around(mode, period) for mode in device.modes if mode.mass and mode.stiffness]
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= first) & (omega <= last)]


def _around(mode: Mode, period: float) -> FloatArray:
    """Return ω, rad/s, about the resonance of a mode."""
    rate = float(np.sqrt(mode.stiffness / mode.mass))
    width = float(mode.damping / mode.mass) + _NARROWEST * rate
    rates = rate + width * np.concatenate([-_OFFSETS, [0.0], _OFFSETS])
    return omega_of_rate(np.maximum(rates, 0.0), period)


@dataclass(frozen=True, eq=False)
class Lowest:
    """Least values of n functions, shape (n,), and where they are."""

    value: FloatArray
    x: FloatArray


def lowest(
    function: Callable[[FloatArray, IntArray], FloatArray], grid: FloatArray, count: int
) -> Lowest:
    """Return the least value of each of many functions; each dip seen on a grid is refined.

    Of dips seen the wrong one may look lower on the grid.

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
    seen = np.broadcast_to(function(grid[:, None], np.arange(count)), (grid.size, count))
    with np.errstate(invalid="ignore"):
        falls = seen[:-1] - seen[1:] > _ROUNDING * np.abs(seen[1:])
    ends = np.ones((1, count), dtype=bool)
    falls_before = np.concatenate([ends, falls])
    rises_after = np.concatenate([~falls, ends])
    dips, which = np.nonzero(falls_before & rises_after)
    low, high = grid[np.maximum(dips - 1, 0)], grid[np.minimum(dips + 1, grid.size - 1)]
    between = section_minimum(lambda x: function(x, which), low, high)
    refined = function(between[None], which)[0]
    # The grid's own point stays where it is as low: at the ends of the range a section stops short.
    better = refined < seen[dips, which]
    values = np.where(better, refined, seen[dips, which])
    x = np.where(better, between, grid[dips])
    order = np.lexsort((values, which))
    first = order[np.flatnonzero(np.diff(which[order], prepend=-1))]
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
        low, high = x[best - 1, column], x[best + 1, column]
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
    x, low, high = start.copy(), low.copy(), high.copy()
    open_roots = np.arange(x.size)
    for _ in range(_STEPS):
        before = x[open_roots]
        value, slope = function(open_roots, before)
        low[open_roots] = np.where(value < 0, before, low[open_roots])
        high[open_roots] = np.where(value > 0, before, high[open_roots])
        bottom, top = low[open_roots], high[open_roots]
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = before - value / slope
        inside = (slope > 0) & (newton >= bottom) & (newton <= top)
        after = np.where(inside, newton, (bottom + top) / 2)
        after = np.where(value == 0, before, after)
        x[open_roots] = after
        open_roots = open_roots[np.abs(after - before) > _LAST_STEP * np.abs(after)]
        if not open_roots.size:
            break
    return x


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals of k_c on lines of b_c, shape (lines, n); where `kept`, `low` to `high`, increasing."""

    low: FloatArray  # N/m
    high: FloatArray  # N/m
    kept: BoolArray

    @classmethod
    def left_by(cls, ceiling: FloatArray, forbidden: FloatArray) -> Intervals:
        """Take open intervals (lines, cuts, 2) out of [0, ceiling] of each line; NaN forbids nothing."""
        absent = np.isnan(forbidden).any(axis=2)
        starts = np.where(absent, np.inf, forbidden[..., 0])
        ends = np.where(absent, -np.inf, forbidden[..., 1])
        order = starts.argsort(axis=1)
        starts = np.take_along_axis(starts, order, axis=1)
        ends = np.take_along_axis(ends, order, axis=1)
        # What is left lies before, between and behind the cuts: from the farthest end so far to
        # the next start.
        column = np.zeros((ceiling.size, 1))
        high = np.minimum(np.concatenate([starts, column + np.inf], axis=1), ceiling[:, None])
        low = np.maximum.accumulate(np.concatenate([column, ends], axis=1), axis=1)
        # After a cut that forbids nothing the same interval would stand again.
        repeated = np.concatenate([column > 0, high[:, 1:] == high[:, :-1]], axis=1)
        return cls(low, high, (high > low) & ~repeated & (ceiling > 0)[:, None])

    def inset(self, fraction: float) -> Intervals:
        """Pull both ends inside by a fraction of the value, at most to the middle; 0 stays."""
        low, high = np.where(self.kept, self.low, 0.0), np.where(self.kept, self.high, 0.0)
        half_width = (high - low) / 2
        low, high = (
            low + np.minimum(half_width, fraction * low),
            high - np.minimum(half_width, fraction * high),
        )
        return Intervals(low, high, self.kept.copy())

    def lines(self) -> tuple[FloatArray, ...]:
        """Return the intervals of each line, shape (m, 2)."""
        pairs = np.stack([self.low[self.kept], self.high[self.kept]], axis=1)
        return tuple(np.split(pairs, np.cumsum(self.kept.sum(axis=1))[:-1]))

    def largest(self) -> FloatArray:
        """Return the largest k_c of each line; −inf without any."""
        return np.where(self.kept, self.high, -np.inf).max(axis=1)

    def smallest(self) -> FloatArray:
        """Return the smallest k_c of each line; inf without any."""
        return np.where(self.kept, self.low, np.inf).min(axis=1)


def where_positive(a: FloatArray, half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return where a·k² + 2·half_b·k + c > 0: two open intervals (low, high), NaN where absent.

    The result has shape (..., 2, 2): which interval, which end.
    """
    # A line counts as a parabola that bends down, with its other root at infinity.
    a = np.where(a == 0, -0.0, a)
    always = (a == 0) & (half_b == 0) & (c > 0)
    discriminant = half_b**2 - a * c
    real = discriminant > 0
    # The root of larger size, and the other by the product of both: neither cancels.
    root = half_b + np.copysign(np.sqrt(np.where(real, discriminant, 0.0)), half_b)
    first, second = ratio(-root, a, empty=np.nan), ratio(-c, root, empty=np.nan)
    low, high = np.fmin(first, second), np.fmax(first, second)
    convex = a > 0
    outside = convex & real
    between = ~convex & real
    everywhere = (convex & ~real) | always
    intervals = np.full((*low.shape, 2, 2), np.nan)
    intervals[between, 0, 0] = low[between]
    intervals[between, 0, 1] = high[between]
    intervals[outside, 0, 0] = -np.inf
    intervals[outside, 0, 1] = low[outside]
    intervals[outside, 1, 0] = high[outside]
    intervals[outside, 1, 1] = np.inf
    intervals[everywhere, 0, 0] = -np.inf
    intervals[everywhere, 0, 1] = np.inf
    return intervals
