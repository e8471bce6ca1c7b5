"""How many subjects the next study needs.

Each plan finds the smallest n whose interval is, with a stated probability (the assurance), no
wider than wanted. The width of a classical interval is a known multiple of the SD, and the SD of a
normal sample is a χ variable: the assurance is a χ² probability, exact, and no simulation is
needed.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.classical.moments import check_option, tail_of
from percept.inference.classical.tolerance import factor_of_tails
from percept.inference.record import Family, Kind, percent

__all__ = ["Plan", "plan_mean", "plan_share", "plan_user"]

_MOST_SUBJECTS = 10_000_000


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
    for name, value in (("half_width", half_width), ("sd", sd)):
        if not (np.isfinite(value) and value > 0.0):
            raise UsageError(f"{name} must be a positive number.", value=value)
    check_option("family", family, ("normal", "lognormal"))
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
    if not 0.0 < assurance < 1.0:
        hint = "80 percent is written 0.8."
        raise UsageError("assurance must lie strictly between 0 and 1.", value=assurance, hint=hint)

    def reached(n: int) -> float:
        half = (n - 1.0) / 2.0
        return float(special.gammainc(half, half * (wanted / sigma / factor(n)) ** 2))

    n = 2 + bisect.bisect_left(range(2, _MOST_SUBJECTS + 1), assurance, key=reached)
    if n > _MOST_SUBJECTS:
        hint = "Ask for a wider interval."
        raise RefusalError(f"More than {_MOST_SUBJECTS} subjects would be needed.", hint=hint)
    half = (n - 1.0) / 2.0
    mean_sd = float(special.poch(half, 0.5) / np.sqrt(half))  # of a sample of unit variance
    return {"n": n, "assurance": reached(n), "expected": float(factor(n)) * mean_sd * sigma}
