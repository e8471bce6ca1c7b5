"""Boundaries from draws of (k, b): each draw to abs(Z_h), then bands over the curves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.haptics import AnyDevice, perceived_magnitude

__all__ = ["pointwise_band", "simultaneous_band"]

Array = NDArray[np.float64]
_BLOCK_VALUES = 1 << 21  # curve values held at once, 16 MB


def _magnitudes(
    omega: Array, device: AnyDevice, stiffness: Array, damping: Array, period: float, hold: str
) -> Array:
    """Curves of all draws at some frequencies, shape (len(omega), N)."""
    return perceived_magnitude(omega[:, None], device, stiffness, damping, period, hold=hold)


def _blocks(omega: Array, draws: int) -> list[slice]:
    step = max(1, _BLOCK_VALUES // draws)
    return [slice(i, min(i + step, omega.size)) for i in range(0, omega.size, step)]


def pointwise_band(
    omega: Array,
    device: AnyDevice,
    stiffness: Array,
    damping: Array,
    period: float,
    *,
    level: float,
    hold: str = "average",
) -> tuple[Array, Array]:
    """Equal-tailed quantiles of abs(Z_h) at each frequency.

    Parameters
    ----------
    omega : ndarray, shape (M,)
        rad/s.
    device : Device or TabulatedDevice
        The device.
    stiffness, damping : ndarray, shape (N,)
        Draws, N/m and N·s/m.
    period : float
        Sampling period, s.
    level : float
        Level at each frequency.
    hold : str
        "average" (Eq. 8) or "true".

    Returns
    -------
    lower, upper : ndarray, shape (M,)
        N·s/m. Memory is bounded by blocks of frequencies.
    """
    tail = 0.5 * (1.0 - level)
    parts = [
        np.quantile(
            _magnitudes(omega[block], device, stiffness, damping, period, hold), [tail, 1.0 - tail], axis=1
        )
        for block in _blocks(omega, stiffness.size)
    ]
    lower, upper = np.concatenate(parts, axis=1)
    return lower, upper


def simultaneous_band(
    omega: Array,
    device: AnyDevice,
    stiffness: Array,
    damping: Array,
    period: float,
    *,
    level: float,
    hold: str = "average",
) -> tuple[Array, Array]:
    """Band exp(m ± c s) of log abs(Z_h) that holds whole curves at the level.

    m and s are the pointwise mean and SD over draws; c is the level-quantile over draws of the largest
    standardised deviation over the frequencies.

    Parameters
    ----------
    omega, device, stiffness, damping, period, level, hold
        As `pointwise_band`.

    Returns
    -------
    lower, upper : ndarray, shape (M,)
        N·s/m.
    """
    mean, sd = np.empty(omega.size), np.empty(omega.size)
    farthest = np.zeros(stiffness.size)
    for block in _blocks(omega, stiffness.size):
        logs = np.log(_magnitudes(omega[block], device, stiffness, damping, period, hold))
        mean[block], sd[block] = logs.mean(axis=1), logs.std(axis=1, ddof=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            deviation = np.abs(logs - mean[block, None]) / sd[block, None]
        np.fmax(farthest, np.nanmax(np.where(sd[block, None] > 0, deviation, 0.0), axis=0), out=farthest)
    reach = np.quantile(farthest, level, method="higher")
    return np.exp(mean - reach * sd), np.exp(mean + reach * sd)
