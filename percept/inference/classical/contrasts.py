"""Conditions and groups compared: means, spreads, limits of a mean, and analysis of variance.

Two one-sided t-tests reject both "at or below the lower limit" and "at or above the upper one" at
size alpha if the interval of level 1 - 2 alpha lies inside (Schuirmann 1987). A mean at a limit
passes in at most alpha of studies. A mean is shown to lie beyond either limit if the interval of
level 1 - alpha lies outside: two chances to err share alpha, however narrow the limits are.

In the analysis of variance every effect within subjects is a set of orthonormal contrasts. Each
subject has one value of each contrast, so the effect is a mean of subjects' values, and its error
is their scatter in the groups.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from percept.errors import RefusalError
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.classical.moments import Moments, mean_and_sd, plain, tail_of
from percept.inference.classical.variability import f_limits
from percept.inference.record import FloatOrArray, Interval, Kind

Array = NDArray[np.float64]
#: SDs of standardised values, below which the values of two conditions are multiples of one
#: another.
_PROPORTION = 1e-12
#: Squared scatter over the sum of the squared values, below which it is rounding alone: values are
#: rounded by up to 1.1e-16 of themselves, and so is each of the few sums that they enter.
_NO_SCATTER = 1e-30


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
        Limits in the unit of the moments, in order; one may be infinite.

    Returns
    -------
    Tost
        Of shape (...). At size alpha the mean is within the limits if `p_within` is at most alpha,
        and beyond one of them if `p_beyond` is. `p_beyond` is twice the smaller p-value of the two
        tests against the limits (Bonferroni), or the only one if a limit is infinite.

    Raises
    ------
    RefusalError
        Samples whose values are all equal: their mean has no standard error.
    """
    if np.any(np.asarray(moments.sd) == 0.0):
        raise RefusalError("All values of a sample are equal: no test has a standard error.")
    mean = np.asarray(moments.mean)
    n = np.asarray(moments.n)
    df = n - 1.0
    error = np.asarray(moments.sd) / np.sqrt(n)
    # Distances inside either limit, in standard errors.
    inside = np.stack([mean - lower, upper - mean]) / error
    smaller = special.stdtr(df, inside).min(axis=0)
    # Limits far narrower than the error are passed at either end in alpha of studies each.
    ends = int(np.isfinite(lower)) + int(np.isfinite(upper))
    return Tost(
        p_within=plain(special.stdtr(df, -inside).max(axis=0)),
        p_beyond=plain(np.minimum(ends * smaller, 1.0)),
    )


@dataclass(frozen=True)
class TwoSamples:
    """Second mean less first mean, or second SD over first SD, of two samples."""

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
    n = np.array([first.n, second.n])
    squares = np.array([first.sd, second.sd]) ** 2 / n
    variance = squares.sum()
    freedom = variance**2 / (squares**2 / (n - 1)).sum()
    centre = float(second.mean) - float(first.mean)
    scale = np.sqrt(variance)
    half = -float(special.stdtrit(freedom, tail_of(level) / 2.0)) * scale
    p_value = 2.0 * float(special.stdtr(freedom, -abs(centre) / scale))
    return TwoSamples(centre, centre - half, centre + half, p_value, int(n.sum()))


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


@dataclass(frozen=True)
class Effect:
    """The test of one effect, a main effect or an interaction."""

    factors: tuple[str, ...]  # Whose levels differ: one of a main effect
    f: float
    df: float  # Of the effect, uncorrected
    df_error: float  # Of its error, uncorrected
    p_value: float  # Uncorrected
    epsilon: float  # Greenhouse and Geisser's; 1 with one contrast, and between subjects
    df_corrected: float  # Times `epsilon`, as is that of the error
    df_error_corrected: float
    p_corrected: float
    partial_eta2: float  # Of the sums of squares of the effect and its error
    generalised_eta2: float  # Share of the sums of squares of the effect and of all errors


@dataclass(frozen=True)
class _Squares:
    """Sums of squares of one effect."""

    factors: tuple[str, ...]
    effect: float
    error: float
    df: int
    df_error: int
    epsilon: float


