"""Frequencies at which searches and drawings see every feature of a device, a delay, resonances."""

from __future__ import annotations

import numpy as np

from percept.errors import UsageError
from percept.haptics.arrays import FloatArray
from percept.haptics.loop import Loop, omega_of_rate
from percept.haptics.records import Mode, TabulatedDevice

__all__ = ["covers_range", "log_grid", "search_grid"]

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
# A peak or a turn needs three.
_FEWEST = 3


def covers_range(loop: Loop) -> bool:
    """Say whether a device is known from DC to Nyquist.

    A table may leave out a thousandth of the range at either end.
    """
    device = loop.device
    if not isinstance(device, TabulatedDevice):
        return True
    from_dc = device.omega[0] <= _COVERED * loop.nyquist
    to_nyquist = device.omega[-1] >= (1 - _COVERED) * loop.nyquist
    return bool(from_dc and to_nyquist)


def search_grid(
    loop: Loop, modes: tuple[Mode, ...] = (), *, within: tuple[float, float] | None = None
) -> FloatArray:
    """Return ω at which no feature of a device, of more modes or of a delay is missed.

    Parameters
    ----------
    loop : Loop
        The modes of its device, or the rows of its table, add to an even grid, and so does a long
        delay.
    modes : tuple of Mode, optional
        Others that resonate.
    within : pair of float, optional
        Ends of the grid, rad/s; by default DC and Nyquist, or the ends of the table.

    Returns
    -------
    ndarray, shape (n,)
        rad/s, increasing.

    Raises
    ------
    UsageError
        The table begins above Nyquist.
    """
    device = loop.device
    nyquist = np.pi / loop.period
    for_delay = int(np.ceil(_SPACED_PER_SAMPLE * loop.delay))
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
        modes = (*device.modes, *modes)
    parts += [_around(mode, loop.period) for mode in modes if mode.resonance]
    if within is not None:
        first, last = within
        parts.append(np.array(within))
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= first) & (omega <= last)]


def _around(mode: Mode, period: float) -> FloatArray:
    """Return ω, rad/s, about the resonance of a mode."""
    width = mode.damping / mode.mass + _NARROWEST * mode.resonance
    rates = mode.resonance + width * np.concatenate([-_OFFSETS, [0.0], _OFFSETS])
    return omega_of_rate(np.maximum(rates, 0.0), period)


def log_grid(within: tuple[float, float], per_decade: int, near: FloatArray) -> FloatArray:
    """Return ω even in the logarithm, and those near features.

    Parameters
    ----------
    within : pair of float
        First and last frequency, rad/s.
    per_decade : int
        Frequencies per decade of the even ones, at least.
    near : ndarray, shape (R,) or (D, R)
        Further frequencies, rad/s; of D devices each has its own.

    Returns
    -------
    ndarray, shape (n,) or (D, n)
        rad/s, increasing; of D devices those beyond the range stand at its ends.
    """
    lower, upper = within
    intervals = int(np.ceil(per_decade * np.log10(upper / lower)))
    even = np.geomspace(lower, upper, max(_FEWEST, intervals + 1))
    if near.ndim == 1:
        inside = near[(near > lower) & (near < upper)]
        return np.unique(np.concatenate([even, inside]))
    rows = np.tile(even, (len(near), 1))
    return np.sort(np.hstack([rows, np.clip(near, lower, upper)]), axis=1)
