"""Range of abs(Z_h) over a region of (k, b): a box, an ellipse; and the paper's corner curves (Eqs 16, 17).

abs(Z_h) is a distance in the plane of (g·b, g·k/Ω). Over any region its extremes lie on the edge,
except the value 0 where the region holds the point it is measured from. The edge of an ellipse is a
curve by angle. Around a plain ellipse a distance is stationary at the roots of a quartic; the curve
of a log-ellipse is looked at every degree. Every extreme is then refined to the precision of a
double.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    ordered_limits,
    ratio,
    real_array,
    times,
)
from percept.haptics.containment import Plane
from percept.haptics.impedance import warp
from percept.haptics.perceived import distance_axes, perceived_magnitude
from percept.haptics.records import AnyDevice, Device
from percept.haptics.search import rising_root

Limits = tuple[ArrayLike, ArrayLike]
# The curve of a log-ellipse is looked at every degree.
_STEP = 2 * np.pi / 360
_ANGLES = np.asarray(_STEP * np.arange(360), dtype=np.float64)
# A circle's quartic has no leading term: the least it counts as, of the others. Roots move by as
# much.
_LEADING = 1e-6


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

    abs(Z_h) is a distance from one point in the plane of (g·b, g·k/Ω), where the box stays a box:
    its nearest point is a clip, its farthest a corner.

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
    upper = np.hypot(
        np.maximum(np.abs(p_low), np.abs(p_high)), np.maximum(np.abs(q_low), np.abs(q_high))
    )
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


def magnitude_envelope_ellipse(
    omega: ArrayLike,
    device: AnyDevice,
    centre: ArrayLike,
    shape: ArrayLike,
    radius: float,
    period: float,
    *,
    mass: float = 0.0,
    hold: str = "average",
    log: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest abs(Z_h), N·s/m, over (x − centre)ᵀ shape⁻¹ (x − centre) ≤ radius².

    x is (k, b), or with `log` their natural logarithms, and `shape` a covariance of x. ω is above
    zero.
    """
    curve = _Curve.of(centre, shape, radius, log=log)
    across, along, held = distance_axes(warp(omega, period), device, hold, mass)
    parts = np.broadcast_arrays(held.gain, held.per_rate, across, along)
    plane = Plane(*(part.ravel() for part in parts))
    # A mass is endless at Nyquist.
    seen = np.isfinite(plane.per_rate) & np.isfinite(plane.across) & np.isfinite(plane.along)
    lower, upper = np.full((2, seen.size), np.inf)
    lower[seen], upper[seen] = _extremes_along(curve, plane.at(seen))
    lower[curve.holds_origin(plane)] = 0.0
    return lower.reshape(parts[0].shape)[()], upper.reshape(parts[0].shape)[()]


