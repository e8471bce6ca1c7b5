"""A mean against limits, and two conditions or groups: difference of means, and ratio of SDs.

Two one-sided t-tests reject both "at or below the lower limit" and "at or above the upper one" at
size alpha if the interval of level 1 - 2 alpha lies inside (Schuirmann 1987). A mean at a limit
passes in at most alpha of studies. A mean is shown to lie beyond either limit if the interval of
level 1 - alpha lies outside: two chances to err share alpha, however narrow the limits are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.classical.moments import Moments, mean_and_sd, plain, tail_of
from percept.inference.classical.variability import f_limits
from percept.inference.record import FloatOrArray, Interval, Kind

__all__ = [
    "Tost",
    "TwoSamples",
    "group_contrast",
    "group_spread_ratio",
    "paired_contrast",
    "spread_ratio",
    "tost",
]

Array = NDArray[np.float64]
#: SDs of standardised values, below which the values of two conditions are multiples of one
#: another.
_PROPORTION = 1e-12


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


@dataclass(frozen=True)
class TwoSamples:
    """Mean of a second sample less that of a first one, or its SD over that of the first one."""

    estimate: float
    lower: float
    upper: float
    p_value: float  # Of equal means, or SDs; two-sided
    n: int  # Subjects


def group_contrast(first: Moments, second: Moments, *, level: float) -> TwoSamples:
    """Welch's interval of the difference of the means of two groups with SDs of their own.

    Parameters
    ----------
    first, second : Moments
        Of subjects' values.
    level : float
        Confidence.

    Returns
    -------
    TwoSamples
    """
    variance_first = float(first.sd) ** 2 / float(first.n)
    variance_second = float(second.sd) ** 2 / float(second.n)
    variance = variance_first + variance_second
    weighed = variance_first**2 / (float(first.n) - 1)
    weighed += variance_second**2 / (float(second.n) - 1)
    freedom = variance**2 / weighed
    centre = float(second.mean) - float(first.mean)
    scale = np.sqrt(variance)
    half = -float(special.stdtrit(freedom, tail_of(level) / 2.0)) * scale
    p_value = 2.0 * float(special.stdtr(freedom, -abs(centre) / scale))
    n = int(first.n + second.n)
    return TwoSamples(centre, centre - half, centre + half, p_value, n)


def group_spread_ratio(first: Moments, second: Moments, *, level: float) -> TwoSamples:
    """F interval of the SD of a second group over that of a first one.

    Parameters
    ----------
    first, second : Moments
        Of subjects' values.
    level : float
        Confidence.

    Returns
    -------
    TwoSamples
    """
    df_first = float(first.n) - 1
    df_second = float(second.n) - 1
    ratio = float(second.sd) / float(first.sd)
    high, low = f_limits(df_second, df_first, level)
    below = float(special.fdtr(df_second, df_first, ratio**2))
    above = float(special.fdtr(df_first, df_second, ratio**-2))
    return TwoSamples(
        estimate=ratio,
        lower=ratio / np.sqrt(high),
        upper=ratio / np.sqrt(low),
        p_value=2.0 * min(below, above),
        n=int(first.n + second.n),
    )


def paired_contrast(
    difference: Array,
    kind: Kind,
    *,
    level: float,
    share: float,
    confidence: float,
) -> tuple[Interval, float, float]:
    """Interval of subjects' differences (n,), p-value of the paired t-test, and d_z.

    d_z is the mean difference in SDs of the differences (Cohen 1988).
    """
    moments = Moments.from_values(difference)
    if moments.sd == 0.0:
        raise RefusalError("all differences are equal: with no scatter there is no interval.")
    claim = Claim(level=level, share=share, confidence=confidence)
    interval = interval_of(kind, moments, claim)
    n = len(difference)
    d_z = float(moments.mean) / float(moments.sd)
    return interval, 2.0 * float(special.stdtr(n - 1, -abs(d_z) * np.sqrt(n))), d_z


def spread_ratio(
    first: Array,
    second: Array,
    *,
    level: float,
) -> TwoSamples:
    """Ratio of SDs of pairs (n,), by Pitman and Morgan.

    Sum and difference of two variables are uncorrelated where their variances are equal. The
    interval holds the ratios that the test of this correlation, n - 2 degrees of freedom, does not
    reject.
    """
    n = len(first)
    if n < 3:
        raise RefusalError("the spread of fewer than three pairs cannot be compared.")
    first_mean, first_sd = mean_and_sd(first)
    second_mean, second_sd = mean_and_sd(second)
    if min(first_sd, second_sd) == 0.0:
        raise RefusalError(
            "all values of a condition are equal: with no scatter there is no ratio."
        )
    a = (first - first_mean) / first_sd
    b = (second - second_mean) / second_sd
    # (1 - r)(1 + r) of the SDs of difference and sum: 1 - r² would cancel.
    _, sd_of_difference = mean_and_sd(b - a)
    _, sd_of_sum = mean_and_sd(b + a)
    if min(sd_of_difference, sd_of_sum) < _PROPORTION:
        raise RefusalError(
            "the values of both conditions move in proportion: their ratio has no interval."
        )
    uncorrelated = float(sd_of_difference) * float(sd_of_sum) / 2.0  # sqrt(1 - r²)
    ratio = float(second_sd / first_sd)
    df = n - 2
    t_limit = -float(special.stdtrit(df, tail_of(level) / 2.0))
    half = uncorrelated * t_limit / np.sqrt(df)
    # The roots of ratio² (k ± sqrt(k² - 1)), k = 1 + 2 half²; the smaller is the reciprocal of the
    # larger.
    width = half + np.hypot(half, 1.0)
    t = (ratio - 1.0 / ratio) * np.sqrt(df) / (2.0 * uncorrelated)
    return TwoSamples(
        estimate=ratio,
        lower=float(ratio / width),
        upper=float(ratio * width),
        p_value=2.0 * float(special.stdtr(df, -abs(t))),
        n=n,
    )
