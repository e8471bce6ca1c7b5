"""Range of abs(Z_h) over a box or an ellipse of (k, b), and the paper's corner curves (Eqs 16, 17).

abs(Z_h) is a distance in the plane of (g·b, g·k/Ω). A box stays a box in it: its nearest point is a
clip, its farthest a corner. Over an ellipse the extremes lie on the edge, except the value 0 where
the ellipse holds the point that distances are measured from. The edge is a curve by angle that is
looked at every degree. Every extreme is then refined to the precision of a double.
"""

from __future__ import annotations

from typing import NamedTuple

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
from percept.haptics.loop import Loop
from percept.haptics.perceived import DistancePlane, Limits, Point, perceived_magnitude
from percept.searches import rising_root

__all__ = [
    "CornerCurves",
    "Ellipse",
    "Envelope",
    "corner_curves",
    "magnitude_envelope",
    "magnitude_envelope_ellipse",
]

# rad: curves are looked at every degree, and each extreme is refined within a degree to either
# side. A plain ellipse has at most four.
_STEP = 2 * np.pi / 360
_ANGLES = np.asarray(_STEP * np.arange(360), dtype=np.float64)


class CornerCurves(NamedTuple):
    """abs(Z_h) at two corners of a box, N·s/m, of one shape."""

    at_low: FloatArray  # At both lower limits
    at_high: FloatArray  # At both upper limits


class Envelope(NamedTuple):
    """Range of abs(Z_h) over a region, N·s/m, of one shape."""

    lower: FloatArray
    upper: FloatArray


def corner_curves(
    loop: Loop,
    omega: ArrayLike,
    stiffness: Limits,
    damping: Limits,
    *,
    mass: ArrayLike = 0.0,
) -> CornerCurves:
    """Return abs(Z_h) at both lower and at both upper limits: the paper's boundary (Eqs 16, 17).

    Where the device's mass outweighs the stiffness the second curve runs below the first.
    Parameters as in `magnitude_envelope`, which gives the true range.

    Returns
    -------
    CornerCurves
        `at_low` and `at_high`, N·s/m, of the broadcast shape of all arguments.

    Raises
    ------
    UsageError
        As `magnitude_envelope`.
    """
    k_low, k_high = ordered_limits(stiffness, "stiffness", "N/m")
    b_low, b_high = ordered_limits(damping, "damping", "N·s/m")
    at_low = perceived_magnitude(loop, omega, k_low, b_low, mass=mass)
    at_high = perceived_magnitude(loop, omega, k_high, b_high, mass=mass)
    return CornerCurves(at_low, at_high)


def magnitude_envelope(
    loop: Loop,
    omega: ArrayLike,
    stiffness: Limits,
    damping: Limits,
    *,
    mass: ArrayLike = 0.0,
) -> Envelope:
    """Return the exact lowest and highest abs(Z_h) over a box of (k, b).

    abs(Z_h) is a distance from one point in the plane of (g·b, g·k/Ω), where the box stays a box:
    its nearest point is a clip, its farthest a corner.

    Parameters
    ----------
    loop, omega
        As in `perceived_impedance`.
    mass : array_like, optional
        m_e of the environment, kg; may be negative.
    stiffness, damping : pair of array_like
        (low, high) of k, N/m, and b, N·s/m; may be negative.

    Returns
    -------
    Envelope
        `lower` and `upper`, N·s/m, of the broadcast shape of all arguments.

    Raises
    ------
    UsageError
        As `perceived_impedance`, and for a lower limit above its upper one.
    """
    k = ordered_limits(stiffness, "stiffness", "N/m")
    b = ordered_limits(damping, "damping", "N·s/m")
    plane = DistancePlane.of(loop.at(omega), real_array(mass, "mass", "kg"))
    lower, upper = plane.over(k, b)
    return Envelope(lower[()], upper[()])


