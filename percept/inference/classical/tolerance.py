"""How many standard deviations hold a stated share of a normal population, with stated confidence.

The two-sided factor c solves, with ν = n − 1 and Φ(x + r) − Φ(x − r) = P defining r(x),

    ∫₀^∞ P(χ²_ν < ν r(x)²/c²) · 2 √(n/2π) exp(−n x²/2) dx = 1 − γ.

The left side is the chance that the interval holds too little. Through the lower tail of χ² it is a
sum of positive terms as small as 1 − γ itself, so nothing cancels however close γ is to one. P
enters through its tail 1 − P likewise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from percept.inference.classical.moments import fitted, plain, subject_counts, tails
from percept.inference.record import FloatOrArray

__all__ = ["factor_of_tails", "tolerance_factor"]

#: Nodes of the integral: they keep 13 digits from n = 2 to 1e6.
_NODES = 200
#: What lies beyond the last node, of 1 − γ.
_NEGLIGIBLE = 1e-17
#: Requests kept: environments, families and studies ask for the same few.
_REMEMBERED = 4096
#: Most steps of Newton's method, which needs some ten, and its relative accuracy.
_NEWTON_STEPS = 60
_ACCURACY = 1e-15

_legendre = cache(np.polynomial.legendre.leggauss)


def tolerance_factor(
    n: ArrayLike,
    share: ArrayLike,
    confidence: ArrayLike,
) -> FloatOrArray:
    """Work out the exact factor of a normal tolerance interval.

    Mean ± factor·SD holds at least `share` of the population with `confidence`.

    Parameters
    ----------
    n : int or array_like of int
        Subjects, at least 2.
    share : float or array_like
        Share P of the population; 0 to 1, exclusive.
    confidence : float or array_like
        Confidence γ; 0 to 1, exclusive.

    Returns
    -------
    float or ndarray
        Broadcast shape; a float where every argument is a single number.

    Raises
    ------
    UsageError
        A share or confidence outside (0, 1), an n that is not whole, shapes that do not fit.
    RefusalError
        Fewer than 2 subjects.

    References
    ----------
    ISO 16269-6:2014; Krishnamoorthy and Mathew, Statistical Tolerance Regions, sections 2.2 and
    2.3.
    """
    beta = tails(share, "share")
    alpha = tails(confidence, "confidence")
    return factor_of_tails(subject_counts(n), beta, alpha)


def factor_of_tails(n: ArrayLike, beta: ArrayLike, alpha: ArrayLike) -> FloatOrArray:
    """Factor from the tails beta = 1 − P and alpha = 1 − γ, which broadcast with n."""
    arrays = [np.asarray(argument) for argument in (n, beta, alpha)]
    factors = np.vectorize(_factor, otypes=[float])
    return plain(factors(*fitted("n, share and confidence", *arrays)))


@lru_cache(_REMEMBERED)
def _factor(
    n: float,
    beta: float,
    alpha: float,
) -> float:
    """Factor for n subjects."""
    half_df = (n - 1.0) / 2.0
    root_n = math.sqrt(n)
    node, weight = _legendre(_NODES)
    half_edge = -special.ndtri(alpha * _NEGLIGIBLE) / 2.0
    z = half_edge * (1.0 + node)
    density = np.sqrt(2.0 / np.pi) * np.exp(-0.5 * z**2)
    weight = half_edge * weight * density
    radius = _content_radius(z / root_n, beta)
    log_gamma = special.gammaln(half_df)

    def miss_probability(log_factor: float) -> tuple[float, float]:
        x = half_df * (radius * math.exp(-log_factor)) ** 2
        with np.errstate(under="ignore"):
            density = np.exp(half_df * np.log(x) - x - log_gamma)  # times x
        probability = weight @ special.gammainc(half_df, x)
        return float(probability), -2.0 * float(weight @ density)

    # Enough: less is held only if the mean is farther off than alpha/4 a side, or the SD below its
    # alpha/2.
    farthest_mean = -special.ndtri(alpha / 4.0) / root_n
    least_sd = math.sqrt(special.gammaincinv(half_df, alpha / 2.0) / half_df)
    start = math.log(_content_radius(farthest_mean, beta) / least_sd)
    return math.exp(_newton(miss_probability, alpha, start))


def _content_radius(x: FloatOrArray, beta: float) -> FloatOrArray:
    """Solve Q(r + x) + Q(r − x) = beta for r, Q the upper normal tail."""

    def outside(r: FloatOrArray) -> tuple[FloatOrArray, FloatOrArray]:
        probability = special.ndtr(-(r + x)) + special.ndtr(x - r)
        near = np.exp(-0.5 * (r - x) ** 2)
        far = np.exp(-0.5 * (r + x) ** 2)
        return probability, -(far + near) / math.sqrt(2.0 * math.pi)

    start = x - special.ndtri(beta / 2.0)  # exact at x = 0, too large elsewhere
    return _newton(outside, beta, start)


def _newton(
    probability: Callable[..., tuple[FloatOrArray, FloatOrArray]],
    target: float,
    start: FloatOrArray,
) -> FloatOrArray:
    """Solve log probability = log target from above.

    The logarithms are concave and fall, so no step passes the root. `scipy.optimize` takes brackets
    that rounding spoils at large n, several times the time, and 0.3 s to import.
    """
    x = start
    for _ in range(_NEWTON_STEPS):
        value, slope = probability(x)
        step = np.log(value / target) * value / slope
        x = x - step
        rounding = _ACCURACY * np.maximum(1.0, np.abs(x))
        if np.all(np.abs(step) <= rounding):
            break
    return x
