"""How many subjects the next study needs.

Each plan finds the smallest n whose interval is, with a stated probability (the assurance), no
wider than wanted. The width of a classical interval is a known multiple of the SD, and the SD of a
normal sample is a χ variable: the assurance is a χ² probability, exact, and no simulation is
needed. A plan of a contrast finds the smallest n that shows a difference with a stated power.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.classical.fiducial import noncentral_t_tail, tost_power
from percept.inference.classical.intervals import factor_of_tails
from percept.inference.classical.moments import check_option, tail_of
from percept.inference.record import Family, percent

__all__ = [
    "Plan",
    "pilot_sds",
    "plan_contrast",
    "plan_equivalent",
    "plan_mean",
    "plan_share",
    "plan_user",
]

_MOST_SUBJECTS = 10_000_000
#: SDs over the largest value, below which all differences are equal but for rounding.
_NO_SCATTER = 1e-12
#: Confidence that a pilot's true SD is below the limit that is planned for too: R. H. Browne,
#: Statistics in Medicine 14 (1995) 1933, shows that the pilot's own SD leaves half of all studies
#: short of power.
_SURE_OF_PILOT = 0.8


@dataclass(frozen=True, kw_only=True)
class Plan(NotebookRecord):
    """A number of subjects, and what it promises."""

    n: int  # Subjects; in each group where there are two
    assurance: float  # Probability that a study of `n` subjects reaches its aim
    #: Average over studies of the width (half-width of a mean or contrast), as the aim is given;
    #: None for an equivalence.
    expected: float | None
    covers: str  # What the plan promises, in plain words


def plan_mean(
    half_width: float,
    *,
    sd: float,
    level: float = 0.99,
    assurance: float = 0.8,
    family: Family = "normal",
) -> Plan:
    """Find the n for which the t-interval of the mean has a wanted half-width."""
    _check(family, half_width=half_width, sd=sd)
    half_tail = tail_of(level) / 2.0
    log = family == "lognormal"
    n, reached, expected = _smallest(
        lambda n: -special.stdtrit(n - 1.0, half_tail) / np.sqrt(n),
        float(np.log1p(half_width)) if log else half_width,
        float(np.sqrt(np.log1p(sd**2))) if log else sd,
        assurance,
    )
    width = f"at most ± {half_width:.4g} wide"
    if log:
        expected = float(np.expm1(expected))
        width = f"within a factor {1.0 + half_width:.4g} of the estimate either way"
    what = f"the {percent(level)} interval of the average user is {width}"
    return Plan(n=n, assurance=reached, expected=expected, covers=_promise(n, what, reached))


def plan_user(ratio: float, *, level: float = 0.99, assurance: float = 0.8) -> Plan:
    """Find the n for which the prediction interval is close to the population's own."""
    half_tail = tail_of(level) / 2.0
    return _plan_ratio(
        lambda n: -special.stdtrit(n - 1.0, half_tail) * np.sqrt(1.0 + 1.0 / n),
        ratio,
        half_tail,
        assurance,
        f"the {percent(level)} interval of the next user",
    )


def plan_share(
    ratio: float, *, share: float = 0.99, confidence: float = 0.95, assurance: float = 0.8
) -> Plan:
    """Find the n for which the tolerance interval is close to the population's own."""
    beta = tail_of(share, "share")
    alpha = tail_of(confidence, "confidence")
    return _plan_ratio(
        lambda n: factor_of_tails(n, beta, alpha),
        ratio,
        beta / 2.0,
        assurance,
        f"the interval of {percent(share)} of all users, with {percent(confidence)} confidence,",
    )


