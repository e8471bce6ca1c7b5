"""Normality and single subjects: information for the analyst, never a switch of method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.classical.checks import sample
from percept.inference.classical.claims import Parametric, parametric_family
from percept.inference.classical.levels import Level
from percept.inference.classical.sample_intervals import interval_of
from percept.inference.intervals import Kind
from percept.notebook import NotebookRecord

_SHAPIRO_MOST = 5000  # beyond, the published approximation of its p-value is not valid
_BLOCK = 1 << 20


@dataclass(frozen=True, kw_only=True)
class Normality(NotebookRecord):
    """Shapiro–Wilk test on the scale of a family.

    Parameters
    ----------
    statistic : float
        W; 1 for a perfect fit.
    p_value : float
        Small where the family fits badly. With ten subjects only gross misfit shows.
    family : {"normal", "lognormal"}
        What was tested: the values, or their logarithms.
    n : int
        Subjects.
    """

    statistic: float
    p_value: float
    family: Parametric
    n: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Influence(NotebookRecord):
    """What leaving each subject out does to the limits.

    Parameters
    ----------
    lower, upper : ndarray
        Shape (n,): the limits without that subject, in the unit of the values.
    lower_shift, upper_shift : ndarray
        Shape (n,): by how many half-widths of the full interval the limit moves, on the family's scale.
    kind : {"mean", "user", "share"}
        Which interval.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    lower_shift: NDArray[np.float64]
    upper_shift: NDArray[np.float64]
    kind: Kind

    @property
    def most(self) -> int:
        """Index of the subject whose absence moves a limit most."""
        return int(np.argmax(np.maximum(np.abs(self.lower_shift), np.abs(self.upper_shift))))


def check_normality(x: ArrayLike, *, family: Parametric = "normal") -> Normality:
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
        For information.

    Raises
    ------
    UsageError
        Unfit values, more than one sample.
    RefusalError
        Fewer than 3 or more than 5000 subjects, no scatter, zero or negative values under ``"lognormal"``.
    """
    y = _one_sample(x, family, least=3)
    if y.size > _SHAPIRO_MOST:
        raise RefusalError(
            f"The p-value of the Shapiro–Wilk test is known up to n = {_SHAPIRO_MOST}; here n = {y.size}.",
            hint="With so many, look at a plot of quantiles.",
        )
    if np.ptp(y) == 0.0:
        raise RefusalError("All subjects gave the same value: there is no distribution to test.")
    from scipy import stats  # slow to import, and needed here only

    # the statistic does not depend on location and scale; far from zero its arithmetic would
    centred = y - y[0]
    statistic, p_value = stats.shapiro(centred / np.abs(centred).max())
    return Normality(statistic=float(statistic), p_value=float(p_value), family=family, n=y.size)


def influence(
    x: ArrayLike,
    *,
    kind: Kind = "mean",
    level: Level = 0.99,
    share: Level | None = None,
    confidence: Level = 0.95,
    family: Parametric = "normal",
) -> Influence:
    """Work out the limits without each subject in turn.

    Parameters
    ----------
    x : array_like
        Shape (n,): one value per subject, n ≥ 3.
    kind : {"mean", "user", "share"}
        Which interval.
    level, share, confidence : float or OneMinus
        As `tolerance_interval`.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    Influence
        In the order of `x`.

    Raises
    ------
    UsageError, RefusalError
        As `t_interval`; fewer than 3 subjects; no scatter left without one of them.
    """
    y = _one_sample(x, family, least=3)

    def limits(values: NDArray[np.float64]) -> NDArray[np.float64]:
        interval = interval_of(kind, values, level=level, share=share, confidence=confidence)
        return np.stack([np.asarray(interval.lower), np.asarray(interval.upper)])

    # limits of the deviations from one subject, so that an offset does not round them
    shifted = y - y[0]
    full = limits(shifted)
    rows = max(1, _BLOCK // y.size)
    subjects = np.arange(y.size)
    parts = [
        limits(np.stack([np.delete(shifted, i) for i in subjects[start : start + rows]]))
        for start in range(0, y.size, rows)
    ]
    without = np.concatenate(parts, axis=1)
    lower_shift, upper_shift = (without - full[:, None]) / ((full[1] - full[0]) / 2.0)
    lower, upper = without + y[0]
    if family == "lognormal":
        lower, upper = np.exp(lower), np.exp(upper)
    return Influence(lower=lower, upper=upper, lower_shift=lower_shift, upper_shift=upper_shift, kind=kind)


def _one_sample(x: ArrayLike, family: Parametric, *, least: int) -> NDArray[np.float64]:
    log = parametric_family(family) == "lognormal"
    y = sample(x, positive=log, least=least)
    if y.ndim != 1:
        raise UsageError(f"One sample at a time; the values have shape {y.shape}.")
    return np.log(y) if log else y
