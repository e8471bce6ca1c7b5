"""The chance that a multiple of the sample SD falls short, as sums of positive terms.

With Z standard normal and s = SD/σ independent of it, both limits of a tolerance interval, noncentral t and
the coefficient of variation come down to P(y(Z) > c·s), integrated over Z by Gauss–Legendre with the lower
tail of χ²_ν inside. Every term is positive and as small as the answer, so small probabilities keep their
digits; solvers work on logarithms, in which these probabilities are concave.
"""

from __future__ import annotations

from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.classical.quantiles import normal_upper

__all__ = [
    "NEWTON_STEPS",
    "least_spread",
    "normal_nodes",
    "one_limit_factor",
    "one_limit_offset",
    "reach_of",
    "solve_factor",
]

Array: TypeAlias = NDArray[np.float64]

NEWTON_STEPS = 60
_NODES = 200
_NEGLIGIBLE = 1e-17  # of the probability wanted: what the quadrature leaves out beyond its last node


def reach_of(doubt: Array) -> Array:
    """Return how far out, in SDs, a normal still matters to the probability `doubt`."""
    return normal_upper(doubt * _NEGLIGIBLE)


def one_limit_factor(n: Array, offset: Array, doubt: Array) -> Array:
    """Solve P(Z + offset > factor·√n·s) = doubt for the factor; the offset is √n times the quantile."""
    start = (offset + normal_upper(doubt / 2.0)) / np.sqrt(n) / least_spread(n, doubt / 2.0)
    edge = reach_of(doubt)
    z, weight = normal_nodes(np.maximum(-offset, -edge), edge)
    return solve_factor((z + offset[:, None]) / np.sqrt(n)[:, None], weight, n, doubt, start)


def one_limit_offset(n: Array, factor: Array, doubt: Array, *, short: bool) -> Array:
    """Solve for the offset of a noncentral t, given where its tail begins.

    Parameters
    ----------
    n, factor, doubt : ndarray
        Shape (m,): sample size, positive multiple c of the SD, and the probability of the tail.
    short : bool
        True: P(Z + offset > c√n·s) = doubt; False: P(Z + offset ≤ c√n·s) = doubt.

    Returns
    -------
    ndarray
        Shape (m,): the offset (noncentrality) √n·mean/σ.
    """
    t = factor * np.sqrt(n)
    half = (n - 1.0) / 2.0
    edge = reach_of(doubt)
    if short:
        offset = t * least_spread(n, doubt / 2.0) - normal_upper(doubt / 2.0)
    else:
        offset = t * np.sqrt(special.gammainccinv(half, doubt / 2.0) / half) + normal_upper(doubt / 2.0)
    inner = special.gammainc if short else special.gammaincc
    for _ in range(NEWTON_STEPS):
        z, weight = normal_nodes(np.maximum(-offset, -edge), np.maximum(edge, -offset))
        inside = weight * inner(half[:, None], half[:, None] * ((z + offset[:, None]) / t[:, None]) ** 2)
        probability, slope = inside.sum(axis=1), (z * inside).sum(axis=1)
        if not short:  # below Z = −offset the numerator is negative, and so below any multiple of s
            probability = probability + special.ndtr(-offset)
            slope = slope - np.exp(-0.5 * offset**2) / np.sqrt(2.0 * np.pi)
        step = np.log(probability / doubt) * probability / slope
        offset = offset - step
        if (np.abs(step) <= 1e-15 * np.maximum(1.0, np.abs(offset))).all():
            break
    return offset


def solve_factor(radius: Array, weight: Array, n: Array, doubt: Array, start: Array) -> Array:
    """Solve Σ weight · P(χ²_ν < ν radius²/c²) = doubt for c by Newton's method on log against log.

    There the curve is concave, so from a start above the root every step stays above it.
    """
    half = (n[:, None] - 1.0) / 2.0
    scale = special.gammaln(half)
    log_factor = np.log(start)
    for _ in range(NEWTON_STEPS):
        x = half * (radius / np.exp(log_factor)[:, None]) ** 2
        held_short = (weight * special.gammainc(half, x)).sum(axis=1)
        # 2 x times the density of x, the slope of the lower tail in log c
        with np.errstate(divide="ignore"):
            slope = (weight * 2.0 * np.exp(half * np.log(x) - x - scale)).sum(axis=1)
        step = np.log(held_short / doubt) * held_short / slope
        log_factor = log_factor + step
        if (np.abs(step) <= 1e-15).all():
            break
    return np.exp(log_factor)


def least_spread(n: Array, doubt: Array) -> Array:
    """Return the SD, in units of the population's, that a sample's falls below with probability `doubt`."""
    half = (n - 1.0) / 2.0
    return np.sqrt(special.gammaincinv(half, doubt) / half)


def normal_nodes(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return Gauss–Legendre nodes between the bounds, one row each, and weights with the normal density."""
    node, weight = _legendre()
    middle, half = (upper + lower)[:, None] / 2.0, (upper - lower)[:, None] / 2.0
    z = middle + half * node
    return z, half * weight * np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)


@cache
def _legendre() -> tuple[Array, Array]:
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    return node, weight
