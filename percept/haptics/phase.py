"""Exact range of the phase of Z_h over a box or an ellipse of (k, b)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics._arrays import BoolArray, FloatArray
from percept.haptics._warp import warp
from percept.haptics.ellipse import PlaneEllipse, plane_ellipse
from percept.haptics.envelope import Limits, plane_box
from percept.haptics.parameters import AnyDevice


def phase_envelope(
    omega: ArrayLike,
    device: AnyDevice,
    stiffness: Limits,
    damping: Limits,
    period: float,
    *,
    mass: ArrayLike = 0.0,
    hold: str = "average",
) -> tuple[FloatArray, FloatArray]:
    """Return the exact lowest and highest phase of Z_h over a box of (k, b).

    Turned by the hold's delay, Z_h over the box is a rectangle of the complex plane, seen from the origin
    between two of its corners.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d.
    stiffness, damping : pair of array_like
        (low, high) of k, N/m, and b, N·s/m; may be negative.
    period : float
        Sampling period T, s.
    mass : array_like, optional
        m_e, kg.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    lower, upper : ndarray
        rad, of the broadcast shape of all arguments; lower is in (−π, π], upper may exceed π. Where Z_h can
        vanish every phase occurs: −π and π.

    Raises
    ------
    UsageError
        A lower limit above its upper one, ω above Nyquist or outside a device's table, T not positive, a
        value that is not finite, an unknown hold.
    """
    (p_low, p_high), (q_low, q_high) = plane_box(
        omega, device, stiffness, damping, period, mass=mass, hold=hold
    )
    return _wrapped(*_rectangle(p_low, p_high, q_low, q_high), warp(omega, period).half)


def _rectangle(
    p_low: FloatArray, p_high: FloatArray, q_low: FloatArray, q_high: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the lowest and highest angle of a rectangle, and where it holds the origin."""
    # Left of the imaginary axis the angle is taken from the negative real axis, away from its cut.
    flip = np.where(p_high < 0, -1.0, 1.0)
    angles = np.stack([np.arctan2(flip * q, flip * p) for p in (p_low, p_high) for q in (q_low, q_high)])
    turned = np.where(flip < 0, np.pi, 0.0)
    free = (p_low <= 0) & (p_high >= 0) & (q_low <= 0) & (q_high >= 0)
    return angles.min(axis=0) + turned, angles.max(axis=0) + turned, free


def _wrapped(
    lower: FloatArray, upper: FloatArray, free: BoolArray, delay: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Take the hold's delay off both angles and bring the lower one into (−π, π]."""
    lower, upper = lower - delay, upper - delay
    turns = 2 * np.pi * np.ceil((lower - np.pi) / (2 * np.pi))
    return np.where(free, -np.pi, lower - turns)[()], np.where(free, np.pi, upper - turns)[()]


def phase_envelope_ellipse(
    omega: ArrayLike,
    device: AnyDevice,
    centre: tuple[float, float],
    shape: ArrayLike,
    radius: float,
    period: float,
    *,
    mass: float = 0.0,
    hold: str = "average",
) -> tuple[FloatArray, FloatArray]:
    """Return the exact lowest and highest phase of Z_h over an ellipse of (k, b).

    Seen from the origin the ellipse ends at two tangents, which are those of a circle after a linear map.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d.
    centre : pair of float
        k, N/m, and b, N·s/m.
    shape : array_like, shape (2, 2)
        Symmetric, positive semidefinite, such as a covariance of (k, b).
    radius : float
        Dimensionless, zero or more.
    period : float
        Sampling period T, s.
    mass : float, optional
        m_e, kg.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    lower, upper : ndarray
        rad, as `phase_envelope`.

    Raises
    ------
    UsageError
        A shape that is not a covariance, a negative radius, ω above Nyquist or outside a device's table, T
        not positive, a value that is not finite, an unknown hold.
    """
    region = plane_ellipse(omega, device, centre, shape, radius, period, mass=mass, hold=hold)
    # Angles do not change with scale, and squares then stay in range.
    parts = np.broadcast_arrays(*region.centre, *region.images)
    scale = np.max(np.abs(parts), axis=0)
    scale = np.where(scale == 0, 1.0, scale)
    lower, upper, free = _tangents(*(part / scale for part in parts))
    if region.at_dc.any():
        ends = _rectangle(*_rectangle_at_dc(region))
        lower, upper, free = (
            np.where(region.at_dc, *pair) for pair in zip(ends, (lower, upper, free), strict=True)
        )
    return _wrapped(lower, upper, free, warp(omega, period).half)


def _tangents(
    p: FloatArray, q: FloatArray, p1: FloatArray, p2: FloatArray, q1: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the angles of the tangents from the origin to c + M·(unit disc), M = [[p1, p2], [q1, 0]].

    With n² = Σ(c×mᵢ)² over the columns of M and d = det M the tangents run along
    √(n² − d²)·c ± Σ mᵢ(c×mᵢ); the origin is inside where n < abs(d). Nothing is inverted, so the ellipse may
    be a segment.
    """
    cross1, cross2 = p * q1 - q * p1, -q * p2
    n, d = np.hypot(cross1, cross2), np.abs(q1 * p2)
    along = np.sqrt(np.maximum(n - d, 0.0)) * np.sqrt(n + d) * (p**2 + q**2)
    aside = (p * p1 + q * q1) * cross1 + p * p2 * cross2
    middle = np.arctan2(q, p)
    on_segment = (n == 0) & (p**2 + q**2 <= p1**2 + p2**2 + q1**2)
    free = (n < d) | ((d == 0) & on_segment)
    return middle + np.arctan2(-(n**2), along - aside), middle + np.arctan2(n**2, along + aside), free


def _rectangle_at_dc(region: PlaneEllipse) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the limit of the ellipse as ω goes to 0: stiffness leads, unless the chord k = 0 exists."""
    k, reach = region.stiffness
    if region.chord is None:
        end = np.full_like(region.across, -np.copysign(np.inf, k))
        return region.across, region.across, end, end
    high = np.full_like(region.across, np.inf if reach else 0.0)
    return region.across + region.chord[0], region.across + region.chord[1], -high, high
