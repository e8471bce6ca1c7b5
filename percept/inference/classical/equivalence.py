"""Whether a mean lies within limits: two one-sided t-tests, and their power.

The tests reject both "at or below the lower limit" and "at or above the upper one" at size alpha if
the interval of level 1 - 2 alpha lies inside (Schuirmann 1987). A mean at a limit passes in at most
alpha of studies. A mean is shown to lie beyond either limit if the interval of level 1 - alpha lies
outside: two chances to err share alpha, however narrow the limits are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.classical.moments import Moments, plain
from percept.inference.record import FloatOrArray

__all__ = ["Tost", "tost", "tost_power"]

#: Probability of the sample SD beyond either end of the integral over it.
_NEGLIGIBLE = 1e-16
#: Nodes of the integral: the integrand is smooth, and 12 digits are reached with 100.
_NODES = 200


@dataclass(frozen=True)
class Tost:
    """Two one-sided tests of a mean."""

    p_within: FloatOrArray  # Of the mean lying outside: small where it lies between the limits
    p_beyond: FloatOrArray  # Of the mean lying inside: small where it lies beyond a limit


def tost(moments: Moments, lower: float, upper: float) -> Tost:
    """Test a mean against two limits.

    Parameters
    ----------
    moments : Moments
        Mean, SD and number of samples, SDs above zero; shape (...).
    lower, upper : float
        Limits in the unit of the moments; either may be infinite.

    Returns
    -------
    Tost
        Of shape (...). At size alpha the mean is within the limits if `p_within` is at most alpha,
        and beyond one of them if `p_beyond` is. `p_beyond` is twice the smaller p-value of the two
        tests against the limits (Bonferroni), or the only one if a limit is infinite.

    Raises
    ------
    UsageError
        Limits that are not in order.
    RefusalError
        Samples whose values are all equal: they tell no error of the mean.
    """
    if not lower < upper:
        raise UsageError("the lower limit must be below the upper one.", value=(lower, upper))
    if np.any(np.asarray(moments.sd) == 0.0):
        raise RefusalError("All values of a sample are equal: no test has a standard error.")
    mean = np.asarray(moments.mean)
    n = np.asarray(moments.n)
    df = n - 1.0
    error = np.asarray(moments.sd) / np.sqrt(n)
    above_lower = special.stdtr(df, (lower - mean) / error)
    below_upper = special.stdtr(df, (mean - upper) / error)
    below_lower = special.stdtr(df, (mean - lower) / error)
    above_upper = special.stdtr(df, (upper - mean) / error)
    smaller = np.minimum(below_lower, above_upper)
    # Limits far narrower than the error are passed at either end in alpha of studies each.
    ends = int(np.isfinite(lower)) + int(np.isfinite(upper))
    return Tost(
        p_within=plain(np.maximum(above_lower, below_upper)),
        p_beyond=plain(np.minimum(ends * smaller, 1.0) if ends else np.ones_like(smaller)),
    )


def tost_power(to_lower: float, to_upper: float, df: float, *, size: float) -> float:
    """Probability that both tests reject, exact for a normal sample.

    Given w, the sample's SD over the true one, both reject if the sample mean lies between the
    limits by t·w standard errors; the integral over the law of w is Owen's Q.

    Parameters
    ----------
    to_lower, to_upper : float
        Distance of the true mean from either limit in true standard errors, positive inside.
    df : float
        Degrees of freedom of the SD.
    size : float
        Size alpha of each test; above 0 and at most 0.5.

    Returns
    -------
    float
        0 to 1.

    Raises
    ------
    UsageError
        A size out of its range.
    """
    if not 0.0 < size <= 0.5:
        raise UsageError("the size must be above 0 and at most 0.5.", value=size)
    t = -float(special.stdtrit(df, size))
    lowest = math.sqrt(special.chdtri(df, 1.0 - _NEGLIGIBLE) / df)
    highest = math.sqrt(special.chdtri(df, _NEGLIGIBLE) / df)
    # With a larger SD the limits leave no room for a mean.
    if t > 0.0:
        highest = min(highest, (to_lower + to_upper) / (2.0 * t))
    if highest <= lowest:
        return 0.0
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half = 0.5 * (highest - lowest)
    w = lowest + half * (1.0 + nodes)
    between = special.ndtr(to_upper - t * w) - special.ndtr(t * w - to_lower)
    log_constant = 0.5 * df * math.log(0.5 * df) - math.lgamma(0.5 * df) + math.log(2.0)
    density = np.exp(log_constant + special.xlogy(df - 1.0, w) - 0.5 * df * w**2)
    power = half * (weights * between * density).sum()
    # Rounding may pass one.
    return min(float(power), 1.0)