class Ellipse(NamedTuple):
    """All x with (x − centre)ᵀ shape⁻¹ (x − centre) ≤ radius².

    x is (k, b), or with `log` their natural logarithms.
    """

    centre: ArrayLike  # (2,), N/m and N·s/m, or logarithms
    shape: ArrayLike  # (2, 2), covariance of x, positive semidefinite
    radius: float
    log: bool = False


def magnitude_envelope_ellipse(
    loop: Loop, omega: ArrayLike, ellipse: Ellipse, *, mass: float = 0.0
) -> Envelope:
    """Return the lowest and highest abs(Z_h) over an ellipse of (k, b), or of their logarithms.

    Parameters
    ----------
    loop, omega
        As in `perceived_impedance`; ω above zero.
    ellipse : Ellipse
        The region of (k, b).
    mass : float
        m_e of the environment, kg; may be negative.

    Returns
    -------
    Envelope
        `lower` and `upper`, N·s/m, of ω's shape.

    Raises
    ------
    UsageError
        As `perceived_impedance`.
    """
    curve = _Curve.around(ellipse)
    plane = DistancePlane.of(loop.at(omega), mass)
    result_shape = plane.real.shape
    plane = plane.flat()
    # A mass is infinite at Nyquist.
    finite = np.isfinite(plane.per_rate) & np.isfinite(plane.real) & np.isfinite(plane.imaginary)
    extremes = np.full((2, finite.size), np.inf)
    extremes[:, finite] = _extremes_along(curve, plane.select(finite))
    lower, upper = extremes
    lower[curve.holds(plane.origin())] = 0.0
    return Envelope(lower.reshape(result_shape)[()], upper.reshape(result_shape)[()])


class _Derivatives(NamedTuple):
    """First and second derivatives of k and b by the angle."""

    k1: FloatArray
    k2: FloatArray
    b1: FloatArray
    b2: FloatArray


class _Curve(NamedTuple):
    """Edge of an ellipse by the angle φ: k = k₀ + k_cos·cos φ, b = b₀ + b_cos·cos φ + b_sin·sin φ.

    For a log-ellipse these are the logarithms of k and b.
    """

    k0: float
    b0: float
    k_cos: float
    b_cos: float
    b_sin: float
    log: bool

    @classmethod
    def around(cls, ellipse: Ellipse) -> _Curve:
        """Take the Cholesky factor of the covariance, times the radius."""
        k0, b0 = np.asarray(ellipse.centre, dtype=float)
        covariance = np.asarray(ellipse.shape, dtype=float)
        k_sd, b_sd = np.sqrt(covariance.diagonal())
        rho = 0.0
        if k_sd * b_sd:
            rho = np.clip(covariance[0, 1] / (k_sd * b_sd), -1.0, 1.0)
        # (1 − ρ)(1 + ρ) keeps the digits that 1 − ρ² would lose.
        rest = np.sqrt((1 - rho) * (1 + rho))
        return cls(
            k0=k0,
            b0=b0,
            k_cos=ellipse.radius * k_sd,
            b_cos=ellipse.radius * (rho * b_sd),
            b_sin=ellipse.radius * (rest * b_sd),
            log=ellipse.log,
        )

    def at(self, angle: FloatArray) -> Point:
        """Return k and b."""
        cos = np.cos(angle)
        k = self.k0 + self.k_cos * cos
        b = self.b0 + (self.b_cos * cos + self.b_sin * np.sin(angle))
        if self.log:
            return Point(np.exp(k), np.exp(b))
        return Point(k, b)

    def derivatives(self, angle: FloatArray) -> _Derivatives:
        """Return the derivatives of k and b."""
        cos = np.cos(angle)
        sin = np.sin(angle)
        k1 = -self.k_cos * sin
        k2 = -self.k_cos * cos
        b1 = self.b_sin * cos - self.b_cos * sin
        b2 = -self.b_cos * cos - self.b_sin * sin
        if not self.log:
            return _Derivatives(k1, k2, b1, b2)
        k, b = self.at(angle)
        return _Derivatives(
            k1=k * k1,
            k2=k * (k2 + k1 * k1),
            b1=b * b1,
            b2=b * (b2 + b1 * b1),
        )

    def holds(self, origin: Point) -> BoolArray:
        """Say where the ellipse holds the (k, b) at which Z_h vanishes."""
        x = np.array(origin)
        exists: BoolArray = np.isfinite(x).all(axis=0)
        if self.log:
            exists &= (x > 0).all(axis=0)
            x = np.log(np.where(exists, x, 1.0))
        k, b = np.where(exists, x, 0.0)
        # In units of the factor's columns the edge is the unit circle.
        first = ratio(k - self.k0, self.k_cos, empty=0.0)
        rest = b - self.b0 - times(self.b_cos, first)
        second = ratio(rest, self.b_sin, empty=0.0)
        return exists & (np.hypot(first, second) <= 1)


