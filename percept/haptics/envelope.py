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
from percept.searches import lowest

# rad: curves are looked at every degree, and each extreme is refined within a degree to either
# side. A plain ellipse has at most four.
_ANGLES = np.linspace(0.0, 2 * np.pi, 361)
# N·s/m; curves of logarithms may go further.
_LARGEST = float(np.finfo(float).max)


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


def _extremes_along(curve: _Curve, plane: DistancePlane) -> FloatArray:
    """Return the smallest and the largest distance along the curve at each of n ω, (2, n)."""
    count = plane.gain.size

    def signed(angle: FloatArray, which: IntArray) -> FloatArray:
        """Return the distances, and then all of them with their sign changed."""
        sign, index = np.divmod(which, count)
        with np.errstate(over="ignore"):
            distance = plane.select(index).distance(curve.at(angle))
        # Differences of infinities would hide a peak from the search.
        return np.where(sign, -1.0, 1.0) * np.minimum(distance, _LARGEST)

    lower, negative_upper = lowest(signed, _ANGLES, 2 * count).value.reshape(2, count)
    return np.stack([lower, -negative_upper])
