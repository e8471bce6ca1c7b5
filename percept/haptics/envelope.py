"""Exact range of abs(Z_h) over a box of (k, b), and the paper's corner curves (Eqs 16, 17)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import FloatArray, ordered_limits, real_array, times
from percept.haptics.impedance import warp
from percept.haptics.perceived import distance_axes, perceived_magnitude
from percept.haptics.records import AnyDevice, Device

Limits = tuple[ArrayLike, ArrayLike]


def corner_curves(
    omega: ArrayLike,
    device: AnyDevice,
    stiffness: Limits,
    damping: Limits,
    period: float,
    *,
    mass: ArrayLike = 0.0,
    hold: str = "average",
) -> tuple[FloatArray, FloatArray]:
    """Return abs(Z_h) at both lower and at both upper limits: the paper's boundary (Eqs 16, 17).

    Where the device's mass outweighs the stiffness the second curve runs below the first.
    Parameters as in `magnitude_envelope`, which gives the true range.

    Returns
    -------
    at_low, at_high : ndarray
        N·s/m, of the broadcast shape of all arguments.

    Raises
    ------
    UsageError
        As `magnitude_envelope`.
    """
    k_low, k_high = ordered_limits(stiffness, "stiffness", "N/m")
    b_low, b_high = ordered_limits(damping, "damping", "N·s/m")
    at_low = perceived_magnitude(omega, device, k_low, b_low, period, mass=mass, hold=hold)
    return at_low, perceived_magnitude(omega, device, k_high, b_high, period, mass=mass, hold=hold)


def magnitude_envelope(
    omega: ArrayLike,
    device: AnyDevice,
    stiffness: Limits,
    damping: Limits,
    period: float,
    *,
    mass: ArrayLike = 0.0,
    hold: str = "average",
) -> tuple[FloatArray, FloatArray]:
    """Return the exact lowest and highest abs(Z_h) over a box of (k, b).

    abs(Z_h) is a distance from one point in the plane of (g·b, g·k/Ω), where the box stays a box: its nearest
    point is a clip, its farthest a corner.

    Parameters
    ----------
    omega, device, period, hold
        As in `perceived_impedance`.
    mass : array_like, optional
        m_e of the environment, kg; may be negative.
    stiffness, damping : pair of array_like
        (low, high) of k, N/m, and b, N·s/m; may be negative.

    Returns
    -------
    lower, upper : ndarray
        N·s/m, of the broadcast shape of all arguments.

    Raises
    ------
    UsageError
        As `perceived_impedance`, and for a lower limit above its upper one.
    """
    grid = warp(omega, period)
    k_low, k_high = ordered_limits(stiffness, "stiffness", "N/m")
    b_low, b_high = ordered_limits(damping, "damping", "N·s/m")
    across, along, held = distance_axes(grid, device, hold, real_array(mass, "mass", "kg"))
    p_low, p_high = held.gain * b_low + across, held.gain * b_high + across
    # g/Ω changes sign with ω.
    q_ends = along - times(k_low, held.per_rate), along - times(k_high, held.per_rate)
    q_low, q_high = np.minimum(*q_ends), np.maximum(*q_ends)
    lower = np.hypot(_gap(p_low, p_high), _gap(q_low, q_high))
    upper = np.hypot(np.maximum(np.abs(p_low), np.abs(p_high)), np.maximum(np.abs(q_low), np.abs(q_high)))
    return lower[()], upper[()]


def _gap(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the distance of an interval from zero."""
    return np.maximum(0.0, np.maximum(low, -high))


def corner_crossings(
    device: Device, stiffness: tuple[float, float], damping: tuple[float, float], period: float
) -> FloatArray:
    """Return the ω, increasing, at which the two corner curves of a rigid device cross: the band is empty.

    The squares of both curves differ by a quadratic in Ω².
    """
    (k_low, k_high), (b_low, b_high), m, b_d = stiffness, damping, device.mass, device.damping
    dk, db = k_high - k_low, b_high - b_low
    square = -m * period * db
    linear = db * (b_low + b_high + 2 * b_d) - 2 * dk * (m + b_d * period / 2)
    roots = np.roots(np.array([square, linear, dk * (k_low + k_high)]))
    roots = np.sort(roots.real[(roots.imag == 0) & (roots.real > 0)])
    return (2 / period) * np.arctan(np.sqrt(roots) * period / 2)