def plan_contrast(
    difference: float,
    *,
    sd: float,
    other_sd: float | None = None,
    level: float = 0.99,
    assurance: float = 0.8,
    family: Family = "normal",
) -> Plan:
    """Find the n for which a paired t-interval, or Welch's of two groups, leaves zero out.

    Parameters
    ----------
    difference : float
        True difference of the means, in the unit of `sd`; with the lognormal family a fraction, 0.1
        for a ratio of 1.1.
    sd : float
        SD between subjects of their own differences; of two groups, that of the first. With the
        lognormal family a coefficient of variation.
    other_sd : float, optional
        SD of the second group. Without it each subject has both levels.
    level : float
        Confidence of the interval.
    assurance : float
        Probability of showing the difference: the power.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    Plan

    Raises
    ------
    UsageError
        A difference or SD that is not positive, or a level or assurance outside 0 to 1.
    RefusalError
        Ten million subjects would be too few.

    Notes
    -----
    The power is that of the noncentral t: exact for pairs, and for groups with equal SDs. For other
    groups Satterthwaite's degrees of freedom replace those that each study estimates.
    """
    _check(family, difference=difference, sd=sd, other_sd=sd if other_sd is None else other_sd)
    half_tail = tail_of(level) / 2.0
    log = family == "lognormal"
    variances = [
        np.log1p(value**2) if log else value**2 for value in (sd, other_sd) if value is not None
    ]
    variance = float(sum(variances))
    # Satterthwaite's degrees of freedom over n - 1: 1 of pairs, 2 of groups with equal SDs.
    freedom = variance**2 / float(sum(value**2 for value in variances))
    size = float(np.log1p(difference)) if log else difference

    def reached(n: int) -> float:
        df = freedom * (n - 1.0)
        limit = -float(special.stdtrit(df, half_tail))
        shift = size * np.sqrt(n / variance)
        power = noncentral_t_tail(limit, df, np.array([shift, -shift])).sum()
        # Rounding may pass one.
        return min(float(power), 1.0)

    n = _fewest(reached, assurance)
    df = freedom * (n - 1.0)
    half_width = -special.stdtrit(df, half_tail) * np.sqrt(variance / n) * _mean_sd(df)
    expected = float(half_width)
    shown = f"{difference:.4g}"
    width = f"± {expected:.3g} wide"
    if log:
        expected = float(np.expm1(half_width))
        shown = percent(difference)
        width = f"within a factor {1.0 + expected:.3g} of the estimate either way"
    groups = " in each group" if other_sd is not None else ""
    return Plan(
        n=n,
        assurance=reached(n),
        expected=expected,
        covers=f"With {n} subjects{groups}, a difference of {shown} is shown by the"
        f" {percent(level)} interval in {percent(reached(n), digits=4)} of studies. The interval"
        f" is {width} on average.",
    )


def plan_equivalent(
    jnd: float,
    *,
    sd: float,
    bias: float = 0.0,
    decision: float = 0.95,
    assurance: float = 0.8,
    family: Family = "normal",
) -> Plan:
    """Find the n for which two one-sided t-tests show a bias to be smaller than one JND.

    Parameters
    ----------
    jnd : float
        One JND, in the unit of `sd`; with the lognormal family a fraction of the reference.
    sd : float
        SD between subjects; with the lognormal family a coefficient of variation.
    bias : float
        True bias, in the terms of `jnd`, smaller than it on either side.
    decision : float
        Confidence that decides; each test has size 1 - decision.
    assurance : float
        Probability of showing it: the power.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    Plan
        Its power is exact, by `percept.inference.classical.fiducial.tost_power`.

    Raises
    ------
    UsageError
        A JND or SD that is not positive, a bias of one JND or more, a decision outside 0.5 to 1 or
        an assurance outside 0 to 1.
    RefusalError
        Ten million subjects would be too few.
    """
    _check(family, jnd=jnd, sd=sd)
    if not abs(bias) < jnd:
        hint = "No number of subjects shows a larger bias to be smaller."
        raise UsageError("bias must be smaller than one JND.", value=bias, hint=hint)
    if not 0.5 < decision < 1.0:
        raise UsageError("decision must lie strictly between 0.5 and 1.", value=decision)
    to_lower = jnd + bias
    to_upper = jnd - bias
    shown = f"{bias:.4g}", f"{jnd:.4g}"
    if family == "lognormal":
        sd = float(np.sqrt(np.log1p(sd**2)))
        centre = np.log1p(bias)
        to_upper = float(np.log1p(jnd) - centre)
        # No positive value lies a whole reference below it.
        to_lower = float(centre - np.log1p(-jnd)) if jnd < 1.0 else np.inf
        shown = percent(bias), percent(jnd)

    def reached(n: int) -> float:
        root_n = np.sqrt(n) / sd
        return tost_power(to_lower * root_n, to_upper * root_n, n - 1.0, size=1.0 - decision)

    n = _fewest(reached, assurance)
    what = (
        f"a true bias of {shown[0]} is shown to be smaller than one JND, {shown[1]}, with"
        f" {percent(decision)} confidence"
    )
    covers = _promise(n, what, reached(n))
    return Plan(n=n, assurance=reached(n), expected=None, covers=covers)


