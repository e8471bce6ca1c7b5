"""How much users differ, relative to what they set or were shown: CV and Weber fraction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.checks import positive_references
from percept.inference.classical.claims import Claim, Parametric, parametric_family
from percept.inference.classical.levels import Level
from percept.inference.classical.moments import Moments, plain
from percept.inference.classical.parametric import family_moments, refuse_weights
from percept.inference.classical.shortfall import one_limit_offset
from percept.inference.covers import percent
from percept.inference.intervals import FloatOrArray
from percept.notebook import NotebookRecord


@dataclass(frozen=True, kw_only=True, eq=False)
class RelativeSpread(NotebookRecord):
    """A standard deviation between users as a fraction, with its equal-tailed interval.

    Parameters
    ----------
    quantity : {"cv", "weber"}
        SD over the mean, or SD over the reference.
    estimate, lower, upper : float or ndarray
        Unit-free. `upper` is infinite where the mean may as well be zero.
    level : float
        Confidence level.
    family : {"normal", "lognormal"}
        Distribution between users.
    n : int or ndarray of int
        Subjects.
    approximate : bool
        True where normal summaries were turned into lognormal ones by moment matching.
    """

    quantity: Literal["cv", "weber"]
    estimate: FloatOrArray
    lower: FloatOrArray
    upper: FloatOrArray
    level: float
    family: Parametric
    n: int | NDArray[np.int64]
    approximate: bool = False

    @property
    def covers(self) -> str:
        """One plain sentence saying what the interval covers."""
        whole = "their average" if self.quantity == "cv" else "the reference"
        return (
            f"The spread between users (standard deviation) as a fraction of {whole} lies between the "
            f"limits, with {percent(self.level)} confidence."
        )


def coefficient_of_variation(
    x: ArrayLike | Moments,
    *,
    level: Level = 0.99,
    family: Parametric = "normal",
    axis: int = -1,
) -> RelativeSpread:
    """Work out SD over mean, between users.

    The interval is exact: under ``"normal"`` √n·mean/SD is noncentral t; under ``"lognormal"`` the CV is
    √(exp(σ²) − 1), with σ² by χ².

    Parameters
    ----------
    x : array_like or Moments
        One value per subject, shape (..., n) with `axis` = −1, or moments of shape (...).
    level : float or OneMinus
        Confidence level.
    family : {"normal", "lognormal"}
        Distribution between users.
    axis : int
        Which axis of the values runs over subjects.

    Returns
    -------
    RelativeSpread
        Of shape (...).

    Raises
    ------
    UsageError
        Unfit values, level or family.
    RefusalError
        A mean of zero or below, no scatter, fewer than 2 subjects, zero or negative values under
        ``"lognormal"``.
    """
    moments, approximate, half_tail = _checked(x, level, family, axis)
    mean, sd, n = (np.asarray(part, dtype=float) for part in (moments.mean, moments.sd, moments.n))
    if family == "lognormal":
        low, high = _sd_limits(sd, n, half_tail)
        estimate, lower, upper = (np.sqrt(np.expm1(s**2)) for s in (sd, low, high))
    else:
        if (mean <= 0.0).any():
            raise RefusalError(
                "A coefficient of variation needs a positive mean.",
                value=float(mean.min()),
                hint="Use weber_fraction, which divides by the reference.",
            )
        estimate = sd / mean
        counts, ratio, doubt = (
            part.reshape(-1) for part in np.broadcast_arrays(n, mean / sd, np.float64(half_tail))
        )
        least = one_limit_offset(counts, ratio, doubt, short=True)
        most = one_limit_offset(counts, ratio, doubt, short=False)
        root = np.sqrt(counts)
        # an offset that may be zero or negative is a mean that may be, and then any CV is possible
        bounded = np.divide(root, least, out=np.full_like(root, np.inf), where=least > 0.0)
        beneath = np.divide(root, most, out=np.full_like(root, np.inf), where=most > 0.0)
        lower, upper = beneath.reshape(estimate.shape), bounded.reshape(estimate.shape)
    return RelativeSpread(
        quantity="cv",
        estimate=plain(np.asarray(estimate)),
        lower=plain(np.asarray(lower)),
        upper=plain(np.asarray(upper)),
        level=float(level),
        family=family,
        n=moments.n,
        approximate=approximate,
    )


def weber_fraction(
    x: ArrayLike | Moments, reference: ArrayLike, *, level: Level = 0.99, axis: int = -1
) -> RelativeSpread:
    """Work out SD over the reference, between users; its interval is exact, by χ².

    Parameters
    ----------
    x : array_like or Moments
        One value per subject, shape (..., n) with `axis` = −1, or moments of shape (...).
    reference : array_like
        What was shown, in the unit of `x`; positive; a shape that broadcasts with (...).
    level : float or OneMinus
        Confidence level.
    axis : int
        Which axis of the values runs over subjects.

    Returns
    -------
    RelativeSpread
        Of shape (...), family ``"normal"``.

    Raises
    ------
    UsageError, RefusalError
        As `bias`.
    """
    moments, approximate, half_tail = _checked(x, level, "normal", axis)
    shown = positive_references(reference, np.shape(moments.mean))
    sd, n = np.asarray(moments.sd), np.asarray(moments.n, dtype=float)
    low, high = _sd_limits(sd, n, half_tail)
    return RelativeSpread(
        quantity="weber",
        estimate=plain(sd / shown),
        lower=plain(low / shown),
        upper=plain(high / shown),
        level=float(level),
        family="normal",
        n=moments.n,
        approximate=approximate,
    )


def _checked(
    x: ArrayLike | Moments, level: Level, family: Parametric, axis: int
) -> tuple[Moments, bool, float]:
    claim = Claim(level, parametric_family(family))
    moments, approximate = family_moments(x, family, axis=axis)
    refuse_weights(moments)
    return moments, approximate, claim.tail() / 2.0


def _sd_limits(
    sd: NDArray[np.float64], n: NDArray[np.float64], half_tail: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    half = (n - 1.0) / 2.0
    low = sd * np.sqrt(half / special.gammainccinv(half, half_tail))
    return low, sd * np.sqrt(half / special.gammaincinv(half, half_tail))
