"""Standard deviations, reliability and correlation: estimates with equal-tailed intervals.

Mean squares of normal values are multiples of χ² variables. An SD's interval is therefore exact by
χ², and an intraclass correlation's by F, as the ratio of two mean squares. The interval of a
difference of two mean squares is Williams' and Tukey's: nearly exact, and never shorter than twice
the tails would make it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import tail_of

Array = NDArray[np.float64]

#: Pairs from which Fisher's z has a finite variance, 1/(n − 3).
_FEWEST_PAIRS = 4


@dataclass(frozen=True)
class Bounded:
    """An estimate with its equal-tailed interval; infinite limits where nothing bounds it."""

    estimate: float
    lower: float
    upper: float
    error: float | None = None  # Monte Carlo standard error of the limits, the larger


@dataclass(frozen=True, kw_only=True)
class MeanSquares:
    """Mean squares of a table of n subjects by k repeated measurements."""

    subjects: float  # Mean square between subjects
    error: float  # Mean square of what is left
    n: int  # Subjects
    k: float  # Measurements per subject, their effective number where subjects differ
    error_df: float  # Degrees of freedom of `error`

    @property
    def ratio(self) -> float:
        """F of the subjects; infinite without any error."""
        return self.subjects / self.error if self.error > 0.0 else math.inf


def mean_squares(table: Array) -> MeanSquares:
    """Split the squares of a complete table by subjects and columns.

    Parameters
    ----------
    table : ndarray, shape (n, k)
        A row per subject, a column per measurement; finite.

    Returns
    -------
    MeanSquares
        In the square of the table's unit.

    Raises
    ------
    RefusalError
        Fewer than two subjects or columns, or values that are all equal.
    """
    n, k = table.shape
    if n < 2 or k < 2:
        raise RefusalError(f"A table of {n} by {k} has no mean squares; both must be 2 or more.")
    if np.ptp(table) == 0.0:
        raise RefusalError("All values of the table are equal: they have no mean squares.")
    # About one of the values, so that an offset costs no digits.
    centred = table - table[0, 0]
    grand = centred.mean()
    row = centred.mean(axis=1, keepdims=True)
    column = centred.mean(axis=0, keepdims=True)
    rest = centred - row - column + grand
    error_df = (n - 1.0) * (k - 1.0)
    return MeanSquares(
        subjects=k * float(np.square(row - grand).sum()) / (n - 1.0),
        error=float(np.square(rest).sum()) / error_df,
        n=n,
        k=float(k),
        error_df=error_df,
    )


def trial_mean_squares(means: Array, counts: Array, trial_sd: float) -> MeanSquares:
    """Take subjects' means over trials as a one-way table.

    Parameters
    ----------
    means, counts : ndarray, shape (n,)
        Mean and number of the trials of each subject.
    trial_sd : float
        SD between trials of a subject, pooled, in the unit of `means`.

    Returns
    -------
    MeanSquares
        Exact in law where all counts are equal; else `k` is their effective number,
        (Σr − Σr²/Σr)/(n − 1).
    """
    n = len(means)
    total = counts.sum()
    centred = means - means[0]
    grand = counts @ centred / total
    return MeanSquares(
        subjects=float(counts @ np.square(centred - grand)) / (n - 1.0),
        error=trial_sd**2,
        n=n,
        k=float((total - counts @ counts / total) / (n - 1.0)),
        error_df=float(total - n),
    )


def sd_interval(sd: float, df: float, *, level: float) -> Bounded:
    """Bound a normal population's SD by χ²: SD·√(df/χ²) at either tail.

    Parameters
    ----------
    sd : float
        Sample SD, any unit.
    df : float
        Its degrees of freedom, above zero.
    level : float
        Confidence, 0 to 1.

    Returns
    -------
    Bounded
        In the unit of `sd`.
    """
    low, high = _chi_square_limits(df, level)
    lower = sd * math.sqrt(df / high)
    upper = sd * math.sqrt(df / low)
    return Bounded(sd, lower, upper)


def log_sd(sd: float, df: float) -> float:
    """Estimate the logarithm of a normal population's SD without bias.

    The mean of log(χ²/df) is digamma(df/2) − log(df/2), so that few values look too steady.

    Parameters
    ----------
    sd : float
        Sample SD, any unit.
    df : float
        Its degrees of freedom, above zero.

    Returns
    -------
    float
        −∞ for an SD of zero.
    """
    if sd == 0.0:
        return -math.inf
    return math.log(sd) + 0.5 * (math.log(df / 2.0) - float(special.digamma(df / 2.0)))


def icc_one_way(squares: MeanSquares, *, level: float) -> Bounded:
    """Bound the reliability of one trial.

    (MS_S − MS_E)/(MS_S + (k − 1) MS_E), exact by F: ICC(1) of a one-way table (McGraw and Wong
    1996; Shrout and Fleiss 1979 write 1,1).

    Parameters
    ----------
    squares : MeanSquares
        Of the table.
    level : float
        Confidence, 0 to 1.

    Returns
    -------
    Bounded
        Between −1/(k − 1) and 1.
    """
    f = squares.ratio
    at_lower, at_upper = f_limits(squares.n - 1.0, squares.error_df, level)

    ratios = np.array([f, f / at_lower, f / at_upper])
    with np.errstate(invalid="ignore"):
        correlations = np.where(np.isinf(ratios), 1.0, (ratios - 1.0) / (ratios + squares.k - 1.0))
    return Bounded(*correlations.tolist())


def component_sd(squares: MeanSquares, *, level: float) -> Bounded:
    """Bound √((MS_S − MS_E)/k), the SD between subjects without what the error adds.

    The interval is Williams' and Tukey's (Williams 1962): it holds at least 2·level − 1, and nearly
    the level. Negative squares count as zero.

    Parameters
    ----------
    squares : MeanSquares
        Of either table.
    level : float
        Confidence, 0 to 1.

    Returns
    -------
    Bounded
        In the table's unit.
    """
    df = squares.n - 1.0
    at_lower, at_upper = f_limits(df, squares.error_df, level)
    low, high = _chi_square_limits(df, level)
    total = df * squares.subjects / squares.k
    noise = df * squares.error / squares.k

    estimate = (total - noise) / df
    lower = (total - noise * at_lower) / high
    upper = (total - noise * at_upper) / low
    return Bounded(*np.sqrt(np.maximum([estimate, lower, upper], 0.0)).tolist())


def correlation(pairs: Array, *, level: float) -> Bounded:
    """Bound the correlation of a bivariate normal population by Fisher's z, SE 1/√(n − 3).

    Parameters
    ----------
    pairs : ndarray, shape (n, 2)
        Both values of each subject.
    level : float
        Confidence, 0 to 1.

    Returns
    -------
    Bounded
        From −1 to 1 with fewer than four subjects, who bound nothing.

    Raises
    ------
    RefusalError
        Fewer than two subjects, or values that are all equal.
    """
    n = len(pairs)
    if n < 2 or not np.ptp(pairs, axis=0).all():
        raise RefusalError("Values that do not differ between subjects have no correlation.")
    correlations = np.asarray(np.corrcoef(pairs.T))
    estimate = float(correlations[0, 1])
    if n < _FEWEST_PAIRS:
        return Bounded(estimate, -1.0, 1.0)
    reach = -special.ndtri(tail_of(level) / 2.0) / math.sqrt(n - 3.0)
    with np.errstate(divide="ignore"):
        z = np.arctanh(estimate)
    lower = float(np.tanh(z - reach))
    upper = float(np.tanh(z + reach))
    return Bounded(estimate, lower, upper)


def _chi_square_limits(df: float, level: float) -> tuple[float, float]:
    """Return the lower and the upper quantile of χ² at the level."""
    tail = tail_of(level) / 2.0
    # The lower tail by its own function: chdtri takes the upper one only.
    lower = 2.0 * special.gammaincinv(df / 2.0, tail)
    upper = special.chdtri(df, tail)
    return float(lower), float(upper)


def f_limits(df: float, error_df: float, level: float) -> tuple[float, float]:
    """Return the upper and the lower quantile of F at the level."""
    tail = tail_of(level) / 2.0
    # The upper quantile is one over the lower one of the inverse ratio, which keeps the digits.
    upper = 1.0 / special.fdtri(error_df, df, tail)
    lower = special.fdtri(df, error_df, tail)
    return float(upper), float(lower)
