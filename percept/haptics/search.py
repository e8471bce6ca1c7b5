"""Where a search looks and how it ends: frequencies of a device; minima, roots and gaps of many curves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from percept.errors import UsageError
from percept.haptics.arrays import BoolArray, FloatArray, IntArray, ratio
from percept.haptics.records import AnyDevice, Device, TabulatedDevice

# A table may leave out this fraction of the range up to Nyquist at either end.
_COVERED = 1e-3
# Where a mode is looked at, in its widths to either side of its resonance.
_OFFSETS = np.geomspace(1e-2, 1e3, 60)
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
    """Say whether a device is known from DC to Nyquist; a table may leave out a thousandth at either end."""
    if isinstance(device, Device):
        return True
    nyquist = np.pi / period
    return bool(
        device.omega[0] <= _COVERED * nyquist and device.omega[-1] >= (1 - _COVERED) * nyquist
    )


def search_grid(device: AnyDevice, period: float) -> FloatArray:
    """Return ω from DC to Nyquist, or over a table, fine enough to see every mode of a device."""
    nyquist = np.pi / period
    parts = [
        np.array([0.0]),
        np.geomspace(1e-6, 1, 600) * nyquist,
        np.linspace(0, 1, 600) * nyquist,
    ]
    first, last = 0.0, nyquist
    if isinstance(device, TabulatedDevice):
        first, last = float(device.omega[0]), min(float(device.omega[-1]), nyquist)
        if first > nyquist:
            raise UsageError(
                "the device's table begins above the Nyquist frequency.",
                value=first,
                hint="Check the sampling period and the unit of omega (rad/s, not Hz).",
            )
        parts.append(device.omega)
    else:
        for mode in device.modes:
            if mode.mass and mode.stiffness:
                rate = float(np.sqrt(mode.stiffness / mode.mass))
                width = float(mode.damping / mode.mass) + 1e-6 * rate
                around = rate + width * np.concatenate([-_OFFSETS, [0.0], _OFFSETS])
                parts.append((2 / period) * np.arctan(np.maximum(around, 0.0) * period / 2))
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= first) & (omega <= last)]


def lowest(
    function: Callable[[FloatArray, IntArray], FloatArray], grid: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return the least value of each of `count` functions, and where; each dip seen on a grid is refined.

    `function` takes x (points, n) and which n of the functions to evaluate, and returns values of
    that shape. Of dips seen the wrong one may look lower on the grid.
    """
    seen = np.broadcast_to(function(grid[:, None], np.arange(count)), (grid.size, count))
    with np.errstate(invalid="ignore"):
        falls = seen[:-1] - seen[1:] > _ROUNDING * np.abs(seen[1:])
    ends = np.ones((1, count), dtype=bool)
    dips, which = np.nonzero(np.concatenate([ends, falls]) & np.concatenate([~falls, ends]))
    low, high = grid[np.maximum(dips - 1, 0)], grid[np.minimum(dips + 1, grid.size - 1)]
    at = section_minimum(lambda x: function(x, which), low, high)
    refined = function(at[None], which)[0]
    # The grid's own point stays where it is as low: at the ends of the range a section stops short.
    better = refined < seen[dips, which]
    values, x = np.where(better, refined, seen[dips, which]), np.where(better, at, grid[dips])
    order = np.lexsort((values, which))
    first = order[np.flatnonzero(np.diff(which[order], prepend=-1))]
    return values[first], x[first]


