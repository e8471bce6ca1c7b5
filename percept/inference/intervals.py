"""The record every interval is handed over in, whichever method made it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.inference.covers import coverage_sentence
from percept.notebook import fields_html

Kind: TypeAlias = Literal["mean", "user", "share"]
Method: TypeAlias = Literal["classical", "bayesian"]
Family: TypeAlias = Literal["normal", "lognormal", "free"]
Joint: TypeAlias = Literal["marginal", "bonferroni"]
Side: TypeAlias = Literal["both", "lower", "upper"]
FloatOrArray: TypeAlias = float | NDArray[np.float64]

_ROW = (
    "kind",
    "method",
    "family",
    "joint",
    "level",
    "share",
    "confidence",
    "lower",
    "upper",
    "estimate",
    "n",
    "unit",
    "covers",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Interval:
    """An interval, with what it covers.

    Numbers are floats for one sample and arrays, all of one shape, for several.

    Parameters
    ----------
    kind : {"mean", "user", "share"}
        What is covered: the average user, the next user, or at least `share` of all users.
    method : {"classical", "bayesian"}
        How it was worked out.
    family : {"normal", "lognormal", "free"}
        Distribution between users; ``"free"`` assumes none and works on order statistics.
    level : float
        Confidence or credibility asked for; 0 to 1.
    lower, upper : float or ndarray
        Limits, in `unit`. A one-sided interval is infinite (or 0, lognormal) on its open side.
    estimate : float or ndarray
        Mean, geometric mean (lognormal) or median (free) of the users, in `unit`.
    n : int or ndarray of int
        Number of users (subjects), never of trials.
    mean, sd : float or ndarray, optional
        Sample mean and standard deviation on the family's scale: of the logarithms under
        ``"lognormal"``, in `unit` otherwise. None where the method does not go through them.
    factor : float or ndarray, optional
        Half-width in standard deviations on the family's scale, so that no digits are lost to an
        offset: the half-width is ``factor * sd``.
    share, confidence : float, optional
        For kind ``"share"``: at least `share` of the users, with `confidence`. None otherwise.
    joint : {"marginal", "bonferroni"}
        ``"bonferroni"``: widened so that the intervals of k and b hold together at `level`.
    side : {"both", "lower", "upper"}
        Which limits are stated.
    attained : float or ndarray, optional
        The level an interval of order statistics really has, at least the one asked for.
    expected_share : float or ndarray, optional
        For kind ``"mean"``: share of users the interval holds on average over studies.
    repeats : bool, optional
        Whether a user's value is the mean of repeated trials; None where it is not known.
    approximate : bool
        True where normal summaries were turned into lognormal ones by moment matching.
    unit : str
        Unit of the limits, for people to read.
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
    side: Side = "both"
    attained: FloatOrArray | None = None
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
        """One plain sentence saying what the interval covers."""
        return coverage_sentence(self)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields of an ``intervals`` row of report.json, without environment and parameter."""
        return {name: getattr(self, name) for name in _ROW}

    def _repr_html_(self) -> str:
        row = self.as_dict()
        return fields_html(row, caption=row.pop("covers"))
