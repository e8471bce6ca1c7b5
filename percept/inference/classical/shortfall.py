"""The chance that a multiple of the sample SD falls short, as sums of positive terms.

With Z standard normal and s = SD/σ independent of it, both limits of a tolerance interval, noncentral t and
the coefficient of variation come down to P(y(Z) > c·s), integrated by Gauss–Legendre: over Z with the lower
tail of χ²_ν inside, or, where c is so small that this tail is a step in Z, over s with the normal tail.
Every term is positive and as small as the answer, so small probabilities keep their digits. The solvers work
on logarithms, in which these probabilities are concave: started on the right side, Newton's steps run up to
the root.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.classical.quantiles import normal_upper

Array: TypeAlias = NDArray[np.float64]

NEWTON_STEPS = 60
_NODES = 200
_SLIGHT = 1.5  # multiples of the SD below this are integrated over s
_NEGLIGIBLE = 1e-17  # of the probability wanted: what the quadrature leaves out beyond its last node


def reach_of(doubt: Array) -> Array:
    """Return how far out, in SDs, a normal still matters to the probability `doubt`."""
    return normal_upper(doubt * _NEGLIGIBLE)


def solve_factor(radius: Array, weight: Array, n: Array, doubt: Array, start: Array) -> Array:
    """Solve Σ weight · P(χ²_ν < ν radius²/c²) = doubt for c, from above."""
    half = (n[:, None] - 1.0) / 2.0
    scale = special.gammaln(half)

    def short(log_factor: Array) -> tuple[Array, Array]:
        x = half * (radius / np.exp(log_factor)[:, None]) ** 2
        with np.errstate(divide="ignore"):
            density = np.exp(half * np.log(x) - x - scale)  # times x
        held_short = weight * special.gammainc(half, x)
        return held_short.sum(axis=1), -2.0 * (weight * density).sum(axis=1)

    return np.exp(_newton(short, np.log(start), doubt))


def one_limit_factor(n: Array, offset: Array, doubt: Array) -> Array:
    """Solve P(Z + offset > factor·√n·s) = doubt for a positive factor."""
    root = np.sqrt(n)
    # too large: the sum is exceeded only if Z is larger, or s smaller, than its bound
    start = (offset + normal_upper(doubt / 2.0)) / root / least_spread(n, doubt / 2.0)

    def over_z(n: Array, root: Array, offset: Array, doubt: Array, start: Array) -> Array:
        edge = reach_of(doubt)
        z, weight = normal_nodes(np.maximum(-offset, -edge), edge)
        return solve_factor((z + offset[:, None]) / root[:, None], weight, n, doubt, start)

    def over_s(n: Array, root: Array, offset: Array, doubt: Array, start: Array) -> Array:
        s, weight = _spread_nodes(n, doubt)

        def short(log_factor: Array) -> tuple[Array, Array]:
            t = np.exp(log_factor) * root
            excess = t[:, None] * s - offset[:, None]
            slope = -t * (weight * s * _density(excess)).sum(axis=1)
            return (weight * special.ndtr(-excess)).sum(axis=1), slope

        return np.exp(_newton(short, np.log(start), doubt))

    return _either(start < _SLIGHT, over_s, over_z, n, root, offset, doubt, start)


def one_limit_offset(n: Array, factor: Array, doubt: Array, *, short: bool) -> Array:
    """Solve for the offset of a noncentral t, given where its tail begins."""
    t = factor * np.sqrt(n)
    half = (n - 1.0) / 2.0
    if short:
        start = t * least_spread(n, doubt / 2.0) - normal_upper(doubt / 2.0)
    else:
        start = t * np.sqrt(special.gammainccinv(half, doubt / 2.0) / half) + normal_upper(doubt / 2.0)

    def over_z(half: Array, t: Array, doubt: Array, start: Array) -> Array:
        edge = reach_of(doubt)
        inner = special.gammainc if short else special.gammaincc

        def tail(offset: Array) -> tuple[Array, Array]:
            z, weight = normal_nodes(np.maximum(-offset, -edge), np.maximum(edge, -offset))
            ratio = (z + offset[:, None]) / t[:, None]
            inside = weight * inner(half[:, None], half[:, None] * ratio**2)
            probability, slope = inside.sum(axis=1), (z * inside).sum(axis=1)
            if short:
                return probability, slope
            # below Z = −offset the sum is negative, and so below any multiple of s
            return probability + special.ndtr(-offset), slope - _density(offset)

        return _newton(tail, start, doubt)

    def over_s(half: Array, t: Array, doubt: Array, start: Array) -> Array:
        s, weight = _spread_nodes(2.0 * half + 1.0, doubt)
        sign = 1.0 if short else -1.0

        def tail(offset: Array) -> tuple[Array, Array]:
            excess = t[:, None] * s - offset[:, None]
            slope = sign * (weight * _density(excess)).sum(axis=1)
            return (weight * special.ndtr(-sign * excess)).sum(axis=1), slope

        return _newton(tail, start, doubt)

    return _either(factor < _SLIGHT, over_s, over_z, half, t, doubt, start)


def least_spread(n: Array, doubt: Array) -> Array:
    """Return the SD, in units of the population's, that a sample's falls below with probability `doubt`."""
    half = (n - 1.0) / 2.0
    return np.sqrt(special.gammaincinv(half, doubt) / half)


def normal_nodes(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return Gauss–Legendre nodes between the bounds, and weights with the normal density."""
    node, weight = _legendre()
    middle, half = (upper + lower)[:, None] / 2.0, (upper - lower)[:, None] / 2.0
    z = middle + half * node
    return z, half * weight * _density(z)


def _newton(tail: Callable[[Array], tuple[Array, Array]], start: Array, doubt: Array) -> Array:
    """Solve log tail = log doubt, the tail given with its slope."""
    x = start
    for _ in range(NEWTON_STEPS):
        probability, slope = tail(x)
        step = np.log(probability / doubt) * probability / slope
        x = x - step
        if (np.abs(step) <= 1e-15 * np.maximum(1.0, np.abs(x))).all():
            break
    return x


def _either(
    first: NDArray[np.bool_], solve: Callable[..., Array], solve_rest: Callable[..., Array], *columns: Array
) -> Array:
    """Solve some requests one way and the rest another."""
    answer = np.empty(first.shape)
    for chosen, solver in ((first, solve), (~first, solve_rest)):
        if chosen.any():
            answer[chosen] = solver(*(column[chosen] for column in columns))
    return answer


def _spread_nodes(n: Array, doubt: Array) -> tuple[Array, Array]:
    """Return Gauss–Legendre nodes of s and weights with its density, one row each.

    The weights are scaled to add up to one: that is what they do, and the constant of the density is lost to
    rounding in large samples.
    """
    half = (n - 1.0) / 2.0
    lower = np.sqrt(special.gammaincinv(half, doubt * _NEGLIGIBLE) / half)
    upper = np.sqrt(special.gammainccinv(half, doubt * _NEGLIGIBLE) / half)
    node, weight = _legendre()
    beyond = ((upper + lower) / 2.0 - 1.0)[:, None] + ((upper - lower) / 2.0)[:, None] * node
    s = 1.0 + beyond
    excess = beyond * (2.0 + beyond)  # s² − 1
    density = weight * np.exp(half[:, None] * (np.log1p(excess) - excess)) / s
    return s, density / density.sum(axis=1, keepdims=True)


def _density(z: Array) -> Array:
    return np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)


@cache
def _legendre() -> tuple[Array, Array]:
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    return node, weight
