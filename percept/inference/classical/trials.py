"""From trials to one value per subject, and whether these values look normal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.classical.moments import (
    Moments,
    check_option,
    finite_values,
    mean_and_sd,
    sample,
)
from percept.inference.record import Family

__all__ = ["Normality", "SubjectMeans", "check_normality", "subject_means"]

Array = NDArray[np.float64]

#: Beyond, the published approximation of the test's p-value is not valid.
_SHAPIRO_MOST = 5000


@dataclass(frozen=True, eq=False)
class SubjectMeans(NotebookRecord):
    """One value per subject, in the order in which the subjects first appear."""

    values: Array  # (n,) Mean of the trials, geometric under "lognormal", in their unit
    family: Family  # Scale on which the trials were averaged
    #: SD between trials of a subject, pooled, on that scale; None without repeats.
    trial_sd: float | None

    def moments(self) -> Moments:
        """Return mean and SD of the subjects' values on the family's scale."""
        return Moments.from_values(
            self.values, log=self.family == "lognormal", repeats=self.trial_sd is not None
        )


@dataclass(frozen=True, kw_only=True)
class Normality(NotebookRecord):
    """Shapiro–Wilk test on the scale of a family."""

    statistic: float  # W; 1 for a perfect fit
    p_value: float  # Small where the family fits badly; with ten subjects only gross misfit shows
    family: Family  # Whether the values were tested, or their logarithms
    n: int  # Subjects


def subject_means(
    values: ArrayLike,
    subjects: ArrayLike,
    *,
    family: Family = "normal",
) -> SubjectMeans:
    """Average the trials of each subject, however many each did: shapes (trials,)."""
    check_option("family", family, ("normal", "lognormal"))
    log = family == "lognormal"
    y = finite_values(values, positive=log)
    y = np.log(y) if log else y
    who = np.asarray(subjects)
    if y.ndim != 1 or who.shape != y.shape:
        raise UsageError(
            f"One subject per trial is needed; the shapes are {y.shape} and {who.shape}."
        )
    # What is not equal to itself: NaN, which would otherwise count as one subject.
    if any(label is None or label != label for label in who.tolist()):
        raise UsageError(
            "every trial needs a subject; some have none.", hint="Leave those trials out."
        )
    # In the order of first appearance.
    trials: dict[Any, list[float]] = {}
    for label, value in zip(who.tolist(), y.tolist(), strict=True):
        trials.setdefault(label, []).append(value)
    means = []
    squares = []
    for own_trials in trials.values():
        mean, sd = mean_and_sd(np.array(own_trials))
        means.append(float(mean))
        squares.append(float(sd * sd) * (len(own_trials) - 1))
    repeats = y.size - len(trials)
    return SubjectMeans(
        values=np.exp(means) if log else np.array(means),
        family=family,
        trial_sd=math.sqrt(math.fsum(squares) / repeats) if repeats else None,
    )


def check_normality(x: ArrayLike, *, family: Family = "normal") -> Normality:
    """Test whether the values (or their logarithms) look normal, by Shapiro and Wilk.

    Parameters
    ----------
    x : array_like
        Shape (n,): one value per subject, n from 3 to 5000.
    family : {"normal", "lognormal"}
        Test the values, or their logarithms.

    Returns
    -------
    Normality
        With statistic (W) and p_value: for information, never a switch of method.

    Raises
    ------
    UsageError
        Unfit values, more than one sample, an unknown family.
    RefusalError
        Fewer than 3 or more than 5000 subjects, no scatter, zero or negative values under
        ``"lognormal"``.
    """
    check_option("family", family, ("normal", "lognormal"))
    y = sample(x, positive=family == "lognormal", least=3)
    if y.ndim != 1:
        raise UsageError(f"One sample at a time; the values have shape {y.shape}.")
    if y.size > _SHAPIRO_MOST:
        raise RefusalError(
            f"The p-value of the Shapiro–Wilk test is known up to n = {_SHAPIRO_MOST}; here n ="
            f" {y.size}.",
            hint="With that many, look at a plot of quantiles.",
        )
    if np.ptp(y) == 0.0:
        raise RefusalError("All subjects gave the same value: there is no distribution to test.")
    from scipy import stats  # slow to import, and needed here only

    y = np.log(y) if family == "lognormal" else y
    # The statistic does not depend on location and scale; far from zero its arithmetic would.
    centred = y - y[0]
    statistic, p_value = stats.shapiro(centred / np.abs(centred).max())
    return Normality(statistic=float(statistic), p_value=float(p_value), family=family, n=y.size)
