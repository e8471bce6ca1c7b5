"""Stiffness and damping that an environment shows through a coupling, at their extremes over a range of ω."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import FloatArray
from percept.haptics.forms import Display
from percept.haptics.impedance import Element, series, warp


def shown_at(display: Display, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping shown at ω (n,), N/m and N·s/m; the environment's mass is not counted."""
    grid, own = warp(omega, display.period), display.environment
    felt = Element(own.stiffness, own.damping, own.mass)
    if display.coupling is not None:
        felt = series(grid, felt, Element(display.coupling.stiffness, display.coupling.damping))
        felt = Element(felt.stiffness + np.multiply(own.mass, grid.rate**2), felt.damping)
    stiffness, damping = (np.broadcast_to(part, grid.omega.shape) for part in (felt.stiffness, felt.damping))
    return stiffness, damping


def turning_points(display: Display, lower: float, upper: float) -> FloatArray:
    """Return both ends of a range of ω, and where stiffness or damping turns between them, rad/s."""
    own, half = display.environment, display.period / 2
    turns = np.empty(0)
    if display.coupling is not None and own.mass:
        # In units of the range's middle the coefficients are of one size.
        unit = np.tan(lower * half) * np.tan(upper * half) / half**2
        x = Polynomial([0.0, unit])
        spring, k_c, b_c = own.stiffness - own.mass * x, display.coupling.stiffness, display.coupling.damping
        first, second = own.damping**2 * x + spring**2, b_c**2 * x + k_c**2
        under = (own.damping + b_c) ** 2 * x + (spring + k_c) ** 2
        shown = first * b_c + second * own.damping, first * k_c + second * spring + own.mass * x * under
        roots = [(over.deriv() * under - over * under.deriv()).roots() for over in shown]
        # A root that rounding made complex still splits the range; more points do no harm.
        rates = np.sqrt(np.maximum(np.concatenate(roots).real, 0.0) * unit)
        turns = np.arctan(rates * half) / half
    return np.array([lower, *np.sort(turns[(turns > lower) & (turns < upper)]), upper])


def shown_range(
    display: Display, lower: float, upper: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the smallest and largest stiffness, then damping, shown over a range of ω; exact.

    Without mass both are monotone in Ω², with it they turn at the roots of a polynomial.
    """
    stiffness, damping = shown_at(display, turning_points(display, lower, upper))
    return (float(stiffness.min()), float(stiffness.max())), (float(damping.min()), float(damping.max()))