def section_minimum(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a minimum of `function` inside each bracket (low, high), shape (n,), by many points at a time.

    `function` takes and returns arrays of shape (points, n). Where several points are equally low,
    the first decides.
    """
    fractions = np.linspace(0.0, 1.0, _POINTS + 2)[:, None]
    every = np.arange(low.size)
    for _ in range(_ROUNDS):
        x = low + fractions * (high - low)
        best = function(x[1:-1]).argmin(axis=0) + 1
        low, high = x[best - 1, every], x[best + 1, every]
    return (low + high) / 2


def rising_root(
    function: Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]],
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Return where each of n functions rises through zero, by Newton's method kept inside (low, high).

    `function` takes which of them to evaluate, and at which x, and returns values and slopes.
    """
    x, low, high = start.copy(), low.copy(), high.copy()
    left = np.arange(x.size)
    for _ in range(_STEPS):
        here = x[left]
        value, slope = function(left, here)
        low[left] = np.where(value < 0, here, low[left])
        high[left] = np.where(value > 0, here, high[left])
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = here - value / slope
        inside = (slope > 0) & (newton >= low[left]) & (newton <= high[left])
        after = np.where(inside, newton, (low[left] + high[left]) / 2)
        x[left] = after = np.where(value == 0, here, after)
        left = left[np.abs(after - here) > _LAST_STEP * np.abs(after)]
        if not left.size:
            break
    return x


@dataclass(frozen=True, eq=False)
class Gaps:
    """Qualifying intervals of k_c on lines of b_c; where `kept`, `low` to `high`, increasing, N/m."""

    low: FloatArray
    high: FloatArray
    kept: BoolArray

    @classmethod
    def of(cls, ceiling: FloatArray, forbidden: FloatArray) -> Gaps:
        """Take open intervals (lines, cuts, 2) out of [0, ceiling] of each line; NaN forbids nothing."""
        absent = np.isnan(forbidden).any(axis=2)
        starts = np.where(absent, np.inf, forbidden[..., 0])
        ends = np.where(absent, -np.inf, forbidden[..., 1])
        order = starts.argsort(axis=1)
        starts, ends = (
            np.take_along_axis(starts, order, axis=1),
            np.take_along_axis(ends, order, axis=1),
        )
        none = np.zeros((ceiling.size, 1))
        high = np.minimum(np.concatenate([starts, none + np.inf], axis=1), ceiling[:, None])
        low = np.maximum.accumulate(np.concatenate([none, ends], axis=1), axis=1)
        # After an interval that forbids nothing the same gap would stand again.
        again = np.concatenate([none > 0, high[:, 1:] == high[:, :-1]], axis=1)
        return cls(low, high, (high > low) & ~again & (ceiling > 0)[:, None])

    def inset(self, fraction: float) -> Gaps:
        """Pull both ends inside by a fraction of the value, at most to the middle; 0 stays."""
        low, high = np.where(self.kept, self.low, 0.0), np.where(self.kept, self.high, 0.0)
        half = (high - low) / 2
        low, high = low + np.minimum(half, fraction * low), high - np.minimum(half, fraction * high)
        return Gaps(low, high, self.kept.copy())

    def lines(self) -> tuple[FloatArray, ...]:
        """Return the intervals of each line, shape (m, 2)."""
        pairs = np.stack([self.low[self.kept], self.high[self.kept]], axis=1)
        return tuple(np.split(pairs, np.cumsum(self.kept.sum(axis=1))[:-1]))

    def costs(self) -> FloatArray:
        """Return −(largest k_c) and the smallest k_c of each line, shape (2, lines); inf without any."""
        largest = np.where(self.kept, -self.high, np.inf).min(axis=1)
        return np.stack([largest, np.where(self.kept, self.low, np.inf).min(axis=1)])


def where_positive(a: FloatArray, half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return where a·k² + 2·half_b·k + c > 0: two open intervals, NaN where absent; shape (..., 4)."""
    # A line counts as a parabola that bends down, with its other root at infinity.
    a = np.where(a == 0, -0.0, a)
    always = (a == 0) & (half_b == 0) & (c > 0)
    discriminant = half_b**2 - a * c
    real = discriminant > 0
    root = half_b + np.copysign(np.sqrt(np.where(real, discriminant, 0.0)), half_b)
    one, other = ratio(-root, a, empty=np.nan), ratio(-c, root, empty=np.nan)
    low, high = np.fmin(one, other), np.fmax(one, other)
    convex = a > 0
    outside, between = convex & real, ~convex & real
    ends = np.empty((*low.shape, 4))
    ends[..., 0] = np.where(convex | always, -np.inf, np.where(between, low, np.nan))
    ends[..., 1] = np.where(convex | always, np.inf, np.where(between, high, np.nan))
    ends[outside, 1] = low[outside]
    ends[..., 2] = np.where(outside, high, np.nan)
    ends[..., 3] = np.where(outside, np.inf, np.nan)
    return ends
