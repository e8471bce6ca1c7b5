"""The record of every interval, whichever method makes it, and what it covers in a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError
from percept.html import NotebookRecord

Kind: TypeAlias = Literal["mean", "user", "share"]
Method: TypeAlias = Literal["classical", "bayesian"]
Family: TypeAlias = Literal["normal", "lognormal"]
Joint: TypeAlias = Literal["marginal", "bonferroni"]
FloatOrArray: TypeAlias = float | NDArray[np.float64]

#: The columns of an interval in tables and in report.json, between environment, parameter and
#: reference.
ROW = (
    "kind", "method", "family", "joint", "level", "share", "confidence",
    "lower", "upper", "estimate", "n", "unit", "covers",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Interval(NotebookRecord):
    """An interval, with what it covers.

    Numbers are floats for one sample and arrays, all of one shape, for several.

    Parameters
    ----------
    kind : {"mean", "user", "share"}
        What is covered: the average user, the next user, or at least `share` of all users.
    method : {"classical", "bayesian"}
        How it was worked out.
    family : {"normal", "lognormal"}
        Distribution between users.
    level : float
        Confidence or credibility asked for; 0 to 1.
    lower, upper : float or ndarray
        Limits, in `unit`.
    estimate : float or ndarray
        Mean or geometric mean (lognormal) of the users, in `unit`.
    n : int or ndarray of int
        Number of users (subjects), never of trials.
    mean, sd : float or ndarray, optional
        Sample mean and standard deviation on the family's scale: of the logarithms under
        ``"lognormal"``, in `unit` otherwise. None where the method does not go through them.
    factor : float or ndarray, optional
        Half-width in standard deviations on the family's scale: an offset costs it no digits.
    share, confidence : float, optional
        For kind ``"share"``: at least `share` of the users, with `confidence`. None otherwise.
    joint : {"marginal", "bonferroni"}
        ``"bonferroni"``: widened so that the intervals of k and b hold together at `level`.
    expected_share : float or ndarray, optional
        For kind ``"mean"``: share of users the interval holds on average over studies.
    repeats : bool, optional
        Whether a user's value is the mean of repeated trials; None where it is not known.
    approximate : bool
        True where normal summaries were turned into lognormal ones by moment matching.
    unit : str
        Unit of the limits, for people to read.

    Raises
    ------
    UsageError
        Kind ``"share"`` without its share or confidence.
    """

    kind: Kind
    method: Method
    family: Family
    level: float
    lower: FloatOrArray
    upper: FloatOrArray
    estimate: FloatOrArray
    n: int | NDArray[np.int64]
    mean: FloatOrArray | None = None
    sd: FloatOrArray | None = None
    factor: FloatOrArray | None = None
    share: float | None = None
    confidence: float | None = None
    joint: Joint = "marginal"
    expected_share: FloatOrArray | None = None
    repeats: bool | None = None
    approximate: bool = False
    unit: str = ""

    def __post_init__(self) -> None:
        if self.kind == "share" and (self.share is None or self.confidence is None):
            raise UsageError(
                "An interval of kind 'share' needs both the share and the confidence.",
                hint="Pass share= and confidence=.",
            )

    @property
    def covers(self) -> str:
        """One plain sentence saying what the interval covers, the same for every sample."""
        return self.covers_of("user", "users")

    def covers_of(self, user: str, users: str) -> str:
        """Say what the interval covers, with a study's words for one user and for several."""
        clauses = [f"{self._statement(user, users)} ({', '.join(self._basis(users))})"]
        if self.expected_share is not None:
            share = percent(self.expected_share, digits=3)
            clauses.append(f"it is not a range of {users}, and holds an expected {share} of them")
        if self.joint == "bonferroni":
            clauses.append("widened so that the statements on both quantities are true together")
        if self.approximate:
            clauses.append(
                "approximate, as a published mean and SD were turned into lognormal ones by moment"
                " matching"
            )
        return "; ".join(clauses) + "."

    def _statement(self, user: str, users: str) -> str:
        level = self.level if self.confidence is None else self.confidence
        sure = f"{percent(level)} confidence"
        if self.method == "bayesian":
            sure = f"{percent(level)} probability under the model and its priors"
        if self.share is not None:
            return (
                f"At least {percent(self.share)} of all {users} lie between the limits, with {sure}"
            )
        average = f"average {user}'s value"
        if self.family == "lognormal":
            average = f"typical {user}'s value (the geometric mean of all {users})"
        who = average if self.kind == "mean" else f"next {user}'s value"
        return f"The {who} lies between the limits, with {sure}"

    def _basis(self, users: str) -> list[str]:
        fewest = int(np.min(self.n))
        most = int(np.max(self.n))
        parts = [f"from {fewest} {users}"]
        if fewest != most:
            parts = [f"from {fewest} to {most} {users}"]
        if self.repeats is False:
            parts.append("one trial each, trial noise included")
        elif self.repeats and self.method == "classical":
            parts.append("each the mean of repeated trials, the rest of the trial noise included")
        elif self.repeats and self.kind != "mean":
            parts.append("trial noise left out")
        return [*parts, f"in {self.unit}"] if self.unit else parts


def percent(probability: ArrayLike, digits: int = 15) -> str:
    """Write a probability as a percentage, an array as its range; 100 % is one alone."""
    values = np.asarray(probability, dtype=float)
    low = _percentage(float(values.min()), digits)
    high = _percentage(float(values.max()), digits)
    return f"{low} %" if low == high else f"{low} % to {high} %"


def _percentage(probability: float, digits: int) -> str:
    """Write with some digits, or with more if a probability below one would read 100."""
    while True:
        text = f"{100.0 * probability:.{digits}g}"
        if text != "100" or probability == 1.0:
            return text
        digits += 1
