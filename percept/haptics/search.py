"""Where a search looks and how it ends: frequencies of a device, minima and roots of many curves at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from percept.errors import UsageError
from percept.haptics.arrays import FloatArray, IntArray
from percept.haptics.records import AnyDevice, Device, TabulatedDevice

# A table may leave out this fraction of the range up to Nyquist at either end.
_COVERED = 1e-3
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
    return bool(device.omega[0] <= _COVERED * nyquist and device.omega[-1] >= (1 - _COVERED) * nyquist)


def search_grid(device: AnyDevice, period: float, *including: float) -> FloatArray:
    """Return ω from DC to Nyquist, or over a table, fine enough to see every mode of a device."""
    nyquist = np.pi / period
    parts = [
        np.array([0.0, *including]),
        np.geomspace(1e-6, 1, 600) * nyquist,
        np.linspace(0, 1, 600) * nyquist,
    ]
    if isinstance(device, TabulatedDevice):
        first, last = float(device.omega[0]), min(float(device.omega[-1]), nyquist)
        if first > nyquist:
            raise UsageError(
                "the device's table begins above the Nyquist frequency.",
                value=first,
                hint="Check the sampling period and the unit of omega (rad/s, not Hz).",
            )
        omega = np.unique(np.concatenate([*parts, device.omega]))
        return omega[(omega >= first) & (omega <= last)]
    for mode in device.modes:
        if not (np.all(mode.mass) and np.any(mode.stiffness)):
            continue
        rate = float(np.sqrt(mode.stiffness / mode.mass))
        width = float(mode.damping / mode.mass) + 1e-6 * rate
        offsets = np.concatenate([-np.geomspace(1e-2, 1e3, 60), [0.0], np.geomspace(1e-2, 1e3, 60)])
        parts.append((2 / period) * np.arctan(np.maximum(rate + width * offsets, 0.0) * period / 2))
    omega = np.unique(np.concatenate(parts))
    return omega[omega <= nyquist]


def local_minima(function: Callable[[FloatArray], FloatArray], grid: FloatArray) -> FloatArray:
    """Return where `function` has a local minimum, one x for each dip seen on an increasing grid."""
    seen = function(grid)
    padded = np.concatenate([[np.inf], seen, [np.inf]])
    dips = np.flatnonzero((seen <= padded[:-2]) & (seen <= padded[2:]) & np.isfinite(seen))
    low, high = grid[np.maximum(dips - 1, 0)], grid[np.minimum(dips + 1, grid.size - 1)]
    return section_minimum(function, low, high)


def section_minimum(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a minimum of `function` inside each bracket (low, high), shape (n,), by many points at a time.

    `function` takes and returns arrays of shape (points, n). Where several points are equally low, the first
    decides.
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
