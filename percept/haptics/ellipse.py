"""Exact range of abs(Z_h) over an ellipse of (k, b): nearest and farthest point, one root each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics._arrays import BoolArray, FloatArray, nonnegative_array, ratio, real_array
from percept.haptics._warp import warp
from percept.haptics.parameters import AnyDevice
from percept.haptics.perceived import distance_axes

_STEPS = 80


def magnitude_envelope_ellipse(
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
    """Return the exact lowest and highest abs(Z_h) over an ellipse of (k, b).

    The ellipse holds every x = (k, b) with (x − centre)ᵀ shape⁻¹ (x − centre) ≤ radius². In the plane of
    (g·k/Ω, g·b) it is an ellipse again, and abs(Z_h) the distance from one point to it.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d; its parameters broadcast against ω.
    centre : pair of float
        k, N/m, and b, N·s/m.
    shape : array_like, shape (2, 2)
        Symmetric, positive semidefinite, such as a covariance of (k, b): (N/m)², (N/m)·(N·s/m), (N·s/m)².
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
        N·s/m, of the broadcast shape of ω and the device's parameters.

    Raises
    ------
    UsageError
        A shape that is not a covariance, a negative radius, ω above Nyquist or outside a device's table, T
        not positive, a value that is not finite, an unknown hold.
    """
    region = plane_ellipse(omega, device, centre, shape, radius, period, mass=mass, hold=hold)
    p, q = region.centre
    longer, shorter, towards_long, towards_short = _principal(*region.images)
    w1 = np.abs(towards_long[0] * p + towards_long[1] * q)
    w2 = np.abs(towards_short[0] * p + towards_short[1] * q)
    # Everything is scaled to one, so that squares stay in range.
    scale = np.maximum(np.maximum(w1, w2), longer)
    scale = np.where(scale == 0, 1.0, scale)
    scaled = longer / scale, shorter / scale, w1 / scale, w2 / scale
    lower = np.where(region.far, np.inf, scale * _nearest(*scaled))
    upper = np.where(region.far, np.inf, scale * _farthest(*scaled))
    if region.at_dc.any():
        first, last = _range_at_dc(region)
        lower, upper = np.where(region.at_dc, first, lower), np.where(region.at_dc, last, upper)
    return lower[()], upper[()]


@dataclass(frozen=True)
class PlaneEllipse:
    """An ellipse of (k, b) as Z_h·e^{jh} in the complex plane."""

    centre: tuple[FloatArray, FloatArray]  # Real and imaginary part, N·s/m
    images: tuple[FloatArray, FloatArray, FloatArray]
    far: BoolArray
    at_dc: BoolArray
    across: FloatArray  # Real part that the device alone contributes, N·s/m
    chord: tuple[float, float] | None  # Lowest and highest b of the ellipse at k = 0, N·s/m
    stiffness: tuple[float, float]  # Centre and half-width in k, N/m


def plane_ellipse(
    omega: ArrayLike,
    device: AnyDevice,
    centre: tuple[float, float],
    shape: ArrayLike,
    radius: float,
    period: float,
    *,
    mass: float,
    hold: str,
) -> PlaneEllipse:
    """Map an ellipse of (k, b) to where Z_h·e^{jh} can be at each ω."""
    k, b = checked_centre(centre)
    factor = checked_factor(shape, radius)
    grid = warp(omega, period)
    across, along, held = distance_axes(grid, device, real_array(mass, "mass", "kg"), hold)
    across, along = np.broadcast_arrays(across, along)
    at_dc = np.isinf(np.broadcast_to(held.per_rate, across.shape))
    per_rate = np.where(at_dc, 1.0, held.per_rate)
    p, q = held.gain * b + across, along - per_rate * k
    far = np.isinf(p) | np.isinf(q)
    # Of an infinite mass term only the direction is left.
    p, q = (np.where(far, np.where(np.isinf(part), np.sign(part), 0.0), part) for part in (p, q))
    gain, per_rate = np.where(far, 0.0, held.gain), np.where(far, 0.0, per_rate)
    return PlaneEllipse(
        centre=(p, q),
        images=(gain * factor[1, 0], gain * factor[1, 1], -per_rate * factor[0, 0]),
        far=far,
        at_dc=at_dc,
        across=across,
        chord=_chord_at_zero_stiffness(k, b, factor),
        stiffness=(k, float(factor[0, 0])),
    )


def checked_centre(centre: tuple[float, float], pair: str = "(k, b)") -> tuple[float, float]:
    """Return a pair, such as (k, b), or refuse it."""
    values = real_array(centre, f"the centre {pair}", "N/m and N·s/m")
    if values.shape != (2,):
        raise UsageError(f"centre must be the pair {pair}.", value=centre)
    return float(values[0]), float(values[1])


def checked_factor(shape: ArrayLike, radius: float, pair: str = "(k, b)") -> FloatArray:
    """Return the lower triangular L, radius included, with L·Lᵀ = radius²·shape."""
    matrix = real_array(shape, "shape", "squares and products of N/m and N·s/m")
    reach = nonnegative_array(radius, "radius", "standard deviations")
    if matrix.shape != (2, 2) or reach.ndim:
        raise UsageError("an ellipse needs a 2-by-2 shape and one radius.", value=(matrix.shape, radius))
    kk, kb, bk, bb = matrix.ravel()
    size = np.sqrt(max(kk, 0.0)) * np.sqrt(max(bb, 0.0))
    if abs(kb - bk) > 1e-12 * size or kk < 0 or bb < 0 or abs(kb) > size * (1 + 1e-12):
        raise UsageError(
            "shape must be symmetric and positive semidefinite.",
            value=matrix.tolist(),
            hint=f"Give a covariance matrix of {pair}.",
        )
    correlation = float(np.clip(kb / size, -1.0, 1.0)) if size else 0.0
    sd_k, sd_b = np.sqrt(kk), np.sqrt(bb)
    # (1 − ρ)(1 + ρ) keeps the digits that 1 − ρ² would lose.
    rest = np.sqrt((1 - correlation) * (1 + correlation))
    return float(reach) * np.array([[sd_k, 0.0], [correlation * sd_b, rest * sd_b]])


Axis = tuple[FloatArray, FloatArray]


def _principal(b1: FloatArray, b2: FloatArray, k1: FloatArray) -> tuple[FloatArray, FloatArray, Axis, Axis]:
    """Return the semi-axes, longer first, and their directions, of [[b1, b2], [k1, 0]]·(unit disc)."""
    # The sum and difference of the singular values are lengths, their product is |b2·k1|.
    longer = (np.hypot(b1, np.abs(b2) + np.abs(k1)) + np.hypot(b1, np.abs(b2) - np.abs(k1))) / 2
    unit = np.where(longer == 0, 1.0, longer)
    b1, b2, k1 = b1 / unit, b2 / unit, k1 / unit
    shorter = unit * np.abs(b2 * k1)
    # The angle is taken from whichever axis the ellipse lies along, so that a small tilt keeps its digits.
    across = np.hypot(b1, b2)
    excess = (across - np.abs(k1)) * (across + np.abs(k1))
    tilt = np.arctan2(2 * b1 * k1, np.abs(excess)) / 2
    cos, sin = np.cos(tilt), np.sin(tilt)
    along_damping = excess >= 0
    towards_long = np.where(along_damping, cos, sin), np.where(along_damping, sin, cos)
    return longer, shorter, towards_long, (-towards_long[1], towards_long[0])


def _nearest(a1: FloatArray, a2: FloatArray, w1: FloatArray, w2: FloatArray) -> FloatArray:
    """Return how far a point (w1, w2) ≥ 0 is from the full ellipse of semi-axes a1 ≥ a2.

    The nearest point is aᵢ²wᵢ/(t + aᵢ²), with t > 0 the root of Σ(aᵢwᵢ/(t + aᵢ²))² = 1. One over the root of
    that sum is concave and increasing in t: Newton from the left never overshoots.
    """
    a1, a2 = np.where(a1 < _FLAT, 0.0, a1), np.where(a2 < _FLAT, 0.0, a2)
    outside = np.hypot(ratio(w1, a1, empty=0.0), ratio(w2, a2, empty=0.0)) > 1
    t = np.maximum(0.0, np.maximum(a1 * (w1 - a1), a2 * (w2 - a2)))
    for _ in range(_STEPS):
        d1, d2 = t + a1**2, t + a2**2
        x1, x2 = ratio(a1 * w1, d1, empty=0.0), ratio(a2 * w2, d2, empty=0.0)
        step = _secular_step(x1, x2, d1, d2)
        step = np.where(outside, np.maximum(step, 0.0), 0.0)
        t = t + step
        if (step <= _SETTLED * t).all():
            break
    # wᵢ minus the nearest point is t·wᵢ/(t + aᵢ²): no difference of near numbers is formed.
    gap1, gap2 = w1 * ratio(t, t + a1**2, empty=1.0), w2 * ratio(t, t + a2**2, empty=1.0)
    return np.where(outside, np.hypot(gap1, gap2), 0.0)


def _farthest(a1: FloatArray, a2: FloatArray, w1: FloatArray, w2: FloatArray) -> FloatArray:
    """Return the largest distance of a point (w1, w2) ≥ 0 from the ellipse of semi-axes a1 ≥ a2.

    The farthest point is −(a1·x1, a2·x2), where x1 = a1w1/t, x2 = a2w2/(t + a1² − a2²) is a unit vector. It
    enters the distance at second order only.
    """
    a1 = np.where(a1 < _FLAT, 0.0, a1)
    spread = (a1 - a2) * (a1 + a2)
    # On the short axis itself t is 0 and x1 is lost; this far off it the distance is the same.
    off = np.maximum(w1, _OFF_AXIS * a1)
    t = np.maximum(a1 * off, a2 * w2 - spread)
    for _ in range(_STEPS):
        d1, d2 = t, t + spread
        x1, x2 = ratio(a1 * off, d1, empty=0.0), ratio(a2 * w2, d2, empty=0.0)
        step = np.maximum(_secular_step(x1, x2, d1, d2), 0.0)
        t = t + step
        if (step <= _SETTLED * t).all():
            break
    size = np.hypot(x1, x2)
    return np.hypot(w1 + a1 * ratio(x1, size, empty=0.0), w2 + a2 * ratio(x2, size, empty=0.0))


_FLAT, _OFF_AXIS, _SETTLED = 1e-150, 1e-20, 4e-16


def _secular_step(x1: FloatArray, x2: FloatArray, d1: FloatArray, d2: FloatArray) -> FloatArray:
    """Return Newton's step in t for 1/|x| = 1, where x1 and x2 fall as 1/d1 and 1/d2."""
    size = np.hypot(x1, x2)
    return ratio((size - 1) * size**2, ratio(x1**2, d1, empty=0.0) + ratio(x2**2, d2, empty=0.0), empty=0.0)


def _range_at_dc(region: PlaneEllipse) -> Axis:
    """Return the limits as ω goes to 0: only the points with k = 0 stay at a finite distance."""
    everywhere = np.full_like(region.across, np.inf)
    if region.chord is None:
        return everywhere, everywhere
    low, high = region.across + region.chord[0], region.across + region.chord[1]
    upper = everywhere if region.stiffness[1] else np.maximum(np.abs(low), np.abs(high))
    return np.maximum(0.0, np.maximum(low, -high)), upper


def _chord_at_zero_stiffness(k: float, b: float, factor: FloatArray) -> tuple[float, float] | None:
    """Return the lowest and highest b of the ellipse at k = 0, None where it does not reach so far."""
    reach = factor[0, 0]
    if abs(k) > reach:
        return None
    if reach == 0:
        middle, half = b, np.hypot(factor[1, 0], factor[1, 1])
    else:
        u = -k / reach
        middle, half = b + factor[1, 0] * u, factor[1, 1] * np.sqrt((1 - u) * (1 + u))
    return float(middle - half), float(middle + half)
