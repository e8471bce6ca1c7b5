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
from percept.inference.record import Family, Kind, percent

__all__ = [
    "ContrastPlan",
    "EquivalencePlan",
    "PilotPlan",
    "Plan",
    "plan_contrast",
    "plan_equivalent",
    "plan_from_pilot",
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
    """The number of subjects for a wanted width, and how sure it is."""

    kind: Kind  # What the planned interval covers
    n: int  # Subjects
    assurance: float  # Probability that a study of `n` subjects reaches the width
    expected: float  # Average over studies of the width, in the terms of `wanted`
    #: Kind "mean": half-width, in the unit of the SD ("lognormal": as a fraction); others: width
    #: over that of a known population.
    wanted: float
    level: float  # Level of the interval
    share: float | None = None  # Kind ``"share"``: share of users held
    family: Family = "normal"  # Distribution between users

    @property
    def covers(self) -> str:
        """One plain sentence saying what the plan promises."""
        level = percent(self.level)
        if self.kind == "share":
            interval = (
                f"the interval of {percent(self.share or 0.0)} of all users, with {level}"
                " confidence,"
            )
        else:
            interval = (
                f"the {level} interval of the {'average' if self.kind == 'mean' else 'next'} user"
            )
        if self.kind != "mean":
            width = f"at most {self.wanted:.4g} times as wide as that of a known population"
        elif self.family == "lognormal":
            width = f"within a factor {1.0 + self.wanted:.4g} of the estimate either way"
        else:
            width = f"at most ± {self.wanted:.4g} wide"
        sure = percent(self.assurance, digits=4)
        return f"With {self.n} subjects, {interval} is {width} in {sure} of studies."


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
    found = _smallest(
        lambda n: -special.stdtrit(n - 1.0, half_tail) / np.sqrt(n),
        float(np.log1p(half_width)) if log else half_width,
        float(np.sqrt(np.log1p(sd**2))) if log else sd,
        assurance,
    )
    if log:
        found["expected"] = float(np.expm1(found["expected"]))
    return Plan(kind="mean", wanted=half_width, level=level, family=family, **found)


def plan_user(ratio: float, *, level: float = 0.99, assurance: float = 0.8) -> Plan:
    """Find the n for which the prediction interval is close to the population's own."""
    half_tail = tail_of(level) / 2.0
    found = _smallest_ratio(
        lambda n: -special.stdtrit(n - 1.0, half_tail) * np.sqrt(1.0 + 1.0 / n),
        ratio,
        half_tail,
        assurance,
    )
    return Plan(kind="user", wanted=ratio, level=level, **found)


def plan_share(
    ratio: float, *, share: float = 0.99, confidence: float = 0.95, assurance: float = 0.8
) -> Plan:
    """Find the n for which the tolerance interval is close to the population's own."""
    beta = tail_of(share, "share")
    alpha = tail_of(confidence, "confidence")
    found = _smallest_ratio(lambda n: factor_of_tails(n, beta, alpha), ratio, beta / 2.0, assurance)
    return Plan(kind="share", wanted=ratio, level=confidence, share=share, **found)


@dataclass(frozen=True, kw_only=True)
class ContrastPlan(NotebookRecord):
    """The number of subjects that shows a difference of two levels or groups."""

    n: int  # Subjects, in each group where there are two
    power: float  # Probability that the interval of a study of `n` subjects leaves zero out
    difference: float  # True one, in the unit of the SD ("lognormal": as a fraction)
    expected: float  # Average half-width of the interval, in the terms of `difference`
    level: float  # Of the interval
    family: Family
    groups: bool  # Whether different subjects are compared

    @property
    def covers(self) -> str:
        """One plain sentence saying what the plan promises."""
        subjects = f"With {self.n} subjects"
        if self.groups:
            subjects += " in each group"
        size = f"a difference of {self.difference:.4g}"
        width = f"± {self.expected:.3g} wide"
        if self.family == "lognormal":
            size = f"a difference of {percent(self.difference)}"
            width = f"within a factor {1.0 + self.expected:.3g} of the estimate either way"
        sure = percent(self.power, digits=4)
        return (
            f"{subjects}, {size} is shown by the {percent(self.level)} interval in {sure} of"
            f" studies. The interval is {width} on average."
        )


@dataclass(frozen=True, kw_only=True)
class PilotPlan:
    """Plans of the next study by the SDs of a pilot, for two levels of a factor."""

    subjects: int  # Of the pilot
    plan: ContrastPlan  # If the true SDs are the pilot's
    cautious: ContrastPlan  # If they are at their upper limits


def plan_contrast(
    difference: float,
    *,
    sd: float,
    other_sd: float | None = None,
    level: float = 0.99,
    power: float = 0.8,
    family: Family = "normal",
) -> ContrastPlan:
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
    power : float
        Probability of showing the difference.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    ContrastPlan

    Raises
    ------
    UsageError
        A difference or SD that is not positive, or a level or power outside 0 to 1.
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

    n = _fewest(reached, power, "power")
    df = freedom * (n - 1.0)
    half_width = -special.stdtrit(df, half_tail) * np.sqrt(variance / n) * _mean_sd(df)
    return ContrastPlan(
        n=n,
        power=reached(n),
        difference=difference,
        expected=float(np.expm1(half_width) if log else half_width),
        level=level,
        family=family,
        groups=other_sd is not None,
    )


@dataclass(frozen=True, kw_only=True)
class EquivalencePlan(NotebookRecord):
    """The number of subjects that shows a bias to be smaller than one JND."""

    n: int  # Subjects
    power: float  # Probability that a study of `n` subjects shows it
    jnd: float  # In the unit of the SD ("lognormal": as a fraction of the reference)
    bias: float  # True one, in the same terms
    decision: float  # Confidence that decides
    family: Family

    @property
    def covers(self) -> str:
        """One plain sentence saying what the plan promises."""
        log = self.family == "lognormal"
        jnd = percent(self.jnd) if log else f"{self.jnd:.4g}"
        bias = percent(self.bias) if log else f"{self.bias:.4g}"
        sure = percent(self.power, digits=4)
        return (
            f"With {self.n} subjects, a true bias of {bias} is shown to be smaller than one JND,"
            f" {jnd}, with {percent(self.decision)} confidence in {sure} of studies."
        )


def plan_equivalent(
    jnd: float,
    *,
    sd: float,
    bias: float = 0.0,
    decision: float = 0.95,
    power: float = 0.8,
    family: Family = "normal",
) -> EquivalencePlan:
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
    power : float
        Probability of showing it.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    EquivalencePlan
        Its power is exact, by `percept.inference.classical.fiducial.tost_power`.

    Raises
    ------
    UsageError
        A JND or SD that is not positive, a bias of one JND or more, a decision outside 0.5 to 1 or
        a power outside 0 to 1.
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
    if family == "lognormal":
        sd = float(np.sqrt(np.log1p(sd**2)))
        centre = np.log1p(bias)
        to_upper = float(np.log1p(jnd) - centre)
        # No positive value lies a whole reference below it.
        to_lower = float(centre - np.log1p(-jnd)) if jnd < 1.0 else np.inf

    def reached(n: int) -> float:
        root_n = np.sqrt(n) / sd
        return tost_power(to_lower * root_n, to_upper * root_n, n - 1.0, size=1.0 - decision)

    n = _fewest(reached, power, "power")
    return EquivalencePlan(
        n=n, power=reached(n), jnd=jnd, bias=bias, decision=decision, family=family
    )


def plan_from_pilot(
    first: ArrayLike,
    second: ArrayLike,
    difference: float,
    *,
    within: bool,
    level: float = 0.99,
    power: float = 0.8,
    family: Family = "normal",
) -> PilotPlan | None:
    """Plan the contrast of two levels by the SDs of a pilot study.

    Parameters
    ----------
    first, second : array_like, shape (n,)
        What each subject set at either level, in one order of the subjects; NaN where nothing.
    difference, level, power, family
        As of `plan_contrast`.
    within : bool
        Whether each subject has both levels.

    Returns
    -------
    PilotPlan or None
        None of levels with fewer than two subjects, or without scatter.
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
    plans = []
    for stated in (sds, upper):
        if family == "lognormal":
            stated = np.sqrt(np.expm1(stated**2))
        plan = plan_contrast(
            difference,
            sd=float(stated[0]),
            other_sd=None if within else float(stated[1]),
            level=level,
            power=power,
            family=family,
        )
        plans.append(plan)
    return PilotPlan(subjects=int(counts.sum()), plan=plans[0], cautious=plans[1])


def _check(family: Family, **sizes: float) -> None:
    """Refuse an unknown family, and sizes that are not positive."""
    for name, value in sizes.items():
        if not (np.isfinite(value) and value > 0.0):
            raise UsageError(f"{name} must be a positive number.", value=value)
    check_option("family", family, ("normal", "lognormal"))


def _smallest_ratio(
    factor: Callable[[int], Any], ratio: float, half_tail: float, assurance: float
) -> dict[str, Any]:
    """Plan for a width over that of a known population, whose SD is taken as the unit."""
    if not (np.isfinite(ratio) and ratio > 1.0):
        raise UsageError(
            "ratio must be above 1, to which it tends with ever more subjects.", value=ratio
        )
    return _smallest(factor, ratio, -1.0 / float(special.ndtri(half_tail)), assurance)


def _smallest(
    factor: Callable[[int], Any], wanted: float, sigma: float, assurance: float
) -> dict[str, Any]:
    """Return the smallest n with P(factor·SD ≤ wanted) ≥ assurance, both, and E factor·SD."""

    def reached(n: int) -> float:
        half = (n - 1.0) / 2.0
        return float(special.gammainc(half, half * (wanted / sigma / factor(n)) ** 2))

    n = _fewest(reached, assurance, "assurance")
    expected = float(factor(n)) * _mean_sd(n - 1.0) * sigma
    return {"n": n, "assurance": reached(n), "expected": expected}


def _fewest(reached: Callable[[int], float], wanted: float, name: str) -> int:
    """Return the smallest n that reaches a probability, which grows with n."""
    if not 0.0 < wanted < 1.0:
        hint = "80 percent is written 0.8."
        raise UsageError(f"{name} must lie strictly between 0 and 1.", value=wanted, hint=hint)
    n = 2 + bisect.bisect_left(range(2, _MOST_SUBJECTS + 1), wanted, key=reached)
    if n > _MOST_SUBJECTS:
        hint = "Ask for less."
        raise RefusalError(f"More than {_MOST_SUBJECTS} subjects would be needed.", hint=hint)
    return n


def _mean_sd(df: float) -> float:
    """Return the average SD of samples of unit variance."""
    half = df / 2.0
    return float(special.poch(half, 0.5) / np.sqrt(half))
