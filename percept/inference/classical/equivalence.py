"""Whether a mean lies within limits: two one-sided t-tests.

The tests reject both "at or below the lower limit" and "at or above the upper one" at size alpha if
the interval of level 1 - 2 alpha lies inside (Schuirmann 1987). A mean at a limit passes in at most
alpha of studies. A mean is shown to lie beyond either limit if the interval of level 1 - alpha lies
outside: two chances to err share alpha, however narrow the limits are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.classical.moments import Moments, plain
from percept.inference.record import FloatOrArray

__all__ = ["Tost", "tost"]


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
