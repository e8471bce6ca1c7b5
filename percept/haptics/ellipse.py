"""Range of abs(Z_h) over an ellipse of (k, b), exact by one root each, or of (log k, log b), by angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import (
    LARGEST,
    BoolArray,
    FloatArray,
    IntArray,
    nonnegative_array,
    ratio,
    real_array,
    times,
)
from percept.haptics.containment import Plane
from percept.haptics.impedance import warp
from percept.haptics.perceived import distance_axes
from percept.haptics.records import AnyDevice
from percept.haptics.search import rising_root

# On the scale where the larger of distance and ellipse is one: an axis shorter than the first counts as zero,
# a point nearer to the short axis than the second as this far off it.
_FLAT, _OFF_AXIS = 1e-150, 1e-20
# The curve of a log-ellipse is looked at every degree.
_STEP = 2 * np.pi / 360
_ANGLES = np.asarray(_STEP * np.arange(360), dtype=np.float64)


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
    omega, device, period, mass, hold
        As in `perceived_magnitude`.
    centre : pair of float
        k, N/m, and b, N·s/m.
    shape : array_like, shape (2, 2)
        Symmetric, positive semidefinite, such as a covariance of (k, b): (N/m)², (N/m)·(N·s/m), (N·s/m)².
    radius : float
        Dimensionless, zero or more.

    Returns
    -------
    lower, upper : ndarray
        N·s/m, of the broadcast shape of ω and the device's parameters.

    Raises
    ------
    UsageError
        As `perceived_magnitude`, and for a shape that is not a covariance, or a negative radius.
    """
    k, b = _checked_centre(centre, "(k, b)")
    factor = _checked_factor(shape, radius, "(k, b)")
    plane, seen, size = _plane(omega, device, period, hold, mass)
    lower, upper = np.full((2, plane.across.size), np.inf)
    lower[seen], upper[seen] = _extremes(plane.at(seen), k, b, factor)
    at_dc = np.isinf(plane.per_rate)
    lower[at_dc], upper[at_dc] = _range_at_dc(plane.across[at_dc], k, b, factor)
    return lower.reshape(size)[()], upper.reshape(size)[()]


def _plane(
    omega: ArrayLike, device: AnyDevice, period: float, hold: str, mass: float
) -> tuple[Plane, BoolArray, tuple[int, ...]]:
    """Return the plane, where it is finite (k is not at DC, a mass not at Nyquist), and the arrays' shape."""
    across, along, held = distance_axes(warp(omega, period), device, hold, real_array(mass, "mass", "kg"))
    parts = np.broadcast_arrays(held.gain, held.per_rate, across, along)
    gain, per_rate, across, along = (part.ravel() for part in parts)
    finite = np.isfinite(per_rate) & np.isfinite(across) & np.isfinite(along)
    return Plane(gain, per_rate, across, along), finite, parts[0].shape


def _checked_centre(centre: tuple[float, float], pair: str) -> tuple[float, float]:
    """Return a pair, such as (k, b), or refuse it."""
    values = real_array(centre, f"the centre {pair}", "N/m and N·s/m")
    if values.shape != (2,):
        raise UsageError(f"centre must be the pair {pair}.", value=centre)
    return float(values[0]), float(values[1])


def _checked_factor(shape: ArrayLike, radius: float, pair: str) -> FloatArray:
    """Return the lower triangular L, radius included, with L·Lᵀ = radius²·shape."""
    matrix = real_array(shape, "shape", "squares and products of N/m and N·s/m")
    radius_array = nonnegative_array(radius, "radius", "standard deviations")
    if matrix.shape != (2, 2) or radius_array.ndim:
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
    return float(radius_array) * np.array([[sd_k, 0.0], [correlation * sd_b, rest * sd_b]])