class _Turns(NamedTuple):
    """Angles near which the distance from the curve turns, shape (n,)."""

    omega_index: IntArray  # At which ω
    angle: FloatArray  # rad
    sign: FloatArray  # 1 for a dip, −1 for a peak


def _extremes_along(curve: _Curve, plane: DistancePlane) -> Envelope:
    """Return the smallest and the largest distance along the curve, at every ω."""
    scaled = _scaled(curve, plane)
    turns = _turns_on_grid(curve, scaled)

    def slopes(which: IntArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return half of the first and second derivatives of the square."""
        local = scaled.select(turns.omega_index[which])
        x, y = local.offsets(curve.at(angle))
        k1, k2, b1, b2 = curve.derivatives(angle)
        x1 = local.gain * b1
        y1 = -local.per_rate * k1
        x2 = local.gain * b2
        y2 = -local.per_rate * k2
        first = x * x1 + y * y1
        second = x1 * x1 + y1 * y1 + x * x2 + y * y2
        return turns.sign[which] * first, turns.sign[which] * second

    before = turns.angle - _STEP
    after = turns.angle + _STEP
    refined = rising_root(slopes, turns.angle, before, after)
    unscaled = plane.select(turns.omega_index)
    lower = np.full(plane.gain.size, np.inf)
    upper = np.zeros(plane.gain.size)
    # An angle stays as first seen where its refinement is worse in the last digits.
    for angle in (turns.angle, refined):
        with np.errstate(over="ignore"):
            distance = unscaled.distance(curve.at(angle))
        np.minimum.at(lower, turns.omega_index, distance)
        np.maximum.at(upper, turns.omega_index, distance)
    return Envelope(lower, upper)


def _scaled(curve: _Curve, plane: DistancePlane) -> DistancePlane:
    """Take a power of two out of all distances at each ω.

    Squares of numbers near one neither overflow nor vanish where they decide.
    """
    edge = curve.at(_ANGLES)
    of_damper = plane.gain * np.abs(edge.damping).max()
    _, exponents = np.frexp([of_damper, plane.real, plane.imaginary])
    # The product of g/Ω and k might overflow; the sum of their exponents cannot.
    _, of_rate = np.frexp(plane.per_rate)
    _, of_spring = np.frexp(np.abs(edge.stiffness).max())
    largest = np.maximum(exponents.max(axis=0), of_rate + of_spring)
    return DistancePlane(*(np.ldexp(field, -largest) for field in plane))


def _turns_on_grid(curve: _Curve, plane: DistancePlane) -> _Turns:
    """Return where distances turn on the grid; on it the wrong turn may look better."""
    x, y = plane.column().offsets(curve.at(_ANGLES))
    square = x * x + y * y
    before = np.roll(square, 1, axis=1)
    after = np.roll(square, -1, axis=1)
    dips = np.argwhere((square <= before) & (square <= after))
    peaks = np.argwhere((square >= before) & (square >= after))
    omega_index, angle_index = np.concatenate([dips, peaks]).T
    sign = np.repeat([1.0, -1.0], [len(dips), len(peaks)])
    return _Turns(omega_index, _ANGLES[angle_index], sign)
