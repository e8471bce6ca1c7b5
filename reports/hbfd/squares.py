"""Squares of the paper's curves as ratios of polynomials, and every place where two of them cross.

With g the hold's gain (Eq. 8) and Ω = (2/T)·tan(ωT/2), Ω²·|Z_h|²/g² is the square of a ratio of
polynomials in Ω, or in m_e. Between two neighbouring crossings no curve changes place, so one point
decides for all.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from percept.haptics import Coupling, Device, Environment

Array = NDArray[np.float64]
#: A number, or a polynomial in the variable.
Term: TypeAlias = complex | Polynomial

#: Stands for Ω, or for m_e, where a number could stand too.
VARIABLE = Polynomial([0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Square:
    """|p/q|² of two polynomials with complex coefficients in one real variable."""

    over: Polynomial
    under: Polynomial

    @classmethod
    def of(cls, p: Term, q: Term = 1.0) -> Square:
        """Return the square of p/q."""
        return cls(_square(p), _square(q))

    def at(self, value: float) -> float:
        """Return the square at a value of the variable."""
        return float(self.over(value) / self.under(value))


def _square(p: Term) -> Polynomial:
    coefficients = np.atleast_1d(p.coef if isinstance(p, Polynomial) else p)
    product = np.convolve(coefficients, coefficients.conj())
    return Polynomial(product.real)


def felt_square(
    device: Device,
    environment: Environment,
    period: float,
    *,
    coupling: Coupling | None = None,
    rate: Term = VARIABLE,
    mass: Term = 0.0,
    resonance: float = np.inf,
) -> Square:
    """Return Ω²·|Z_h|²/g² (Eqs 11 to 13).

    Parameters
    ----------
    device : Device
        Rigid, or with its mass on an undamped mode where `resonance` is finite.
    environment : Environment
        What is shown; its mass is `mass`.
    period : float
        T, s.
    coupling : Coupling, optional
        Between device and environment.
    rate, mass : float or Polynomial, optional
        Ω, 1/s, and m_e, kg: one of them is the variable.
    resonance : float, optional
        Of the mode, rad/s.

    Returns
    -------
    Square
        In the variable.
    """
    rendered: Term = _rendered(environment, rate) - mass * rate**2
    joined: Term = 1.0
    if coupling is not None:
        between = _rendered(coupling, rate)
        joined = rendered + between
        rendered = rendered * between
    bends = 1 - (rate / resonance) ** 2
    inertia = float(device.damping) * bends + 1j * float(device.mass) * rate
    # The hold's delay e^{−jωT/2} is 1/(1 + jΩT/2) but for the gain.
    delay = 1 + 0.5j * period * rate
    inertial = inertia * delay * 1j * rate
    return Square.of(inertial * joined + rendered * bends, joined * bends)


def rendered_square(environment: Environment, period: float) -> Square:
    """Return Ω²·|Z_e|²/g² (Eq. 7)."""
    delay = 1 + 0.5j * period * VARIABLE
    return Square.of(_rendered(environment, VARIABLE) * delay)


def _rendered(environment: Environment | Coupling, rate: Term) -> Term:
    """Return jΩ times the impedance of a spring and a damper."""
    return float(environment.stiffness) + 1j * float(environment.damping) * rate


def envelope_squares(device: Device, box: Array, period: float) -> list[Square]:
    """Return the pieces of the exact envelope over a box (2, 2) of k and b: corners and edges."""
    stiffness, damping = box.tolist()
    mass = float(device.mass)
    device_damping = float(device.damping)
    across = device_damping - mass * period / 2 * VARIABLE**2
    along = (device_damping * period / 2 + mass) * VARIABLE**2
    squares = []
    for k in stiffness:
        for b in damping:
            squares.append(felt_square(device, Environment(k, b), period))
    for b in damping:
        squares.append(Square.of((b + across) * VARIABLE))
    for k in stiffness:
        squares.append(Square.of(along - k))
    return squares


def crossings(squares: Iterable[Square], low: float, high: float) -> Array:
    """Return where any two squares are equal, strictly inside a range of the variable."""
    roots = []
    for first, second in combinations(squares, 2):
        difference = first.over * second.under - second.over * first.under
        roots.append(_real_roots(difference))
    values = np.unique(np.concatenate(roots))
    return values[(values > low) & (values < high)]


def _real_roots(polynomial: Polynomial) -> Array:
    """Return the real roots; none of a polynomial that vanishes."""
    roots = polynomial.roots()
    real = np.imag(roots) == 0
    return np.asarray(roots.real[real])


def tustin_rate(omega: float, period: float) -> float:
    """Return Ω = (2/T)·tan(ωT/2), 1/s."""
    theta = omega * period
    return 2 / period * float(np.tan(theta / 2))


def cells(squares: Iterable[Square], low: float, high: float, period: float) -> tuple[Array, Array]:
    """Cut a range of ω where any two curves cross.

    Parameters
    ----------
    squares : iterable of Square
        The curves, in Ω.
    low, high : float
        The range, rad/s.
    period : float
        T, s.

    Returns
    -------
    edges : ndarray, shape (n + 1,)
        Of the cells, rad/s: no two curves cross inside one.
    middles : ndarray, shape (n,)
        A point in each cell, rad/s.
    """
    rates = crossings(squares, tustin_rate(low, period), tustin_rate(high, period))
    inner = 2 / period * np.arctan(rates * period / 2)
    edges = np.concatenate([[low], inner, [high]])
    return edges, np.sqrt(edges[1:] * edges[:-1])


def share(edges: Array, true: NDArray[np.bool_]) -> float:
    """Return the share of a range, on a log scale, whose cells are true; exactly 1 for all."""
    if true.all():
        return 1.0
    lengths = np.diff(np.log(edges))
    return float(lengths[true].sum() / lengths.sum())


def largest_ratio(first: Square, second: Square, low: float, high: float, period: float) -> float:
    """Return the largest ratio of two curves, either over the other, in a range of ω, rad/s."""
    over = first.over * second.under
    under = second.over * first.under
    start = tustin_rate(low, period)
    end = tustin_rate(high, period)
    # Inside the range a largest or least ratio is stationary.
    turns = _real_roots(over.deriv() * under - over * under.deriv())
    inside = turns[(turns > start) & (turns < end)]
    rates = np.concatenate([[start, end], inside])
    ratios = np.sqrt(over(rates) / under(rates))
    return float(np.maximum(ratios, 1 / ratios).max())