def _extremes(plane: Plane, k: float, b: float, factor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest distance from the origin to an ellipse of (k, b), at every ω."""
    p, q = plane.gain * b + plane.across, plane.along - plane.per_rate * k
    images = plane.gain * factor[1, 0], plane.gain * factor[1, 1], -plane.per_rate * factor[0, 0]
    a1, a2, (cos, sin) = _principal(*images)
    w1, w2 = np.abs(cos * p + sin * q), np.abs(cos * q - sin * p)
    # Everything is scaled to one, so that squares stay in range.
    scale = np.maximum(np.maximum(w1, w2), a1)
    scale = np.where(scale == 0, 1.0, scale)
    scaled = a1 / scale, a2 / scale, w1 / scale, w2 / scale
    return scale * _nearest(*scaled), scale * _farthest(*scaled)


def _principal(
    b1: FloatArray, b2: FloatArray, k1: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Return both semi-axes of [[b1, b2], [k1, 0]]·(unit disc), the longer first, and its direction."""
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
    return longer, shorter, (np.where(along_damping, cos, sin), np.where(along_damping, sin, cos))


def _nearest(a1: FloatArray, a2: FloatArray, w1: FloatArray, w2: FloatArray) -> FloatArray:
    """Return how far a point (w1, w2) ≥ 0 is from the full ellipse of semi-axes a1 ≥ a2.

    The nearest point is aᵢ²wᵢ/(t + aᵢ²), with t > 0 the root of Σ(aᵢwᵢ/(t + aᵢ²))² = 1.
    """
    a1, a2 = np.where(a1 < _FLAT, 0.0, a1), np.where(a2 < _FLAT, 0.0, a2)
    outside = np.hypot(ratio(w1, a1, empty=0.0), ratio(w2, a2, empty=0.0)) > 1
    least = np.maximum(0.0, np.maximum(a1 * (w1 - a1), a2 * (w2 - a2)))
    t = _secular_root(np.where(outside, a1 * w1, 0.0), np.where(outside, a2 * w2, 0.0), a1**2, a2**2, least)
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
    n1, n2 = a1 * np.maximum(w1, _OFF_AXIS * a1), a2 * w2
    t = _secular_root(n1, n2, np.zeros_like(n1), spread, np.maximum(n1, n2 - spread))
    x1, x2 = ratio(n1, t, empty=0.0), ratio(n2, t + spread, empty=0.0)
    size = np.hypot(x1, x2)
    return np.hypot(w1 + a1 * ratio(x1, size, empty=0.0), w2 + a2 * ratio(x2, size, empty=0.0))


def _secular_root(
    n1: FloatArray, n2: FloatArray, d1: FloatArray, d2: FloatArray, least: FloatArray
) -> FloatArray:
    """Return t at or above `least` with (n1/(t + d1))² + (n2/(t + d2))² = 1.

    One over the root of that sum is concave and rises in t: Newton from the left never overshoots.
    """

    def short_of_one(which: IntArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        e1, e2 = t + d1[which], t + d2[which]
        x1, x2 = ratio(n1[which], e1, empty=0.0), ratio(n2[which], e2, empty=0.0)
        size = np.hypot(x1, x2)
        falls = ratio(x1**2, e1, empty=0.0) + ratio(x2**2, e2, empty=0.0)
        return 1 - size, ratio(falls, size**2, empty=1.0)

    return rising_root(short_of_one, least, least, np.maximum(least, 2 * np.maximum(n1, n2)))


def _range_at_dc(across: FloatArray, k: float, b: float, factor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the limits as ω goes to 0: only the points with k = 0 stay at a finite distance."""
    everywhere = np.full_like(across, np.inf)
    half_width = factor[0, 0]
    if abs(k) > half_width:
        return everywhere, everywhere
    if half_width == 0:
        middle, half = b, np.hypot(factor[1, 0], factor[1, 1])
    else:
        u = -k / half_width
        middle, half = b + factor[1, 0] * u, factor[1, 1] * np.sqrt((1 - u) * (1 + u))
    low, high = across + (middle - half), across + (middle + half)
    upper = everywhere if half_width else np.maximum(np.abs(low), np.abs(high))
    return np.maximum(0.0, np.maximum(low, -high)), upper


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

    Parameters as in `magnitude_envelope_ellipse`, with `centre` the natural logarithms of k in N/m and
    b in N·s/m, and `shape` such as their covariance.

    Returns
    -------
    lower, upper : ndarray
        N·s/m, of the broadcast shape of ω and the device's parameters. Every extreme seen on a grid of one
        degree is refined to the precision of a double.

    Raises
    ------
    UsageError
        As `magnitude_envelope_ellipse`, and for an ellipse that reaches beyond 1e±100.
    """
    log_k, log_b = _checked_centre(centre, "(log k, log b)")
    factor = _checked_factor(shape, radius, "(log k, log b)")
    reach = max(abs(log_k) + abs(factor[0, 0]), abs(log_b) + float(np.hypot(*factor[1])))
    if reach > np.log(LARGEST):
        raise UsageError(
            f"the ellipse reaches beyond {LARGEST:g} or below its inverse.",
            value=reach,
            hint="centre and shape are of natural logarithms of k and b.",
        )
    curve = _Curve(log_k, log_b, factor)
    plane, seen, size = _plane(omega, device, period, hold, mass)
    lower, upper = np.full((2, plane.across.size), np.inf)
    lower[seen], upper[seen] = _extremes_along(curve, plane.at(seen))
    lower[_holds_origin(curve, plane)] = 0.0
    return lower.reshape(size)[()], upper.reshape(size)[()]


@dataclass(frozen=True)
class _Curve:
    """Edge of the ellipse: k and b by angle."""

    log_k: float
    log_b: float
    factor: FloatArray

    def at(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return k and b."""
        along_k, along_b, cross = self.factor[0, 0], self.factor[1, 1], self.factor[1, 0]
        cos, sin = np.cos(angle), np.sin(angle)
        return np.exp(self.log_k + along_k * cos), np.exp(self.log_b + cross * cos + along_b * sin)

    def slopes(self, angle: FloatArray) -> tuple[FloatArray, ...]:
        """Return first and second derivative of log k, then of log b."""
        along_k, along_b, cross = self.factor[0, 0], self.factor[1, 1], self.factor[1, 0]
        cos, sin = np.cos(angle), np.sin(angle)
        return -along_k * sin, -along_k * cos, along_b * cos - cross * sin, -cross * cos - along_b * sin


def _extremes_along(curve: _Curve, plane: Plane) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest distance along the curve, at every ω."""
    k, b = curve.at(_ANGLES)
    # Squares of numbers near one neither overflow nor vanish where they decide.
    size = np.max(
        [np.frexp(part)[1] for part in (plane.gain * b.max(), plane.across, plane.along)]
        + [np.frexp(plane.per_rate)[1] + np.frexp(k.max())[1]],
        axis=0,
    )
    gain, per_rate, across, along = (
        np.ldexp(part, -size) for part in (plane.gain, plane.per_rate, plane.across, plane.along)
    )
    scaled = Plane(gain, per_rate, across, along)
    turns, index, sign = _turning_points(scaled, k, b)
    near, there = scaled.at(turns), plane.at(turns)

    def slopes(which: IntArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        local = near.at(which)
        k, b = curve.at(angle)
        k1, k2, b1, b2 = curve.slopes(angle)
        spring, damper = local.per_rate * k, local.gain * b
        x, y = damper + local.across, local.along - spring
        b1, k1, b2, k2 = damper * b1, spring * k1, damper * (b2 + b1 * b1), spring * (k2 + k1 * k1)
        first = x * b1 - y * k1
        second = b1 * b1 + k1 * k1 + x * b2 - y * k2
        return sign[which] * first, sign[which] * second

    seen = _ANGLES[index]
    lower, upper = np.full(plane.gain.size, np.inf), np.zeros(plane.gain.size)
    # An angle of the grid stays where its refinement is worse in the last digits.
    for angle in (seen, rising_root(slopes, seen, seen - _STEP, seen + _STEP)):
        k, b = curve.at(angle)
        with np.errstate(over="ignore"):
            distance = np.hypot(there.gain * b + there.across, there.along - there.per_rate * k)
        np.minimum.at(lower, turns, distance)
        np.maximum.at(upper, turns, distance)
    return lower, upper


def _turning_points(plane: Plane, k: FloatArray, b: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Return where distances turn on the grid: which ω, which angle, and 1 for a dip or -1 for a peak.

    All are refined: on the grid the wrong one may look better.
    """
    x = plane.gain[:, None] * b + plane.across[:, None]
    y = plane.along[:, None] - plane.per_rate[:, None] * k
    square = x * x + y * y
    before, after = np.roll(square, 1, axis=1), np.roll(square, -1, axis=1)
    dips = np.nonzero((square <= before) & (square <= after))
    peaks = np.nonzero((square >= before) & (square >= after))
    turns, index = np.concatenate([dips, peaks], axis=1)
    return turns, index, np.repeat([1.0, -1.0], [dips[0].size, peaks[0].size])


def _holds_origin(curve: _Curve, plane: Plane) -> BoolArray:
    """Say where the region holds the (k, b) at which Z_h vanishes."""
    k, b = ratio(plane.along, plane.per_rate, empty=-1.0), ratio(-plane.across, plane.gain, empty=-1.0)
    positive = (k > 0) & (b > 0) & np.isfinite(k) & np.isfinite(b)
    d_k = np.log(np.where(positive, k, 1.0)) - curve.log_k
    d_b = np.log(np.where(positive, b, 1.0)) - curve.log_b
    u1 = ratio(d_k, curve.factor[0, 0], empty=0.0)
    u2 = ratio(d_b - times(curve.factor[1, 0], u1), curve.factor[1, 1], empty=0.0)
    return positive & (np.hypot(u1, u2) <= 1)