@dataclass(frozen=True)
class _Curve:
    """Edge of the ellipse: k and b by angle."""

    centre: FloatArray  # (2,) of k and b, or of their logarithms
    factor: FloatArray  # Lower triangular L with L·Lᵀ = radius²·shape
    log: bool

    @classmethod
    def of(cls, centre: ArrayLike, shape: ArrayLike, radius: float, *, log: bool) -> _Curve:
        """Take the root of a covariance."""
        (kk, kb), (_, bb) = np.asarray(shape, dtype=np.float64)
        sd_k, sd_b = np.sqrt(kk), np.sqrt(bb)
        rho = float(np.clip(kb / (sd_k * sd_b), -1.0, 1.0)) if sd_k * sd_b else 0.0
        # (1 − ρ)(1 + ρ) keeps the digits that 1 − ρ² would lose.
        rest = np.sqrt((1 - rho) * (1 + rho))
        factor = radius * np.array([[sd_k, 0.0], [rho * sd_b, rest * sd_b]])
        return cls(np.asarray(centre, dtype=np.float64), factor, log)

    def at(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return k and b."""
        (along_k, _), (cross, along_b) = self.factor
        cos, sin = np.cos(angle), np.sin(angle)
        k, b = self.centre[0] + along_k * cos, self.centre[1] + (cross * cos + along_b * sin)
        return (np.exp(k), np.exp(b)) if self.log else (k, b)

    def slopes(self, angle: FloatArray) -> tuple[FloatArray, ...]:
        """Return first and second derivative of k, then of b."""
        (along_k, _), (cross, along_b) = self.factor
        cos, sin = np.cos(angle), np.sin(angle)
        k1, k2 = -along_k * sin, -along_k * cos
        b1, b2 = along_b * cos - cross * sin, -cross * cos - along_b * sin
        if not self.log:
            return k1, k2, b1, b2
        k, b = self.at(angle)
        return k * k1, k * (k2 + k1 * k1), b * b1, b * (b2 + b1 * b1)

    def holds_origin(self, plane: Plane) -> BoolArray:
        """Say where the region holds the (k, b) at which Z_h vanishes."""
        k, b = (
            ratio(plane.along, plane.per_rate, empty=np.inf),
            ratio(-plane.across, plane.gain, empty=np.inf),
        )
        there: BoolArray = np.isfinite(k) & np.isfinite(b)
        if self.log:
            there &= (k > 0) & (b > 0)
            k, b = np.log(np.where(there, k, 1.0)), np.log(np.where(there, b, 1.0))
        off_k, off_b = (
            np.where(there, k, 0.0) - self.centre[0],
            np.where(there, b, 0.0) - self.centre[1],
        )
        u1 = ratio(off_k, self.factor[0, 0], empty=0.0)
        u2 = ratio(off_b - times(self.factor[1, 0], u1), self.factor[1, 1], empty=0.0)
        return there & (np.hypot(u1, u2) <= 1)


def _extremes_along(curve: _Curve, plane: Plane) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest distance along the curve, at every ω."""
    k, b = (np.abs(part).max() for part in curve.at(_ANGLES))
    # Squares of numbers near one neither overflow nor vanish where they decide.
    size = np.max(
        [np.frexp(part)[1] for part in (plane.gain * b, plane.across, plane.along)]
        + [np.frexp(plane.per_rate)[1] + np.frexp(k)[1]],
        axis=0,
    )
    scaled = Plane(
        *(np.ldexp(part, -size) for part in (plane.gain, plane.per_rate, plane.across, plane.along))
    )
    turns, seen, sign = (_turns_on_grid if curve.log else _stationary)(curve, scaled)
    near, there = scaled.at(turns), plane.at(turns)

    def slopes(which: IntArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        local = near.at(which)
        k, b = curve.at(angle)
        k1, k2, b1, b2 = curve.slopes(angle)
        x, y = local.gain * b + local.across, local.along - local.per_rate * k
        x1, y1, x2, y2 = (
            local.gain * b1,
            -local.per_rate * k1,
            local.gain * b2,
            -local.per_rate * k2,
        )
        first, second = x * x1 + y * y1, x1 * x1 + y1 * y1 + x * x2 + y * y2
        return sign[which] * first, sign[which] * second

    lower, upper = np.full(plane.gain.size, np.inf), np.zeros(plane.gain.size)
    # An angle stays as first seen where its refinement is worse in the last digits.
    for angle in (seen, rising_root(slopes, seen, seen - _STEP, seen + _STEP)):
        k, b = curve.at(angle)
        with np.errstate(over="ignore"):
            distance = np.hypot(there.gain * b + there.across, there.along - there.per_rate * k)
        np.minimum.at(lower, turns, distance)
        np.maximum.at(upper, turns, distance)
    return lower, upper


def _turns_on_grid(curve: _Curve, plane: Plane) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return where distances turn on the grid: which ω, which angle, and 1 for a dip or -1 for a peak.

    All are refined: on the grid the wrong one may look better.
    """
    k, b = curve.at(_ANGLES)
    x = plane.gain[:, None] * b + plane.across[:, None]
    y = plane.along[:, None] - plane.per_rate[:, None] * k
    square = x * x + y * y
    before, after = np.roll(square, 1, axis=1), np.roll(square, -1, axis=1)
    dips = np.nonzero((square <= before) & (square <= after))
    peaks = np.nonzero((square >= before) & (square >= after))
    turns, index = np.concatenate([dips, peaks], axis=1)
    return turns, _ANGLES[index], np.repeat([1.0, -1.0], [dips[0].size, peaks[0].size])


def _stationary(curve: _Curve, plane: Plane) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return where distances from a plain ellipse are stationary, as `_turns_on_grid` does.

    With x = c₁ + A·cos φ + B·sin φ and y = c₂ + C·cos φ, half the slope of x² + y² is AB·cos 2φ +
    ½(B² − A² − C²)·sin 2φ + c₁B·cos φ − (c₁A + c₂C)·sin φ. It is a quartic in e^{iφ}; its roots off
    the unit circle do no harm.
    """
    k, b = curve.centre
    (along_k, _), (cross, along_b) = curve.factor
    x, y = plane.gain * b + plane.across, plane.along - plane.per_rate * k
    a, b, c = plane.gain * cross, plane.gain * along_b, -plane.per_rate * along_k
    double, single = a * b - 0.5j * (b * b - a * a - c * c), x * b + 1j * (x * a + y * c)
    least = _LEADING * np.maximum(np.abs(double), np.abs(single))
    leading = np.where(np.abs(double) > least, double, np.where(least > 0, least, 1.0))
    companion = np.zeros((x.size, 4, 4), dtype=complex)
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    for power, term in ((3, single), (1, np.conj(single)), (0, np.conj(double))):
        companion[:, power, 3] = -term / leading
    angle = np.angle(np.linalg.eigvals(companion))
    at = np.exp(1j * angle)
    bend = (2j * double[:, None] * at**2 + 1j * single[:, None] * at).real
    return np.repeat(np.arange(x.size), 4), angle.ravel(), np.where(bend.ravel() < 0, -1.0, 1.0)
