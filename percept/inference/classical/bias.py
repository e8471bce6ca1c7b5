"""How far what subjects set is from what they were shown, and whether that is far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import UsageError
from percept.inference.classical.checks import positive_references
from percept.inference.classical.claims import Claim, Parametric, parametric_family
from percept.inference.classical.levels import Level, OneMinus
from percept.inference.classical.moments import Moments, plain
from percept.inference.classical.parametric import family_moments, mean_interval
from percept.inference.covers import percent
from percept.inference.intervals import FloatOrArray
from percept.notebook import NotebookRecord


@dataclass(frozen=True, kw_only=True, eq=False)
class Bias(NotebookRecord):
    """Ratio of the average user's value to the reference; 1 is no bias.

    Parameters
    ----------
    ratio, lower, upper : float or ndarray
        Estimate and limits, unit-free.
    level : float
        Confidence level.
    family : {"normal", "lognormal"}
        ``"normal"``: mean over reference; ``"lognormal"``: geometric mean over reference.
    n : int or ndarray of int
        Subjects.
    approximate : bool
        True where normal summaries were turned into lognormal ones by moment matching.
    """

    ratio: FloatOrArray
    lower: FloatOrArray
    upper: FloatOrArray
    level: float
    family: Parametric
    n: int | NDArray[np.int64]
    approximate: bool = False

    @property
    def holds_reference(self) -> bool | NDArray[np.bool_]:
        """Whether no bias (a ratio of 1) is within the limits."""
        held = (np.asarray(self.lower) <= 1.0) & (np.asarray(self.upper) >= 1.0)
        return bool(held) if held.ndim == 0 else held

    @property
    def covers(self) -> str:
        """One plain sentence saying what the interval covers."""
        who = "average" if self.family == "normal" else "typical (geometric-mean)"
        return (
            f"The {who} user's value divided by the reference lies between the limits, with "
            f"{percent(self.level)} confidence."
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Equivalence(NotebookRecord):
    """Outcome of two one-sided t-tests (TOST).

    Parameters
    ----------
    equivalent : bool or ndarray of bool
        Whether the bias is shown to lie within the margin.
    p_value : float or ndarray
        The larger of the two one-sided ones.
    least, most : float
        The margin as ratios to the reference.
    bias : Bias
        With its interval at level 1 − 2·alpha: equivalence is this interval within the margin.
    alpha : float
        Size of each test.
    """

    equivalent: bool | NDArray[np.bool_]
    p_value: FloatOrArray
    least: float
    most: float
    bias: Bias
    alpha: float

    @property
    def covers(self) -> str:
        """One plain sentence saying what was tested."""
        who = "average" if self.bias.family == "normal" else "typical (geometric-mean)"
        return (
            f"Equivalent means: the {who} user's value is shown to lie between {self.least:.4g} and "
            f"{self.most:.4g} times the reference, with an error rate of at most {percent(self.alpha)}."
        )


def bias(
    x: ArrayLike | Moments,
    reference: ArrayLike,
    *,
    level: Level = 0.99,
    family: Parametric = "normal",
    axis: int = -1,
) -> Bias:
    """Compare the average user with the reference, as a ratio.

    Parameters
    ----------
    x : array_like or Moments
        One value per subject, shape (..., n) with `axis` = −1, or moments of shape (...).
    reference : array_like
        What was shown, in the unit of `x`; positive; a shape that broadcasts with (...).
    level : float or OneMinus
        Confidence level.
    family : {"normal", "lognormal"}
        Distribution between users.
    axis : int
        Which axis of the values runs over subjects.

    Returns
    -------
    Bias
        Of shape (...).

    Raises
    ------
    UsageError, RefusalError
        As `t_interval`; a reference that is not positive has no ratio.
    """
    interval = mean_interval(x, Claim(level, parametric_family(family)), axis=axis)
    shown = positive_references(reference, np.shape(interval.estimate))
    return Bias(
        ratio=plain(np.asarray(interval.estimate) / shown),
        lower=plain(np.asarray(interval.lower) / shown),
        upper=plain(np.asarray(interval.upper) / shown),
        level=float(level),
        family=family,
        n=interval.n,
        approximate=interval.approximate,
    )


def equivalence_test(
    x: ArrayLike | Moments,
    reference: ArrayLike,
    *,
    margin: float,
    alpha: float = 0.05,
    family: Parametric = "normal",
    axis: int = -1,
) -> Equivalence:
    """Test whether the bias is shown to be small: two one-sided t-tests, each of size `alpha`.

    Parameters
    ----------
    x, reference, family, axis
        As `bias`.
    margin : float
        What counts as small: a ratio between 1 − margin and 1 + margin (``"normal"``), or between
        1/(1 + margin) and 1 + margin (``"lognormal"``). Positive; below 1 under ``"normal"``.
    alpha : float
        Size of the test, below 0.5.

    Returns
    -------
    Equivalence
        Of shape (...).

    Raises
    ------
    UsageError, RefusalError
        As `bias`; a margin or alpha out of range.
    """
    if not (np.isfinite(margin) and margin > 0.0 and (family == "lognormal" or margin < 1.0)):
        raise UsageError("margin must be a positive number, below 1 for the normal family.", value=margin)
    if not 0.0 < alpha < 0.5:
        raise UsageError("alpha must lie between 0 and 0.5.", value=alpha)
    result = bias(x, reference, level=OneMinus(2.0 * alpha), family=family, axis=axis)
    moments, _ = family_moments(x, family, axis=axis)
    shown = positive_references(reference, np.shape(moments.mean))
    mean, n = np.asarray(moments.mean), np.asarray(moments.n)
    error = np.asarray(moments.sd) / np.sqrt(n)
    most = 1.0 + margin
    least = 1.0 / most if family == "lognormal" else 1.0 - margin
    if family == "lognormal":
        down, up = np.log(shown) - np.log(most), np.log(shown) + np.log(most)
    else:
        down, up = shown * least, shown * most
    farther = np.minimum(mean - down, up - mean) / error
    p_value = np.asarray(special.stdtr(n - 1.0, -farther))
    equivalent = p_value < alpha
    return Equivalence(
        equivalent=bool(equivalent) if equivalent.ndim == 0 else equivalent,
        p_value=plain(p_value),
        least=least,
        most=most,
        bias=result,
        alpha=alpha,
    )
