"""Samples: what is accepted as one, its mean and SD (Eq. 14), and whether it looks normal."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.imports import shapiro
from percept.inference.record import Family, FloatOrArray

Array = NDArray[np.float64]

#: Beyond, the published approximation of the normality test's p-value is not valid.
_SHAPIRO_MOST = 5000


@dataclass(frozen=True, eq=False)
class Moments(NotebookRecord):
    """Mean, standard deviation and size of a sample: all that the normal family needs.

    Fields are floats for one sample, or arrays of one shape for several (environments, parameters,
    studies). Accepted wherever a sample is.

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
    scale: Literal["linear", "log"] = "linear"
    repeats: bool | None = None

    def __post_init__(self) -> None:
        check_option("scale", self.scale, ("linear", "log"))
        mean = finite_values(self.mean, name="means")
        sd = finite_values(self.sd, name="standard deviations")
        if (sd < 0.0).any():
            raise UsageError("A standard deviation cannot be negative.", value=float(sd.min()))
        counts = subject_counts(self.n)
        mean, sd, n = fitted("Means, standard deviations and counts", mean, sd, counts)
        object.__setattr__(self, "mean", plain(mean))
        object.__setattr__(self, "sd", plain(sd))
        object.__setattr__(self, "n", int(n) if n.ndim == 0 else n.astype(np.int64))

    @classmethod
    def from_values(
        cls,
        values: ArrayLike,
        *,
        log: bool = False,
        repeats: bool | None = None,
    ) -> Self:
        """Work out mean and SD of one value per subject.

        Parameters
        ----------
        values : array_like
            Shape (..., n): one value per subject, any unit.
        log : bool
            Average the natural logarithms instead.
        repeats : bool, optional
            Whether each value is the mean of repeated trials.

        Returns
        -------
        Moments
            Of shape (...): within 4 ulp of the correctly rounded mean and SD of the doubles given,
            or of their rounded logarithms.

        Raises
        ------
        UsageError
            Values that are not finite numbers.
        RefusalError
            Fewer than 2 subjects; zero or negative values where `log`.
        """
        samples = sample(values, positive=log)
        first = samples[..., :1]
        mean, sd = mean_and_sd(_log_ratios(samples, first) if log else samples)
        if log:
            mean = mean + np.log(first[..., 0])
        return cls(mean, sd, samples.shape[-1], scale="log" if log else "linear", repeats=repeats)

    @classmethod
    def from_limits(
        cls,
        lower: ArrayLike,
        upper: ArrayLike,
        n: ArrayLike,
        *,
        level: float = 0.99,
    ) -> Self:
        """Turn the published limits of a t-interval (Eq. 15) back into mean and SD.

        Parameters
        ----------
        lower, upper : array_like
            Limits of the mean, any unit.
        n : int or array_like of int
            Subjects.
        level : float
            Confidence level of the limits.

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
        counts = subject_counts(n)
        low, high, count = fitted("Lower and upper limits and counts", low, high, counts)
        if (low > high).any():
            raise UsageError(
                "A lower limit lies above its upper limit.",
                value=float(low[low > high].flat[0]),
                hint="Check that the columns are not swapped.",
            )
        t = -special.stdtrit(count - 1.0, tail_of(level) / 2.0)
        half_width = 0.5 * high - 0.5 * low
        sd = half_width / t * np.sqrt(count)
        return cls(0.5 * low + 0.5 * high, sd, count.astype(np.int64))

    def on_scale(self, family: str) -> Moments:
        """Return these moments on the scale of a family, published ones by moment matching.

        Parameters
        ----------
        family : {"normal", "lognormal"}
            Of the values, or of their logarithms.

        Returns
        -------
        Moments
            Themselves, or moments of the logarithms that a lognormal with this mean and SD has:
            variance log(1 + SD²/mean²), mean log(mean) − variance/2.

        Raises
        ------
        UsageError
            Moments of logarithms under the normal family.
        RefusalError
            A mean of zero or below under the lognormal family.
        """
        if family == "normal" and self.scale == "log":
            raise UsageError(
                "These are moments of logarithms; the normal family needs moments of the values.",
                hint='Use family="lognormal", or work the moments out with log=False.',
            )
        if family == "normal" or self.scale == "log":
            return self
        mean = np.asarray(self.mean)
        sd = np.asarray(self.sd)
        if (mean <= 0.0).any():
            raise RefusalError(
                "A lognormal has a positive mean; the published one is zero or negative.",
                value=float(mean.min()),
                hint='Use family="normal".',
            )
        variance = np.log1p((sd / mean) ** 2)
        return Moments(
            np.log(mean) - variance / 2.0,
            np.sqrt(variance),
            self.n,
            scale="log",
            repeats=self.repeats,
        )


def subject_means(
    values: ArrayLike,
    subjects: ArrayLike,
    *,
    family: Family = "normal",
) -> Array:
    """Average each subject's trials, shapes (trials,), on the scale of a family.

    Subjects come in the order in which they first appear.
    """
    log = family == "lognormal"
    trials = finite_values(values, positive=log)
    responses = np.log(trials) if log else trials
    by_subject: dict[Any, list[float]] = {}
    for name, response in zip(np.asarray(subjects).tolist(), responses.tolist(), strict=True):
        by_subject.setdefault(name, []).append(response)
    # The sum is rounded once. `statistics.mean` does so too, and takes ten times as long.
    means = np.array([math.fsum(own) / len(own) for own in by_subject.values()])
    return np.exp(means) if log else means


def mean_and_sd(samples: Array) -> tuple[Array, Array]:
    """Mean and SD along the last axis, each rounded once; one value has SD 0.

    Python's `statistics` sums fractions.
    """
    shape = samples.shape[:-1]
    rows = samples.reshape(-1, samples.shape[-1]).tolist()
    means = np.array([statistics.mean(row) for row in rows])
    sds = np.array([_sd(row) for row in rows])
    return means.reshape(shape), sds.reshape(shape)


def _sd(row: list[float]) -> float:
    try:
        return statistics.stdev(row) if len(row) > 1 else 0.0
    except OverflowError:  # beyond the largest double
        return math.inf


def plain(values: Array) -> FloatOrArray:
    """Return a float for an array of no dimensions, else the array."""
    return float(values) if values.ndim == 0 else values


def check_option(name: str, value: str, options: tuple[str, ...]) -> None:
    """Refuse a value that is not one of the options."""
    if value not in options:
        named = ", ".join(f'"{option}"' for option in options)
        raise UsageError(f"{name} must be one of {named}.", value=value)


def finite_values(
    values: ArrayLike,
    *,
    name: str = "values",
    positive: bool = False,
) -> Array:
    """Return values as doubles that are finite and, if requested, positive."""
    if np.ma.is_masked(values):
        raise UsageError(
            f"Some of the {name} are masked.", hint="Pass what is not masked: values.compressed()."
        )
    try:
        given: NDArray[Any] = np.asarray(values)
    except ValueError:
        raise UsageError(
            f"The {name} are rows of unequal length.",
            hint="Pass samples of different size one at a time.",
        ) from None
    if given.size == 0:
        raise UsageError(f"There are no {name}: the array is empty.")
    if given.dtype.kind not in "iufO":
        raise UsageError(f"The {name} must be real numbers; their type is {given.dtype}.")
    try:  # Decimal, Fraction and pandas' nullable numbers are objects
        doubles = given.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"The {name} must be real numbers; their type is {given.dtype}.") from None
    finite = np.isfinite(doubles)
    if not finite.all():
        index = np.argwhere(~finite)[0]
        raise UsageError(
            f"The {name} must be finite numbers; the first that is not is at index"
            f" {index.tolist()}.",
            value=float(doubles[tuple(index)]),
            hint="Leave the trial out, or correct it.",
        )
    if positive and (doubles <= 0.0).any():
        raise RefusalError(
            f"The lognormal family takes logarithms, and some of the {name} are zero or negative.",
            value=float(doubles[doubles <= 0.0].flat[0]),
            hint='Use family="normal".',
        )
    return doubles


def sample(values: ArrayLike, *, positive: bool = False, least: int = 2) -> Array:
    """Return samples whose subjects, `least` or more, run along the last axis."""
    doubles = finite_values(values, positive=positive)
    if doubles.ndim == 0:
        raise UsageError("A sample is needed, not a single number.", value=float(doubles))
    count = doubles.shape[-1]
    if count < least:
        raise RefusalError(
            f"At least {least} subjects are needed; there {'is' if count == 1 else 'are'} {count}.",
            hint="Check that the last axis is that of the subjects, or add subjects.",
        )
    return doubles


def subject_counts(n: ArrayLike) -> NDArray[np.int64]:
    """Return numbers of subjects as integers."""
    counts = finite_values(n, name="numbers of subjects")
    broken = counts[counts != np.rint(counts)]
    if broken.size:
        raise UsageError("A number of subjects must be whole.", value=float(broken[0]))
    if (counts < 2).any():
        raise RefusalError(
            f"At least 2 subjects are needed; there is {int(counts.min())}.", hint="Add subjects."
        )
    return counts.astype(np.int64)


def fitted(names: str, *arrays: NDArray[Any]) -> tuple[Array, ...]:
    """Return arrays as doubles of one shape."""
    try:
        shape = np.broadcast_shapes(*(array.shape for array in arrays))
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise UsageError(f"{names} have shapes that do not fit: {shapes}.") from None
    return tuple(np.broadcast_to(np.asarray(array, dtype=np.float64), shape) for array in arrays)


def tails(level: ArrayLike, name: str = "level") -> Array:
    """Return 1 − level, which is exact for doubles from 0.5 up."""
    try:
        values = np.asarray(level, dtype=float)
    except (TypeError, ValueError):
        raise UsageError(f"{name} must be a number.", value=level) from None
    bad = ~((values > 0.0) & (values < 1.0))
    if bad.any():
        raise UsageError(
            f"{name} must lie strictly between 0 and 1.",
            value=float(values[bad].flat[0]),
            hint="99 percent is written 0.99.",
        )
    return 1.0 - values


def tail_of(
    level: float,
    name: str = "level",
    *,
    joint: str = "marginal",
) -> float:
    """Return what one level leaves out, halved where stiffness and damping share it."""
    tail = tails(level, name)
    if tail.ndim:
        raise UsageError(f"{name} must be one number here.", value=level)
    return float(tail) / 2.0 if joint == "bonferroni" else float(tail)


def _log_ratios(values: Array, first: Array) -> Array:
    """Return log(values/first), with the digits of values that hardly differ."""
    near = (values > 0.5 * first) & (values < 2.0 * first)
    nothing = np.zeros_like(values)
    relative = np.divide(values - first, first, out=nothing, where=near)
    return np.where(near, np.log1p(relative), np.log(values) - np.log(first))


@dataclass(frozen=True, kw_only=True)
class Normality(NotebookRecord):
    """Shapiro–Wilk test on the scale of a family."""

    statistic: float  # W; 1 for a perfect fit
    p_value: float  # Small where the family fits badly; with ten subjects only gross misfit shows
    family: Family  # Whether the values were tested, or their logarithms
    n: int  # Subjects


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
    y = np.log(y) if family == "lognormal" else y
    # The statistic does not depend on location and scale; far from zero its arithmetic would.
    centred = y - y[0]
    statistic, p_value = shapiro(centred / np.abs(centred).max())
    return Normality(statistic=float(statistic), p_value=float(p_value), family=family, n=y.size)
