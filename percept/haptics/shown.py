"""What a display shows at each Ω²: stiffness and damping as polynomials over a positive one."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import FloatArray, Scalars
from percept.haptics.axis import omega_of_rate, warp
from percept.haptics.perceived import shown_element
from percept.haptics.polynomials import Form
from percept.haptics.records import Coupling, Display, Environment

__all__ = ["Shown", "ShownLimits", "shown_by", "shown_limits", "turning_points", "turns"]

# A polynomial in Ω², of either kind.
Curve = TypeVar("Curve", Form, Polynomial)


class Shown(NamedTuple, Generic[Curve]):
    """Stiffness and damping that a display shows, both over one positive denominator."""

    stiffness: Curve
    damping: Curve
    denominator: Curve


def shown_by(display: Display, square: Curve) -> Shown[Curve]:
    """Return what a display shows through its coupling, its filter, or both.

    Parameters
    ----------
    display : Display
        With a `Form` for Ω² the coupling's parameters may hold one number per piece. Its
        environment's mass counts with the device, and is not shown.
    square : Form or Polynomial
        Ω², rad²/s².

    Returns
    -------
    Shown
        Of the type of `square`.
    """
    environment = display.environment
    coupling = display.coupling
    filters = [environment.velocity_filter]
    if coupling is not None:
        filters.append(coupling.velocity_filter)
    if coupling is not None and not any(filters):
        return _through(coupling, environment, square)
    first = _spring_and_damper(environment, display.period, square)
    if coupling is None:
        return first
    second = _spring_and_damper(coupling, display.period, square)
    return _in_series(first, second, square, environment.mass)


def _through(coupling: Coupling, environment: Environment, square: Curve) -> Shown[Curve]:
    """Return what an environment shows through a coupling, both without a filter."""
    k = environment.stiffness
    b = environment.damping
    m = environment.mass
    k_c = coupling.stiffness
    b_c = coupling.damping
    # Without a mass the spring stays a number, which keeps all degrees low.
    spring: Curve | Scalars = k - m * square if m else k
    # Ω²·abs(Z)² of environment, coupling and their sum.
    of_environment = b**2 * square + spring * spring
    of_coupling = b_c**2 * square + np.square(k_c)
    joined = spring + k_c
    of_sum = (b + b_c) ** 2 * square + joined * joined
    stiffness = k_c * of_environment + of_coupling * spring
    if m:
        stiffness = stiffness + m * square * of_sum
    return Shown(stiffness, b_c * of_environment + b * of_coupling, of_sum)


def _spring_and_damper(
    element: Environment | Coupling, period: float, square: Curve
) -> Shown[Curve]:
    """Return a spring and a damper, which may act on the filtered velocity.

    F is 1/B(jx) with x = Ω/Ω_c and Butterworth's polynomial B: abs(B(jx))² = 1 + x^(2·order), the
    real part of B(jx) is even in x and its imaginary part odd.
    """
    k = element.stiffness
    b = element.damping
    velocity_filter = element.velocity_filter
    nothing = 0.0 * square
    if velocity_filter is None:
        return Shown(nothing + k, nothing + b, nothing + 1.0)
    half = period / 2
    cutoff = float(np.tan(velocity_filter.cutoff * half)) / half
    relative = square * (1.0 / cutoff**2)
    size = nothing + 1.0
    for _ in range(velocity_filter.order):
        size = size * relative
    size = size + 1.0
    coefficients = _butterworth(velocity_filter.order)
    real = _polynomial(coefficients[::2], relative)
    imaginary_over_x = _polynomial(coefficients[1::2], relative)
    stiffness = size * k + relative * imaginary_over_x * np.multiply(b, cutoff)
    return Shown(stiffness, real * b, size)


def _butterworth(order: int) -> list[float]:
    """Return B's coefficients, with the signs that j² gives the real and the imaginary part."""
    angles = np.pi * (2 * np.arange(order) + 1) / (2 * order)
    roots = -np.sin(angles) + 1j * np.cos(angles)
    from_lowest = np.poly(roots).real[::-1]
    signs = [(-1.0) ** (power // 2) for power in range(order + 1)]
    return [sign * float(value) for sign, value in zip(signs, from_lowest, strict=True)]


def _polynomial(coefficients: list[float], variable: Curve) -> Curve:
    """Return a polynomial of a variable, its coefficients from the lowest up."""
    total = 0.0 * variable + coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = total * variable + coefficient
    return total


def _in_series(
    first: Shown[Curve], second: Shown[Curve], square: Curve, mass: Scalars
) -> Shown[Curve]:
    """Return two elements in series, the first with a mass, which is then taken off again."""
    spring = first.stiffness - mass * square * first.denominator
    of_first = first.damping * first.damping * square + spring * spring
    of_second = second.damping * second.damping * square + second.stiffness * second.stiffness
    damping = first.damping * second.denominator + second.damping * first.denominator
    joined = spring * second.denominator + second.stiffness * first.denominator
    of_sum = damping * damping * square + joined * joined
    by_first = of_second * first.denominator
    by_second = of_first * second.denominator
    return Shown(
        stiffness=by_first * spring + by_second * second.stiffness + mass * square * of_sum,
        damping=by_first * first.damping + by_second * second.damping,
        denominator=of_sum,
    )


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
        The range passes Nyquist; T not positive.
    """
    omega = turning_points(display, lower, upper)
    shown = shown_element(warp(omega, display.period), display)
    return ShownLimits(_ends(shown.stiffness), _ends(shown.damping))


def _ends(values: Scalars) -> FloatArray:
    return np.array([np.min(values), np.max(values)])


def turns(display: Display) -> bool:
    """Say whether the stiffness or damping shown may turn within the range."""
    if display.environment.velocity_filter is not None:
        return True
    coupling = display.coupling
    if coupling is None:
        return False
    return coupling.velocity_filter is not None or bool(display.environment.mass)


def turning_points(display: Display, lower: float, upper: float) -> FloatArray:
    """Return both ends of a range of ω, rad/s, and where stiffness or damping turns between.

    Without a mass and a filter both are monotone in Ω².
    """
    if not turns(display):
        return np.array([lower, upper])
    half = display.period / 2
    # In units of the range's middle the coefficients are of one size.
    unit = np.tan(lower * half) * np.tan(upper * half) / half**2
    square = Polynomial([0.0, unit])
    stiffness, damping, bottom = shown_by(display, square)
    roots = []
    for top in (damping, stiffness):
        slope = top.deriv() * bottom - top * bottom.deriv()
        roots.append(slope.roots())
    # A root that rounding made complex still splits the range; more points do no harm.
    squares = np.maximum(np.concatenate(roots).real, 0.0) * unit
    places = omega_of_rate(np.sqrt(squares), display.period)
    inner = np.clip(places, lower, upper)
    return np.array([lower, *inner, upper])
