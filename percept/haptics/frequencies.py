"""Which frequencies a device is known at, and where a search over all of them looks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from percept.errors import UsageError
from percept.haptics._arrays import FloatArray
from percept.haptics._search import local_minima
from percept.haptics.parameters import AnyDevice, Device, TabulatedDevice

__all__ = ["covers_range", "dips_and_peaks", "search_grid"]

_COVERED = 1e-3
"""A table may leave out this share of the range up to Nyquist at either end."""
# Nearer to an end of a range, as a share of it, a minimum is the end itself.
_AT_END = 1e-9


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


def dips_and_peaks(curve: Callable[[FloatArray], FloatArray], grid: FloatArray) -> FloatArray:
    """Return the ω (N,) between the ends of an increasing grid where a curve has local minima and maxima."""
    dips, peaks = local_minima(curve, grid), local_minima(lambda omega: -curve(omega), grid)
    omega = np.union1d(dips, peaks)
    return omega[(omega > (1 + _AT_END) * grid[0]) & (omega < (1 - _AT_END) * grid[-1])]
