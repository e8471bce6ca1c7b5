"""Range of abs(Z_h) over an ellipse of (log k, log b): a curve without closed form, searched by angle."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError
from percept.haptics._arrays import LARGEST, BoolArray, FloatArray, ratio, real_array, times
from percept.haptics._search import wide_section
from percept.haptics._warp import warp
from percept.haptics.ellipse import checked_centre, checked_factor
from percept.haptics.parameters import AnyDevice
from percept.haptics.perceived import distance_axes

__all__ = ["magnitude_envelope_log_ellipse"]

IntArray: TypeAlias = NDArray[np.intp]

_ANGLES = 720
_STEP = 2 * np.pi / _ANGLES


def magnitude_envelope_log_ellipse(
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
    """Return the lowest and highest abs(Z_h) over an ellipse of (log k, log b).

    abs(Z_h) is a distance in the plane of (g·b, g·k/Ω), so over any region its extremes lie on the edge,
    except the value 0 where the region holds the point it is measured from.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d; its parameters broadcast against ω.
    centre : pair of float
        Natural logarithms of k in N/m and b in N·s/m.
    shape : array_like, shape (2, 2)
        Symmetric, positive semidefinite, such as a covariance of (log k, log b).
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
        N·s/m, of the broadcast shape of ω and the device's parameters. Every extreme seen on a grid of half a
        degree is refined to the precision of a double.

    Raises
    ------
    UsageError
        A shape that is not a covariance, a negative radius, an ellipse beyond 1e±100, ω above Nyquist or
        outside a device's table, T not positive, a value that is not finite.
    """
    log_k, log_b = checked_centre(centre)
    factor = checked_factor(shape, radius)
    reach = max(abs(log_k) + abs(factor[0, 0]), abs(log_b) + float(np.hypot(*factor[1])))
    if reach > np.log(LARGEST):
        raise UsageError(
            f"the ellipse reaches beyond {LARGEST:g} or below its inverse.",
            value=reach,
            hint="centre and shape are of natural logarithms of k and b.",
        )
    grid = warp(omega, period)
    across, along, held = distance_axes(grid, device, real_array(mass, "mass", "kg"), hold)
    outer = np.broadcast_shapes(across.shape, along.shape)
    gain, per_rate, across, along = (
        np.broadcast_to(part, outer).ravel() for part in (held.gain, held.per_rate, across, along)
    )

    def distance(point: IntArray | slice, angle: FloatArray) -> FloatArray:
        u1, u2 = np.cos(angle), np.sin(angle)
        k = np.exp(log_k + factor[0, 0] * u1)
        b = np.exp(log_b + factor[1, 0] * u1 + factor[1, 1] * u2)
        g, p, q, rate = (part[point] for part in (gain, across, along, per_rate))
        if isinstance(point, slice):
            g, p, q, rate = (part[:, None] for part in (g, p, q, rate))
        return np.hypot(g * b + p, q - times(k, rate))

    angles = np.asarray(_STEP * np.arange(_ANGLES), dtype=np.float64)
    seen = distance(slice(None), angles)
    lower, upper = _refined(distance, angles, seen)
    inside = _holds_origin(log_k, log_b, factor, gain, per_rate, across, along)
    lower = np.where(inside, 0.0, lower)
    return lower.reshape(outer)[()], upper.reshape(outer)[()]


def _refined(
    distance: Callable[[IntArray | slice, FloatArray], FloatArray], angles: FloatArray, seen: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest distance of every point, from what was `seen` on the grid."""
    before, after, finite = np.roll(seen, 1, axis=1), np.roll(seen, -1, axis=1), np.isfinite(seen)
    # All local extremes are refined: on the grid the wrong one may look better.
    dips = np.nonzero((seen <= before) & (seen <= after) & finite)
    peaks = np.nonzero((seen >= before) & (seen >= after) & finite)
    point, index = (np.concatenate(pair) for pair in zip(dips, peaks, strict=True))
    sign = np.repeat([1.0, -1.0], [dips[0].size, peaks[0].size])
    angle = wide_section(
        lambda angle: sign * distance(point, angle), angles[index] - _STEP, angles[index] + _STEP
    )
    found = distance(point, angle)
    lower, upper = seen.min(axis=1), seen.max(axis=1)
    np.minimum.at(lower, dips[0], found[: dips[0].size])
    np.maximum.at(upper, peaks[0], found[dips[0].size :])
    return lower, upper


def _holds_origin(
    log_k: float,
    log_b: float,
    factor: FloatArray,
    gain: FloatArray,
    per_rate: FloatArray,
    across: FloatArray,
    along: FloatArray,
) -> BoolArray:
    """Say where the region holds the (k, b) at which Z_h vanishes."""
    k, b = ratio(along, per_rate, empty=-1.0), ratio(-across, gain, empty=-1.0)
    positive = (k > 0) & (b > 0) & np.isfinite(k) & np.isfinite(b)
    d_k = np.log(np.where(positive, k, 1.0)) - log_k
    d_b = np.log(np.where(positive, b, 1.0)) - log_b
    u1 = ratio(d_k, factor[0, 0], empty=0.0)
    u2 = ratio(d_b - times(factor[1, 0], u1), factor[1, 1], empty=0.0)
    return positive & (np.hypot(u1, u2) <= 1)
