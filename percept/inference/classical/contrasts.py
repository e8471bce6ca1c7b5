"""Two conditions of the same subjects: the contrast of their means, and of their spreads."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.intervals import interval_of
from percept.inference.classical.moments import Moments, mean_and_sd, tail_of
from percept.inference.record import Interval, Kind

Array = NDArray[np.float64]
#: SDs of standardised values, below which the values of two conditions are multiples of one another.
_PROPORTION = 1e-12


@dataclasses.dataclass(frozen=True)
class SpreadRatio:
    """The SD between subjects in the second condition over that in the first."""

    estimate: float
    lower: float
    upper: float
    p_value: float  # Of equal SDs, two-sided
    n: int  # Subjects


def paired_contrast(
    difference: Array, kind: Kind, *, level: float, share: float, confidence: float
) -> tuple[Interval, float]:
    """Interval of subjects' differences (n,), and the p-value of a mean of zero by the paired t-test."""
    moments = Moments.from_values(difference)
    if moments.sd == 0.0:
        raise RefusalError("all subjects differ alike: with no scatter there is no interval.")
    interval = interval_of(kind, moments, level=level, share=share, confidence=confidence)
    n = len(difference)
    t = abs(float(moments.mean)) / float(moments.sd) * np.sqrt(n)
    return interval, 2.0 * float(special.stdtr(n - 1, -t))


def spread_ratio(first: Array, second: Array, *, level: float) -> SpreadRatio:
    """Ratio of SDs of pairs (n,), by Pitman and Morgan.

    Sum and difference of two variables are uncorrelated where their variances are equal. The interval holds
    the ratios that the test of this correlation, n - 2 degrees of freedom, does not reject.
    """
    n = len(first)
    if n < 3:
        raise RefusalError("the spread of fewer than three pairs cannot be compared.")
    means, sds = zip(*(mean_and_sd(values) for values in (first, second)), strict=True)
    if min(sds) == 0.0:
        raise RefusalError("all subjects adjusted alike: with no scatter there is no ratio.")
    a, b = ((values - mean) / sd for values, mean, sd in zip((first, second), means, sds, strict=True))
    # (1 - r)(1 + r) of the SDs of difference and sum: 1 - r² would cancel.
    apart, together = (float(mean_and_sd(values)[1]) for values in (b - a, b + a))
    if min(apart, together) < _PROPORTION:
        raise RefusalError("the values of both conditions move in proportion: their ratio has no interval.")
    rest = apart * together / 2.0  # sqrt(1 - r²)
    ratio = float(sds[1] / sds[0])
    half = rest * -float(special.stdtrit(n - 2, tail_of(level) / 2.0)) / np.sqrt(n - 2)
    # The roots of ratio² (k ± sqrt(k² - 1)), k = 1 + 2 half²; the smaller is the reciprocal of the larger.
    wide = half + np.hypot(half, 1.0)
    t = (ratio - 1.0 / ratio) * np.sqrt(n - 2) / (2.0 * rest)
    p_value = 2.0 * float(special.stdtr(n - 2, -abs(t)))
    return SpreadRatio(ratio, float(ratio / wide), float(ratio * wide), p_value, n)
