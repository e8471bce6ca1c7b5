"""What a display shows over a range of ω: limits of stiffness and damping, and the paper's rule.

Stiffness and damping as displayed are ratios of polynomials in Ω², and turn at the roots of others:
their limits are exact.

The paper's rule asks whether abs(Z_h) as displayed stays between its limits over a box of (k, b).
Let D be abs(Z_h) of the display at one ω, F that of the box's farthest point and N that of its
nearest. The departure is

    max(ln D/F, ln N/D)                                negative where the display lies inside

Its largest value over a range is looked for on a grid that resolves modes and resonances, and
refined at every peak.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import FloatArray, IntArray, Scalars
from percept.haptics.loop import VelocityFilter, omega_of_rate, search_grid
from percept.haptics.perceived import Boxes, Display, displayed, shown_element
from percept.haptics.records import Coupling, Environment, Mode
from percept.searches import lowest

__all__ = [
    "ON_LIMIT",
    "Departure",
    "ShownLimits",
    "departure",
    "shown_limits",
]

#: Nearer to a limit than this, as a logarithm, a display lies on it: rounding could decide. A
#: departure keeps some 13 digits, which leaves three to spare.
ON_LIMIT = 1e-10
# Further a departure is not told apart, as a logarithm: twelve decades, beyond any ratio of two
# impedances that a limit could mean.
_LARGEST = 12.0 * float(np.log(10.0))


class ShownLimits(NamedTuple):
    """The least and the largest stiffness and damping shown over a range of ω, (2,) each."""

    stiffness: FloatArray  # N/m
    damping: FloatArray  # N·s/m


def shown_limits(display: Display, lower: float, upper: float) -> ShownLimits:
    """Return between which limits the stiffness and damping shown stay over a range of ω.

    Parameters
    ----------
    display : Display
        One, or several that share a coupling: what is shown does not depend on the device.
    lower, upper : float
        Ends of the range, rad/s, between 0 and π/T.

    Returns
    -------
    ShownLimits

    Raises
    ------
    UsageError
        The range passes Nyquist.
    """
    omega = _turning_points(display, lower, upper)
    shown = shown_element(display.loop.at(omega), display)
    return ShownLimits(_ends(shown.stiffness), _ends(shown.damping))


def _ends(values: Scalars) -> FloatArray:
    """Return the least and the largest of some values, (2,)."""
    return np.array([np.min(values), np.max(values)])


def _turning_points(display: Display, lower: float, upper: float) -> FloatArray:
    """Return both ends of a range of ω, rad/s, and where stiffness or damping turns between.

    Without a filter, and without a mass behind a coupling, both are monotone in Ω².
    """
    heavy = display.coupling is not None and bool(display.environment.mass)
    if display.loop.velocity_filter is None and not heavy:
        return np.array([lower, upper])
    half = display.loop.period / 2
    # In units of the range's middle the coefficients are of one size.
    unit = np.tan(lower * half) * np.tan(upper * half) / half**2
    shown = _shown(display, Polynomial([0.0, unit]))
    bottom = shown.denominator
    roots = []
    for top in (shown.damping, shown.stiffness):
        slope = top.deriv() * bottom - top * bottom.deriv()
        roots.append(slope.roots())
    # A root that rounding made complex still splits the range; more points do no harm.
    squares = np.maximum(np.concatenate(roots).real, 0.0) * unit
    places = omega_of_rate(np.sqrt(squares), display.loop.period)
    inner = np.clip(places, lower, upper)
    return np.array([lower, *inner, upper])


class _Shown(NamedTuple):
    """Stiffness and damping as polynomials in Ω², both over one positive denominator."""

    stiffness: Polynomial
    damping: Polynomial
    denominator: Polynomial


def _shown(display: Display, square: Polynomial) -> _Shown:
    """Return what a display shows over `square`, Ω²; a mass counts with the device."""
    environment = display.environment
    coupling = display.coupling
    front = environment if coupling is None else coupling
    nothing = 0.0 * square
    joined = _Shown(nothing + front.stiffness, nothing + front.damping, nothing + 1.0)
    if display.loop.velocity_filter is not None:
        joined = _filtered(front, display.loop.velocity_filter, display.loop.period, square)
    if coupling is None:
        return joined
    return _behind(joined, environment, square)


def _filtered(
    front: Environment | Coupling,
    velocity_filter: VelocityFilter,
    period: float,
    square: Polynomial,
) -> _Shown:
    """Return the spring of what joins the device, and its damper, on the filtered velocity.

    F is 1/B(jx) with x = Ω/Ω_c and Butterworth's polynomial B: abs(B(jx))² = 1 + x^(2·order), the
    real part of B(jx) is even in x and its imaginary part odd.
    """
    half = period / 2
    cutoff = float(np.tan(velocity_filter.cutoff * half)) / half
    relative = square * (1.0 / cutoff**2)
    size = relative**velocity_filter.order + 1.0
    coefficients = _butterworth(velocity_filter.order)
    real = Polynomial(coefficients[::2])(relative)
    imaginary_over_x = Polynomial(coefficients[1::2])(relative)
    stiffness = size * front.stiffness + relative * imaginary_over_x * (front.damping * cutoff)
    return _Shown(stiffness, real * front.damping, size)


def _butterworth(order: int) -> list[float]:
    """Return B's coefficients, with the signs that j² gives the real and the imaginary part."""
    angles = np.pi * (2 * np.arange(order) + 1) / (2 * order)
    roots = -np.sin(angles) + 1j * np.cos(angles)
    from_lowest = np.poly(roots).real[::-1]
    return [(-1.0) ** (power // 2) * value for power, value in enumerate(from_lowest)]


def _behind(joined: _Shown, environment: Environment, square: Polynomial) -> _Shown:
    """Return an environment behind what joins the device, without the environment's mass."""
    k = environment.stiffness - environment.mass * square
    b = environment.damping
    of_joined = joined.damping * joined.damping * square + joined.stiffness * joined.stiffness
    of_environment = b**2 * square + k * k
    damping = b * joined.denominator + joined.damping
    stiffness = k * joined.denominator + joined.stiffness
    of_sum = damping * damping * square + stiffness * stiffness
    by_joined = of_environment * joined.denominator
    return _Shown(
        stiffness=of_joined * k + by_joined * joined.stiffness + environment.mass * square * of_sum,
        damping=of_joined * b + by_joined * joined.damping,
        denominator=of_sum,
    )


class Departure(NamedTuple):
    """How far abs(Z_h) leaves its limits at most; negative inside."""

    largest: float  # A log ratio
    omega: float  # Where, rad/s

    @property
    def verdict(self) -> Literal["inside", "marginal", "outside"]:
        """Judge; within rounding it is marginal."""
        if self.largest > ON_LIMIT:
            return "outside"
        return "inside" if self.largest < -ON_LIMIT else "marginal"


def departure(display: Display, box: Boxes, lower: float, upper: float) -> Departure:
    """Search for the largest departure of abs(Z_h) from a box over a range of ω.

    Parameters
    ----------
    display : Display
        A single one.
    box : Boxes
        Its limits of stiffness and damping.
    lower, upper : float
        Ends of the range, rad/s, above 0 and up to π/T.

    Returns
    -------
    Departure

    Raises
    ------
    UsageError
        The range passes Nyquist or leaves a device's table.
    """

    def depth_inside(omega: FloatArray, _: IntArray) -> FloatArray:
        """Return the departure at each ω with its sign changed, limited to what is told apart."""
        plane, magnitude = displayed(display, omega.ravel())
        extremes = box.extremes(plane)
        with np.errstate(divide="ignore", invalid="ignore"):
            above = magnitude / plane.distance(extremes.farthest)
            below = plane.distance(extremes.nearest) / magnitude
            departs = np.log(np.fmax(above, below))
        # NaN is 0/0: the display vanishes with the region's own curve, and departs from nothing.
        departs = np.where(np.isnan(departs), -_LARGEST, departs)
        return -np.clip(departs, -_LARGEST, _LARGEST).reshape(omega.shape)

    candidates = search_grid(display.loop, _resonances(display, box), within=(lower, upper))
    least = lowest(depth_inside, candidates, 1)
    return Departure(-float(least.value[0]), float(least.x[0]))


def _resonances(display: Display, box: Boxes) -> tuple[Mode, ...]:
    """Return what the masses of device and environment make with the springs shown."""
    environment = display.environment
    device = display.loop.device
    mass = float(getattr(device, "mass", 0.0)) + float(environment.mass)
    damping = float(getattr(device, "damping", 0.0)) + float(environment.damping)
    to_ground = float(getattr(device, "stiffness", 0.0))
    springs = [float(environment.stiffness), *np.maximum(box.stiffness, 0.0).ravel()]
    modes = [Mode(mass, to_ground + spring, damping) for spring in springs]
    if display.coupling is not None:
        behind = float(environment.stiffness + display.coupling.stiffness)
        modes.append(Mode(environment.mass, behind, environment.damping))
    return tuple(modes)
