"""Between which limits the stiffness and damping that a display shows stay, exactly.

Both are ratios of polynomials in Ω², and turn at the roots of others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import FloatArray, Scalars
from percept.haptics.loop import VelocityFilter, omega_of_rate
from percept.haptics.perceived import Display, shown_element
from percept.haptics.records import Coupling, Environment

__all__ = ["ShownLimits", "shown_limits", "turning_points"]


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
    omega = turning_points(display, lower, upper)
    shown = shown_element(display.loop.at(omega), display)
    return ShownLimits(_ends(shown.stiffness), _ends(shown.damping))


def _ends(values: Scalars) -> FloatArray:
    return np.array([np.min(values), np.max(values)])


def turning_points(display: Display, lower: float, upper: float) -> FloatArray:
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
    """Return what a display shows; its environment's mass counts with the device."""
    environment = display.environment
    coupling = display.coupling
    joining = environment if coupling is None else coupling
    nothing = 0.0 * square
    joined = _Shown(nothing + joining.stiffness, nothing + joining.damping, nothing + 1.0)
    if display.loop.velocity_filter is not None:
        joined = _filtered(joining, display.loop.velocity_filter, display.loop.period, square)
    if coupling is None:
        return joined
    return _behind(joined, environment, square)


def _filtered(
    joining: Environment | Coupling,
    velocity_filter: VelocityFilter,
    period: float,
    square: Polynomial,
) -> _Shown:
    """Return a spring and a damper that acts on the filtered velocity.

    F is 1/B(jx) with x = Ω/Ω_c and Butterworth's polynomial B: abs(B(jx))² = 1 + x^(2·order), the
    real part of B(jx) is even in x and its imaginary part odd.
    """
    half = period / 2
    cutoff = float(np.tan(velocity_filter.cutoff * half)) / half
    relative = square * (1.0 / cutoff**2)
    size = relative**velocity_filter.order + 1.0
    coefficients = _butterworth(velocity_filter.order)
    real = Polynomial(coefficients[::2])(relative)
    imaginary_over_x = Polynomial([*coefficients[1::2]])(relative)
    stiffness = size * joining.stiffness + relative * imaginary_over_x * (joining.damping * cutoff)
    return _Shown(stiffness, real * joining.damping, size)


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
