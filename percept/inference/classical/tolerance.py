"""How many standard deviations hold a stated share of a normal population, with stated confidence.

Two-sided, the factor c solves, with ν = n − 1 and Φ(x + r) − Φ(x − r) = P defining r(x),

    ∫₀^∞ P(χ²_ν < ν r(x)²/c²) · 2 √(n/2π) exp(−n x²/2) dx = 1 − γ.

The left side is the chance that the interval holds too little. Through the lower tail of χ² it is a
sum of positive terms as small as 1 − γ itself, so nothing cancels however close γ is to one. P
enters through its tail 1 − P likewise. One-sided, the factor is a quantile of the noncentral t.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from percept.inference.classical.moments import check_option, fitted, plain, subject_counts, tails
from percept.inference.record import FloatOrArray

_NODES = 200  # keeps 13 digits from n = 2 to 1e6
_NEGLIGIBLE = 1e-17  # of 1 − γ: what lies beyond the last node
_REMEMBERED = 4096  # requests: environments, families and studies ask for the same few
_NEWTON_STEPS = 60

_legendre = cache(np.polynomial.legendre.leggauss)


def tolerance_factor(
    n: ArrayLike, share: ArrayLike, confidence: ArrayLike, *, sided: Literal["two", "one"] = "two"
) -> FloatOrArray:
    """Work out the exact factor of a normal tolerance interval.

    Mean ± factor·SD holds at least `share` of the population with `confidence`; one-sided, so does
    everything below mean + factor·SD (or above mean − factor·SD).

    Parameters
    ----------
    n : int or array_like of int
        Subjects, at least 2.
    share : float or array_like
        Share P of the population; 0 to 1, exclusive.
    confidence : float or array_like
        Confidence γ; 0 to 1, exclusive.
    sided : {"two", "one"}
        Whether both limits are set together or only one.

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
    check_option("sided", sided, ("two", "one"))
    beta, alpha = tails(share, "share"), tails(confidence, "confidence")
    return factor_of_tails(subject_counts(n), beta, alpha, sided=sided)


def factor_of_tails(
    n: ArrayLike, beta: ArrayLike, alpha: ArrayLike, *, sided: str = "two"
) -> FloatOrArray:
    """Factor that leaves out beta = 1 − P of the population and misses it with probability alpha = 1 − γ."""
    arrays = fitted("n, share and confidence", *(np.asarray(given) for given in (n, beta, alpha)))
    if sided == "one":
        n, beta, alpha = arrays
        # The mirrored distribution has the small probability in its lower tail, and keeps its
        # digits.
        return plain(
            -special.nctdtrit(n - 1.0, np.sqrt(n) * special.ndtri(beta), alpha) / np.sqrt(n)
        )
    return plain(np.vectorize(_two_sided, otypes=[float])(*arrays))


@lru_cache(_REMEMBERED)
def _two_sided(n: float, beta: float, alpha: float) -> float:
    half = (n - 1.0) / 2.0
    node, weight = _legendre(_NODES)
    edge = -special.ndtri(alpha * _NEGLIGIBLE) / 2.0
    z = edge * (1.0 + node)
    weight = edge * weight * np.sqrt(2.0 / np.pi) * np.exp(-0.5 * z**2)
    radius = _content_radius(z / math.sqrt(n), beta)
    log_gamma = special.gammaln(half)

    def miss_probability(log_factor: float) -> tuple[float, float]:
        x = half * (radius * math.exp(-log_factor)) ** 2
        with np.errstate(under="ignore"):
            density = np.exp(half * np.log(x) - x - log_gamma)  # times x
        return float(weight @ special.gammainc(half, x)), -2.0 * float(weight @ density)

    # Enough: less is held only if the mean is farther off than alpha/4 a side, or the SD below its
    # alpha/2.
    farthest = _content_radius(-special.ndtri(alpha / 4.0) / math.sqrt(n), beta)
    least_sd = math.sqrt(special.gammaincinv(half, alpha / 2.0) / half)
    return math.exp(_newton(miss_probability, alpha, math.log(farthest / least_sd)))


def _content_radius(x: FloatOrArray, beta: float) -> FloatOrArray:
    """Solve Q(r + x) + Q(r − x) = beta for r, Q the upper normal tail."""

    def held_out(r: FloatOrArray) -> tuple[FloatOrArray, FloatOrArray]:
        density = np.exp(-0.5 * (r + x) ** 2) + np.exp(-0.5 * (r - x) ** 2)
        return special.ndtr(-(r + x)) + special.ndtr(x - r), -density / math.sqrt(2.0 * math.pi)

    return _newton(
        held_out, beta, x - special.ndtri(beta / 2.0)
    )  # exact at x = 0, too large elsewhere


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
        if np.all(np.abs(step) <= 1e-15 * np.maximum(1.0, np.abs(x))):
            break
    return x