def anova(
    values: Array,
    within: Sequence[str],
    *,
    group: NDArray[np.intp] | None = None,
    between: str = "group",
) -> tuple[Effect, ...]:
    """Test all main effects and interactions of factors within subjects, and of groups.

    Parameters
    ----------
    values : ndarray, shape (n, levels of the first factor, levels of the second, ...)
        Each subject's value in each cell, in any unit; no value is missing.
    within : sequence of str
        Names of the factors within subjects, in the order of the axes.
    group : ndarray of int, shape (n,), optional
        Number of each subject's group, from 0. Groups may differ in size: effects within subjects
        then give all groups the same weight (sums of squares of type III).
    between : str
        Name of the groups' factor.

    Returns
    -------
    tuple of Effect
        Main effects first. With groups, each effect is followed by its interaction with them.

    Raises
    ------
    RefusalError
        A group of fewer than two subjects, a factor of fewer than two levels, or an effect without
        scatter between subjects.

    Notes
    -----
    Epsilon is tr(S)² / (q tr(S²)) with the pooled covariance S of the q contrasts: S. Greenhouse
    and S. Geisser, Psychometrika 24 (1959) 95. Generalised eta squared follows S. Olejnik and
    J. Algina, Psychological Methods 8 (2003) 434, with all factors taken as manipulated.
    """
    if group is None:
        group = np.zeros(len(values), dtype=np.intp)
    sizes = np.bincount(group)
    if sizes.min() < 2:
        raise RefusalError("an analysis of variance needs two subjects in every group.")
    for name, levels in zip(within, values.shape[1:], strict=True):
        if levels < 2:
            raise RefusalError(f"an analysis of variance needs two levels of {name}.")
    # A common offset drops out of every contrast; without it they keep their digits.
    centred = values - values.mean()
    squares: list[_Squares] = []
    error_of_all = 0.0
    # Subjects' means first, which no factor tells apart; then main effects and interactions.
    orders = range(len(within) + 1)
    subsets = (itertools.combinations(range(len(within)), order) for order in orders)
    for axes in itertools.chain.from_iterable(subsets):
        scores = _scores(centred, axes)
        names = tuple(within[axis] for axis in axes)
        error, rows = _squares(scores, group, sizes, names, between)
        error_of_all += error
        squares += rows
    least = _NO_SCATTER * float(np.sum(values**2))
    for row in squares:
        if row.error <= least:
            raise RefusalError(
                f"all subjects have the same effect of {' and '.join(row.factors)}: with no scatter"
                " there is no F."
            )
    return tuple(_tested(row, error_of_all) for row in squares)


def _scores(values: Array, axes: Sequence[int]) -> Array:
    """Subjects' values of the orthonormal contrasts of an effect, (n, q)."""
    scores = values
    for axis in range(values.ndim - 1):
        levels = values.shape[1 + axis]
        rows = np.full((1, levels), levels**-0.5)
        if axis in axes:
            rows = linalg.helmert(levels)
        # The axis that is summed over goes, and the contrasts come last: all axes turn once.
        scores = np.tensordot(scores, rows, axes=(1, 1))
    return scores.reshape(len(values), -1)


def _squares(
    scores: Array,
    group: NDArray[np.intp],
    sizes: NDArray[np.intp],
    names: tuple[str, ...],
    between: str,
) -> tuple[float, list[_Squares]]:
    """Split the squares of an effect: its error, and the effect itself and with groups.

    Without factors, the scores are subjects' means: the only effect is that of the groups.
    """
    contrasts = scores.shape[1]
    groups = len(sizes)
    df_subjects = len(scores) - groups
    sums = np.zeros((groups, contrasts))
    np.add.at(sums, group, scores)
    means = sums / sizes[:, None]
    deviations = scores - means[group]
    # The covariance times its degrees of freedom, which cancel. With more contrasts than subjects
    # the smaller product serves: its trace, and that of its square, are the same.
    few = deviations.T if contrasts <= len(scores) else deviations
    covariance = few @ few.T
    error = float(np.trace(covariance))
    epsilon = 1.0
    if contrasts > 1 and error > 0.0:
        epsilon = error**2 / (contrasts * float(np.sum(covariance**2)))
    df_error = contrasts * df_subjects
    rows = []
    if names:
        # The plain mean of the groups' means; of one group it is the mean of all subjects.
        mean = means.mean(axis=0)
        weight = groups**2 / float(np.sum(1.0 / sizes))
        effect = weight * float(mean @ mean)
        rows.append(_Squares(names, effect, error, contrasts, df_error, epsilon))
    if groups > 1:
        apart = means - scores.mean(axis=0)
        effect = float(sizes @ np.sum(apart**2, axis=1))
        df = contrasts * (groups - 1)
        rows.append(_Squares((between, *names), effect, error, df, df_error, epsilon))
    return error, rows


def _tested(row: _Squares, error_of_all: float) -> Effect:
    """Test an effect by its sums of squares."""
    f = (row.effect / row.df) / (row.error / row.df_error)
    df_corrected = row.epsilon * row.df
    df_error_corrected = row.epsilon * row.df_error
    return Effect(
        factors=row.factors,
        f=f,
        df=float(row.df),
        df_error=float(row.df_error),
        p_value=float(special.fdtrc(row.df, row.df_error, f)),
        epsilon=row.epsilon,
        df_corrected=df_corrected,
        df_error_corrected=df_error_corrected,
        p_corrected=float(special.fdtrc(df_corrected, df_error_corrected, f)),
        partial_eta2=row.effect / (row.effect + row.error),
        generalised_eta2=row.effect / (row.effect + error_of_all),
    )
