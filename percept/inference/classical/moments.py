"""Mean and standard deviation of samples (Eq. 14), from values, from published figures, or weighted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.classical import doubledouble
from percept.inference.classical.checks import finite_values, fitted, sample, subject_counts
from percept.inference.classical.exact import MomentsAccumulator
from percept.inference.classical.levels import Level, tail
from percept.inference.classical.quantiles import t_upper
from percept.inference.intervals import FloatOrArray
from percept.notebook import NotebookRecord

_Scale = Literal["linear", "log"]
_BLOCK = 1 << 17  # values handled at once, so that the many temporaries stay in cache
_LONGEST = 1 << 13  # the error bounds of the pairwise route are worked out up to this many subjects
_FEW_ROWS = 8
_CANCELLED = 2.0**-40  # a mean smaller than this against the spread needs more than a pair of doubles
_HUGE = 2.0**1000


@dataclass(frozen=True, eq=False)
class Moments(NotebookRecord):
    """What a sample says under the normal family: mean, standard deviation and size.

    Fields are floats for one sample, or arrays of one shape for several (environments, parameters, studies).
    Accepted wherever a sample is.

    Parameters
    ----------
    mean : float or ndarray
        Mean, in the unit of the values (of their logarithms where `scale` is ``"log"``).
    sd : float or ndarray
        Standard deviation, divisor n − 1.
    n : int or ndarray of int
        Subjects, never trials; at least 2.
    scale : {"linear", "log"}
        Whether the values, or their natural logarithms, were averaged.
    repeats : bool, optional
        Whether each value was a subject's mean of repeated trials; None where it is not known.
    weighted : bool
        True where `sd` is n^½ times the standard error of a weighted mean: fit for kind ``"mean"`` only.

    Raises
    ------
    UsageError
        NaN, infinite, negative SD, n that is not whole, shapes that do not fit, an unknown scale.
    RefusalError
        Fewer than 2 subjects.
    """

    mean: FloatOrArray
    sd: FloatOrArray
    n: int | NDArray[np.int64]
    scale: _Scale = "linear"
    repeats: bool | None = None
    weighted: bool = False

    def __post_init__(self) -> None:
        mean = finite_values(self.mean, name="means")
        sd = finite_values(self.sd, name="standard deviations")
        if (sd < 0.0).any():
            raise UsageError("A standard deviation cannot be negative.", value=float(sd.min()))
        if self.scale not in get_args(_Scale):
            raise UsageError('scale must be "linear" or "log".', value=self.scale)
        mean, sd, n = fitted("Means, standard deviations and counts", mean, sd, subject_counts(self.n))
        object.__setattr__(self, "mean", plain(mean))
        object.__setattr__(self, "sd", plain(sd))
        object.__setattr__(self, "n", int(n) if n.ndim == 0 else n.astype(np.int64))

    @classmethod
    def from_values(
        cls, values: ArrayLike, *, log: bool = False, axis: int = -1, repeats: bool | None = None
    ) -> Moments:
        """Work out mean and SD of one value per subject.

        Parameters
        ----------
        values : array_like
            Shape (..., n) with `axis` = −1: one value per subject, any unit.
        log : bool
            Average the natural logarithms instead.
        axis : int
            Which axis runs over subjects.
        repeats : bool, optional
            Whether each value is the mean of repeated trials.

        Returns
        -------
        Moments
            Of shape (...): within 4 ulp of the correctly rounded mean and SD of the doubles given, or of
            their rounded logarithms.

        Raises
        ------
        UsageError, RefusalError
            As `percept.inference.classical.checks.sample`.
        """
        samples = sample(values, axis=axis, positive=log)
        if log:
            first = samples[..., :1]
            beyond, sd = mean_and_sd(_log_ratios(samples, first))
            mean = np.log(first[..., 0]) + beyond
        else:
            mean, sd = mean_and_sd(samples)
        return cls(mean, sd, samples.shape[-1], scale="log" if log else "linear", repeats=repeats)

    @classmethod
    def from_limits(
        cls,
        lower: ArrayLike,
        upper: ArrayLike,
        n: ArrayLike,
        *,
        level: Level = 0.99,
        repeats: bool | None = None,
    ) -> Moments:
        """Turn the published limits of a t-interval (Eq. 15) back into mean and SD.

        Parameters
        ----------
        lower, upper : array_like
            Limits of the mean, any unit.
        n : int or array_like of int
            Subjects.
        level : float or OneMinus
            Confidence level of the limits.
        repeats : bool, optional
            Whether each subject's value was the mean of repeated trials.

        Returns
        -------
        Moments
            As precise as the digits printed.

        Raises
        ------
        UsageError
            Limits out of order, not finite, or of shapes that do not fit; a wrong level or n.
        RefusalError
            Fewer than 2 subjects.
        """
        low = finite_values(lower, name="lower limits")
        high = finite_values(upper, name="upper limits")
        low, high, count = fitted("Lower and upper limits and counts", low, high, subject_counts(n))
        if (low > high).any():
            raise UsageError(
                "A lower limit lies above its upper limit.",
                value=float(low[low > high].flat[0]),
                hint="Check that the columns are not swapped.",
            )
        half_width = 0.5 * high - 0.5 * low
        factor = t_upper(tail(level) / 2.0, count - 1) / np.sqrt(count)
        return cls(0.5 * low + 0.5 * high, half_width / factor, count.astype(np.int64), repeats=repeats)

    @classmethod
    def from_weighted(
        cls, values: ArrayLike, weights: ArrayLike, *, log: bool = False, repeats: bool | None = None
    ) -> Moments:
        """Average one value per subject with weights.

        The mean's t-interval is exact where the weights are inversely proportional to the variances of the
        values: trials per subject are, if subjects do not truly differ; equal weights, if trial noise is nil.

        Parameters
        ----------
        values : array_like
            Shape (n,): one value per subject.
        weights : array_like
            Shape (n,): positive, in any unit.
        log : bool
            Average the natural logarithms instead.
        repeats : bool, optional
            Whether each value is the mean of repeated trials.

        Returns
        -------
        Moments
            Fit for kind ``"mean"`` only: what a user of unknown weight does does not follow from it.

        Raises
        ------
        UsageError
            Values and weights of different shape, weights not positive.
        RefusalError
            Fewer than 2 subjects.
        """
        y = sample(values, positive=log)
        w = finite_values(weights, name="weights")
        if y.ndim != 1 or w.shape != y.shape:
            raise UsageError(f"One weight per subject is needed; the shapes are {y.shape} and {w.shape}.")
        if (w <= 0.0).any():
            raise UsageError("Weights must be positive.", value=float(w.min()))
        y = np.log(y) if log else y
        share = w / math.fsum(w)
        # from an element of the sample, so that an offset cannot cancel
        beyond = y - y[0]
        shift = math.fsum(share * beyond)
        scatter = math.fsum(share * (beyond - shift) ** 2)
        n = y.size
        return cls(
            float(y[0]) + shift,
            math.sqrt(scatter * n / (n - 1)),
            n,
            scale="log" if log else "linear",
            repeats=repeats,
            weighted=True,
        )

    def lognormal(self) -> Moments:
        """Return the moments of the logarithms a lognormal with this mean and SD has.

        Returns
        -------
        Moments
            On the log scale: variance log(1 + SD²/mean²), mean log(mean) − variance/2.

        Raises
        ------
        RefusalError
            A mean of zero or below.
        UsageError
            A weighted mean, whose `sd` is not that of users.
        """
        if self.weighted:
            raise UsageError(
                "The SD behind a weighted mean is not that of users, which a lognormal's moments need.",
                hint="Average the logarithms: Moments.from_weighted(values, weights, log=True).",
            )
        mean, sd = np.asarray(self.mean), np.asarray(self.sd)
        if (mean <= 0.0).any():
            raise RefusalError(
                "A lognormal has a positive mean; the published one is zero or negative.",
                value=float(mean.min()),
                hint='Use family="normal".',
            )
        variance = np.log1p((sd / mean) ** 2)
        return Moments(
            np.log(mean) - variance / 2.0, np.sqrt(variance), self.n, scale="log", repeats=self.repeats
        )

    def on_scale(self, family: str) -> Moments:
        """Return these moments on the scale of a family: themselves, or `lognormal`.

        Parameters
        ----------
        family : {"normal", "lognormal"}
            Of the values, or of their logarithms.

        Returns
        -------
        Moments

        Raises
        ------
        UsageError
            Moments of logarithms under the normal family; else as `lognormal`.
        RefusalError
            As `lognormal`.
        """
        if family == "lognormal":
            return self if self.scale == "log" else self.lognormal()
        if self.scale == "log":
            raise UsageError(
                "These are moments of logarithms; the normal family needs those of the values.",
                hint='Use family="lognormal", or work the moments out with log=False.',
            )
        return self


def mean_and_sd(samples: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Work out means and SDs within 4 ulp of the correctly rounded ones.

    A few samples, or long ones, go through exact sums; many short ones through pairs of doubles, shifted by
    their first element. What the pairs cannot warrant (means that cancel, huge values) goes through exact
    sums.
    """
    n = samples.shape[-1]
    rows = samples.reshape(-1, n)
    mean, sd = np.empty(len(rows)), np.empty(len(rows))
    if len(rows) <= _FEW_ROWS or n > _LONGEST:
        doubtful = np.arange(len(rows))
    else:
        step = max(1, _BLOCK // n)
        sure = np.empty(len(rows), dtype=bool)
        for start in range(0, len(rows), step):
            block = slice(start, start + step)
            mean[block], sd[block], sure[block] = _by_pairs(rows[block])
        doubtful = np.flatnonzero(~sure)
    for index in doubtful:
        sums = MomentsAccumulator()
        sums.update(rows[index])
        mean[index], sd[index] = sums.mean, sums.sd
    shape = samples.shape[:-1]
    return mean.reshape(shape), sd.reshape(shape)


def plain(values: NDArray[np.float64]) -> FloatOrArray:
    """Return a float for an array of no dimensions, else the array."""
    return float(values) if values.ndim == 0 else values


def _log_ratios(values: NDArray[np.float64], first: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log(values/first), with the digits of values that hardly differ."""
    near = (values > 0.5 * first) & (values < 2.0 * first)
    close = np.log1p(np.divide(values - first, first, out=np.zeros_like(values), where=near))
    return np.where(near, close, np.log(values) - np.log(first))


def _by_pairs(
    rows: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return means, SDs, and whether they are warranted.

    With deviations D from an element of the sample, ΣD² is at most n times the sum of squares about the mean,
    so taking n·(mean D)² away costs at most n of the 2**53 the pairs have to spare.
    """
    n = rows.shape[-1]
    sure = np.abs(rows).max(axis=-1) < _HUGE
    rows = np.where(sure[:, None], rows, 0.0)
    first = rows[:, :1]
    high, low = doubledouble.two_sum(rows, np.broadcast_to(-first, rows.shape))
    spread = np.abs(high).max(axis=-1)
    exponent = np.frexp(spread)[1]
    scaled = (np.ldexp(high, -exponent[:, None]), np.ldexp(low, -exponent[:, None]))
    shift = doubledouble.divide(doubledouble.total(scaled), n)
    squares = doubledouble.total(doubledouble.square(scaled))
    about = doubledouble.subtract(doubledouble.divide(squares, n), doubledouble.square(shift))
    sd = np.ldexp(np.sqrt(np.maximum(about[0], 0.0) * (n / (n - 1))), exponent)
    s, error = doubledouble.two_sum(first[:, 0], np.ldexp(shift[0], exponent))
    mean = s + (error + np.ldexp(shift[1], exponent))
    sure &= np.abs(mean) >= _CANCELLED * spread
    return mean, sd, sure
