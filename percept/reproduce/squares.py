"""Squares of the paper's curves as ratios of polynomials, and every place where two of them cross.

With g the hold's gain (Eq. 8) and Ω = (2/T)·tan(ωT/2), Ω²·|Z_h|²/g² is the square of a ratio of
polynomials in Ω, or in m_e. Between two neighbouring crossings no curve changes place, so one point
decides for all.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from percept.haptics import Coupling, Device

Array = NDArray[np.float64]

#: Stands for Ω, or for m_e, where a number could stand too.
VARIABLE = Polynomial([0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Square:
    """|p/q|² of two polynomials with complex coefficients in one real variable."""

    over: Polynomial
    under: Polynomial

    @classmethod
    def of(cls, p: Any, q: Any = 1.0) -> Square:
        """Return the square of p/q."""
        return cls(_square(p), _square(q))


def _square(p: Any) -> Polynomial:
    coefficients = np.atleast_1d(p.coef if isinstance(p, Polynomial) else p)
    return Polynomial(np.convolve(coefficients, coefficients.conj()).real)


def felt_square(
    device: Device,
    k: float,
    b: float,
    period: float,
    *,
    coupling: Coupling | None = None,
    rate: Any = VARIABLE,
    mass: Any = 0.0,
    resonance: float = np.inf,
) -> Square:
    """Return Ω²·|Z_h|²/g² (Eqs 11 to 13), with the device's mass rigid or on an undamped mode (rad/s)."""
    rendered: Any = k + 1j * b * rate - mass * rate**2
    joined: Any = 1.0
    if coupling is not None:
        between = float(coupling.stiffness) + 1j * float(coupling.damping) * rate
        rendered, joined = rendered * between, rendered + between
    bends = 1 - (rate / resonance) ** 2
    own = float(device.damping) * bends + 1j * float(device.mass) * rate
    own = own * (1 + 0.5j * period * rate) * 1j * rate
    return Square.of(own * joined + rendered * bends, joined * bends)


def rendered_square(k: float, b: float, period: float) -> Square:
    """Return Ω²·|Z_e|²/g² (Eq. 7)."""
    return Square.of((k + 1j * b * VARIABLE) * (1 + 0.5j * period * VARIABLE))


def envelope_squares(device: Device, box: Array, period: float) -> list[Square]:
    """Return the pieces of the exact envelope over a box (2, 2) of k and b: four corners, four edges."""
    stiffness, damping = box.tolist()
    mass, own = float(device.mass), float(device.damping)
    across = own - mass * period / 2 * VARIABLE**2
    along = (own * period / 2 + mass) * VARIABLE**2
    corners = [felt_square(device, k, b, period) for k in stiffness for b in damping]
    return [
        *corners,
        *(Square.of((b + across) * VARIABLE) for b in damping),
        *(Square.of(along - k) for k in stiffness),
    ]


def crossings(squares: Iterable[Square], low: float, high: float) -> Array:
    """Return where any two squares are equal, strictly between two values of the variable, increasing."""
    pairs = combinations(squares, 2)
    roots = [real_roots(one.over * other.under - other.over * one.under) for one, other in pairs]
    every = np.unique(np.concatenate(roots))
    return every[(every > low) & (every < high)]


def real_roots(polynomial: Polynomial) -> Array:
    """Return the real roots; none of a polynomial that vanishes."""
    roots = polynomial.roots()
    return roots.real[np.imag(roots) == 0]


def cells(squares: Iterable[Square], low: float, high: float, period: float) -> tuple[Array, Array]:
    """Return the edges, rad/s, of the cells that crossings cut a range of ω into, and a point in each."""
    rates = [2 / period * np.tan(omega * period / 2) for omega in (low, high)]
    inner = 2 / period * np.arctan(crossings(squares, *rates) * period / 2)
    edges = np.concatenate([[low], inner, [high]])
    return edges, np.sqrt(edges[1:] * edges[:-1])


def share(edges: Array, true: NDArray[np.bool_]) -> float:
    """Return the share of a range, on a logarithmic scale, whose cells are true."""
    lengths = np.diff(np.log(edges))
    return float(lengths[true].sum() / lengths.sum()) if not true.all() else 1.0


def largest_ratio(one: Square, other: Square, low: float, high: float, period: float) -> float:
    """Return the largest ratio of two curves, the higher over the lower, over a range of ω, rad/s."""
    over, under = one.over * other.under, other.over * one.under
    ends = [2 / period * np.tan(omega * period / 2) for omega in (low, high)]
    turns = real_roots(over.deriv() * under - over * under.deriv())
    rates = np.concatenate([ends, turns[(turns > ends[0]) & (turns < ends[1])]])
    ratios = np.sqrt(over(rates) / under(rates))
    return float(np.maximum(ratios, 1 / ratios).max())