def pilot_sds(
    first: ArrayLike, second: ArrayLike, *, within: bool, family: Family = "normal"
) -> tuple[list[float], list[float]] | None:
    """Return the SDs that plan the contrast of two levels by a pilot study.

    Parameters
    ----------
    first, second : array_like, shape (n,)
        What each subject set at either level, in one order of the subjects; NaN where nothing.
    within : bool
        Whether each subject has both levels.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    tuple of two lists, or None
        The pilot's SD of the differences, or of both groups, as `plan_contrast` takes them, and
        their upper 80 % limits. None of levels with fewer than two subjects, or without scatter.
    """
    values = np.array([first, second], dtype=float)
    if family == "lognormal":
        values = np.log(values)
    samples = [values[1] - values[0]] if within else list(values)
    samples = [sample[np.isfinite(sample)] for sample in samples]
    counts = np.array([len(sample) for sample in samples])
    if counts.min() < 2:
        return None
    sds = np.array([sample.std(ddof=1) for sample in samples])
    if sds.min() <= _NO_SCATTER * np.nanmax(np.abs(values)):
        return None
    df = counts - 1.0
    upper = sds * np.sqrt(df / special.chdtri(df, _SURE_OF_PILOT))
    if family == "lognormal":
        sds = np.sqrt(np.expm1(sds**2))
        upper = np.sqrt(np.expm1(upper**2))
    return sds.tolist(), upper.tolist()


def _check(family: Family, **sizes: float) -> None:
    """Refuse an unknown family, and sizes that are not positive."""
    for name, value in sizes.items():
        if not (np.isfinite(value) and value > 0.0):
            raise UsageError(f"{name} must be a positive number.", value=value)
    check_option("family", family, ("normal", "lognormal"))


def _promise(n: int, what: str, assurance: float) -> str:
    """Say in a sentence what a plan promises."""
    return f"With {n} subjects, {what} in {percent(assurance, digits=4)} of studies."


def _plan_ratio(
    factor: Callable[[int], Any], ratio: float, half_tail: float, assurance: float, interval: str
) -> Plan:
    """Plan for a width over that of a known population, whose SD is taken as the unit."""
    if not (np.isfinite(ratio) and ratio > 1.0):
        raise UsageError(
            "ratio must be above 1, to which it tends with ever more subjects.", value=ratio
        )
    sigma = -1.0 / float(special.ndtri(half_tail))
    n, reached, expected = _smallest(factor, ratio, sigma, assurance)
    what = f"{interval} is at most {ratio:.4g} times as wide as that of a known population"
    return Plan(n=n, assurance=reached, expected=expected, covers=_promise(n, what, reached))


def _smallest(
    factor: Callable[[int], Any], wanted: float, sigma: float, assurance: float
) -> tuple[int, float, float]:
    """Return the smallest n with P(factor·SD ≤ wanted) ≥ assurance, both, and E factor·SD."""

    def reached(n: int) -> float:
        half = (n - 1.0) / 2.0
        return float(special.gammainc(half, half * (wanted / sigma / factor(n)) ** 2))

    n = _fewest(reached, assurance)
    return n, reached(n), float(factor(n)) * _mean_sd(n - 1.0) * sigma


def _fewest(reached: Callable[[int], float], wanted: float) -> int:
    """Return the smallest n that reaches a probability, which grows with n."""
    if not 0.0 < wanted < 1.0:
        hint = "80 percent is written 0.8."
        raise UsageError("assurance must lie strictly between 0 and 1.", value=wanted, hint=hint)
    n = 2 + bisect.bisect_left(range(2, _MOST_SUBJECTS + 1), wanted, key=reached)
    if n > _MOST_SUBJECTS:
        hint = "Ask for less."
        raise RefusalError(f"More than {_MOST_SUBJECTS} subjects would be needed.", hint=hint)
    return n


def _mean_sd(df: float) -> float:
    """Return the average SD of samples of unit variance."""
    half = df / 2.0
    return float(special.poch(half, 0.5) / np.sqrt(half))
