"""The three kinds of interval, two ratios to the reference, and contrasts of two conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError
from percept.html import NotebookRecord
from percept.inference.classical.moments import (
    Moments,
    check_option,
    finite_values,
    fitted,
    mean_and_sd,
    plain,
    tail_of,
)
from percept.inference.classical.tolerance import factor_of_tails
from percept.inference.record import Family, FloatOrArray, Interval, Joint, Kind, Side, percent

#: SDs of standardised values, below which the values of two conditions are multiples of one
#: another.
_PROPORTION = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Ratio(NotebookRecord):
    """A ratio to the reference, unit-free, with its equal-tailed interval."""

    quantity: Literal[
        "bias", "weber"
    ]  # Average user over reference, or SD between users over reference
    estimate: FloatOrArray
    lower: FloatOrArray
    upper: FloatOrArray
    level: float
    family: Family  # Under "lognormal" the average is the geometric mean
    n: int | NDArray[np.int64]  # Subjects

    @property
    def covers(self) -> str:
        """One plain sentence saying what the interval covers."""
        average = "typical (geometric-mean)" if self.family == "lognormal" else "average"
        who = (
            "standard deviation between users"
            if self.quantity == "weber"
            else f"{average} user's value"
        )
        sure = f"{percent(self.level)} confidence"
        return f"The {who} divided by the reference lies between the limits, with {sure}."


def t_interval(
    x: ArrayLike | Moments,
    *,
    level: float = 0.99,
    family: Family = "normal",
    joint: Joint = "marginal",
    side: Side = "both",
    unit: str = "",
) -> Interval:
    """Work out the interval of the average user, kind ``"mean"`` (Eq. 15): mean ± t·SD/√n.

    The paper reads it as "99 percent of users". It is a statement on their mean; how many users it
    holds on average is in `expected_share` of the result (.647 at n = 10 and level .99) and in its
    sentence.

    Parameters
    ----------
    x : array_like or Moments
        One value per subject, shape (..., n), any unit; or mean, SD and n, or published limits, as
        `Moments`.
    level : float
        Confidence level; 0 to 1, exclusive.
    family : {"normal", "lognormal"}
        Distribution between users. Under ``"lognormal"`` everything happens on the logarithms and
        the mean becomes the typical (geometric-mean) user; linear `Moments` are turned into
        lognormal ones by moment matching.
    joint : {"marginal", "bonferroni"}
        ``"bonferroni"``: level 1 − (1 − level)/2, so that the intervals of k and b hold together.
    side : {"both", "lower", "upper"}
        Both limits, equal-tailed, or one.
    unit : str
        Unit of the values, for the sentence.

    Returns
    -------
    Interval
        Fields of shape (...), in the unit of `x`.

    Raises
    ------
    UsageError
        Values that are not finite numbers, an unknown option, a level outside (0, 1).
    RefusalError
        Fewer than 2 subjects, no scatter, zero or negative values under ``"lognormal"``.
    """
    return interval_of("mean", x, level=level, family=family, joint=joint, side=side, unit=unit)


def prediction_interval(
    x: ArrayLike | Moments,
    *,
    level: float = 0.99,
    family: Family = "normal",
    joint: Joint = "marginal",
    side: Side = "both",
    unit: str = "",
) -> Interval:
    """Work out the interval of the next user, kind ``"user"``: mean ± t·SD·√(1 + 1/n).

    Parameters
    ----------
    x, level, family, joint, side, unit
        As `t_interval`.

    Returns
    -------
    Interval
        Fields of shape (...), in the unit of `x`.

    Raises
    ------
    UsageError, RefusalError
        As `t_interval`.
    """
    return interval_of("user", x, level=level, family=family, joint=joint, side=side, unit=unit)


def tolerance_interval(
    x: ArrayLike | Moments,
    *,
    level: float = 0.99,
    share: float | None = None,
    confidence: float = 0.95,
    family: Family = "normal",
    joint: Joint = "marginal",
    side: Side = "both",
    unit: str = "",
) -> Interval:
    """Work out the interval of at least `share` of all users, kind ``"share"``.

    Parameters
    ----------
    x, level, family, side, unit
        As `t_interval`.
    share : float, optional
        Share of all users; `level` where not given.
    confidence : float
        Confidence in that share.
    joint : {"marginal", "bonferroni"}
        ``"bonferroni"``: both share and confidence at half their tails, so that k and b hold
        together.

    Returns
    -------
    Interval
        Fields of shape (...), in the unit of `x`; the half-width is that of `tolerance_factor`.

    Raises
    ------
    UsageError, RefusalError
        As `t_interval`; a share or confidence outside (0, 1).
    """
    return interval_of(
        "share", x, level=level, share=share, confidence=confidence,
        family=family, joint=joint, side=side, unit=unit,
    )  # fmt: skip


def interval_of(
    kind: Kind,
    x: ArrayLike | Moments,
    *,
    level: float = 0.99,
    share: float | None = None,
    confidence: float = 0.95,
    family: Family = "normal",
    joint: Joint = "marginal",
    side: Side = "both",
    unit: str = "",
) -> Interval:
    """Interval of any kind; options as in `t_interval` and `tolerance_interval`."""
    check_option("joint", joint, ("marginal", "bonferroni"))
    check_option("side", side, ("both", "lower", "upper"))
    tail = tail_of(level, joint=joint) / (2.0 if side == "both" else 1.0)
    moments, approximate = family_moments(x, family)
    n = np.asarray(moments.n)
    t = -np.asarray(special.stdtrit(n - 1.0, tail), dtype=float)
    expected_share = None
    if kind == "mean":
        factor = t / np.sqrt(n)
        expected_share = plain(_expected_share(t, n, side))
    elif kind == "user":
        factor = t * np.sqrt(1.0 + 1.0 / n)
    else:
        share = level if share is None else share
        beta = tail_of(share, "share", joint=joint)
        alpha = tail_of(confidence, "confidence", joint=joint)
        factor = np.asarray(
            factor_of_tails(n, beta, alpha, sided="two" if side == "both" else "one")
        )
    mean, half_width = np.asarray(moments.mean), factor * np.asarray(moments.sd)
    lower = np.full_like(mean, -np.inf) if side == "upper" else mean - half_width
    upper = np.full_like(mean, np.inf) if side == "lower" else mean + half_width
    ends = np.stack([lower, mean, upper])
    if family == "lognormal":
        with np.errstate(over="ignore"):  # a limit beyond the largest double is infinite
            ends = np.exp(ends)
    lower, estimate, upper = ends
    return Interval(
        kind=kind,
        method="classical",
        family=family,
        level=level,
        lower=plain(lower),
        upper=plain(upper),
        estimate=plain(estimate),
        n=moments.n,
        mean=moments.mean,
        sd=moments.sd,
        factor=plain(np.broadcast_to(factor, mean.shape)),
        share=share if kind == "share" else None,
        confidence=confidence if kind == "share" else None,
        joint=joint,
        side=side,
        expected_share=expected_share,
        repeats=moments.repeats,
        approximate=approximate,
        unit=unit,
    )


def family_moments(x: ArrayLike | Moments, family: Family) -> tuple[Moments, bool]:
    """Return moments that scatter, on the scale of a family, and whether they are moment-matched."""
    check_option("family", family, ("normal", "lognormal"))
    if isinstance(x, Moments):
        moments, approximate = x.on_scale(family), family == "lognormal" and x.scale == "linear"
    else:
        moments, approximate = Moments.from_values(x, log=family == "lognormal"), False
    still = np.asarray(moments.sd) == 0.0
    if still.any():
        where = "" if still.ndim == 0 else f" (first at index {np.argwhere(still)[0].tolist()})"
        raise RefusalError(
            f"All subjects gave the same value{where}: with no scatter there is no interval.",
            hint=(
                "Check whether the adjustment was too coarse to show differences between subjects."
            ),
        )
    return moments, approximate


def bias(
    x: ArrayLike | Moments, reference: ArrayLike, *, level: float = 0.99, family: Family = "normal"
) -> Ratio:
    """Compare the average user with the reference, as a ratio.

    Parameters
    ----------
    x : array_like or Moments
        One value per subject, shape (..., n), or moments of shape (...).
    reference : array_like
        What was shown, in the unit of `x`; positive; a shape that broadcasts with (...).
    level, family
        As `t_interval`.

    Returns
    -------
    Ratio
        With estimate, lower and upper of shape (...), 1 being no bias.

    Raises
    ------
    UsageError, RefusalError
        As `t_interval`; a reference that is not positive has no ratio.
    """
    mean = t_interval(x, level=level, family=family)
    ends = np.stack([np.asarray(end) for end in (mean.estimate, mean.lower, mean.upper)])
    return _ratio("bias", ends, reference, level, family, mean.n)


def weber_fraction(x: ArrayLike | Moments, reference: ArrayLike, *, level: float = 0.99) -> Ratio:
    """Work out SD over the reference, between users; its interval is exact, by χ².

    Parameters
    ----------
    x, reference, level
        As `bias`.

    Returns
    -------
    Ratio
        Of shape (...), family ``"normal"``.

    Raises
    ------
    UsageError, RefusalError
        As `bias`.
    """
    moments, _ = family_moments(x, "normal")
    tail, half = tail_of(level) / 2.0, (np.asarray(moments.n) - 1.0) / 2.0
    low, high = (
        half / quantile(half, tail) for quantile in (special.gammainccinv, special.gammaincinv)
    )
    ends = np.asarray(moments.sd) * np.sqrt(np.stack([np.ones_like(low), low, high]))
    return _ratio("weber", ends, reference, level, "normal", moments.n)


def _expected_share(
    t: NDArray[np.float64], n: NDArray[np.int64], side: Side
) -> NDArray[np.float64]:
    """Share of users that mean ± t·SD/√n holds on average over studies."""
    # The next user differs from the mean by SD·√(1 + 1/n) times a t.
    within = t / np.sqrt(n + 1.0)
    if side != "both":
        return np.asarray(special.stdtr(n - 1.0, within), dtype=float)
    # One less twice the tail would lose what a small t holds.
    return np.asarray(
        special.betainc(0.5, (n - 1.0) / 2.0, within**2 / (n - 1.0 + within**2)), dtype=float
    )


def _ratio(
    quantity: Literal["bias", "weber"],
    ends: NDArray[np.float64],
    reference: ArrayLike,
    level: float,
    family: Family,
    n: int | NDArray[np.int64],
) -> Ratio:
    shown = finite_values(reference, name="references")
    if (shown <= 0.0).any():
        raise RefusalError(
            "A reference of zero or below has no ratio.",
            value=float(shown.min()),
            hint="Leave this parameter of this environment out.",
        )
    fitted("References and samples", shown, ends[0])
    estimate, lower, upper = (plain(end / shown) for end in ends)
    return Ratio(
        quantity=quantity,
        estimate=estimate,
        lower=lower,
        upper=upper,
        level=level,
        family=family,
        n=n,
    )


@dataclass(frozen=True)
class SpreadRatio:
    """The SD between subjects in the second condition over that in the first."""

    estimate: float
    lower: float
    upper: float
    p_value: float  # Of equal SDs, two-sided
    n: int  # Subjects


def paired_contrast(
    difference: NDArray[np.float64], kind: Kind, *, level: float, share: float, confidence: float
) -> tuple[Interval, float]:
    """Interval of subjects' differences (n,), and the p-value of a mean of zero by the paired t-test."""
    moments = Moments.from_values(difference)
    if moments.sd == 0.0:
        raise RefusalError("all subjects differ alike: with no scatter there is no interval.")
    interval = interval_of(kind, moments, level=level, share=share, confidence=confidence)
    n = len(difference)
    t = abs(float(moments.mean)) / float(moments.sd) * np.sqrt(n)
    return interval, 2.0 * float(special.stdtr(n - 1, -t))


def spread_ratio(
    first: NDArray[np.float64], second: NDArray[np.float64], *, level: float
) -> SpreadRatio:
    """Ratio of SDs of pairs (n,), by Pitman and Morgan.

    Sum and difference of two variables are uncorrelated where their variances are equal. The
    interval holds the ratios that the test of this correlation, n - 2 degrees of freedom, does not
    reject.
    """
    n = len(first)
    if n < 3:
        raise RefusalError("the spread of fewer than three pairs cannot be compared.")
    means, sds = zip(*(mean_and_sd(values) for values in (first, second)), strict=True)
    if min(sds) == 0.0:
        raise RefusalError("all subjects adjusted alike: with no scatter there is no ratio.")
    a, b = (
        (values - mean) / sd for values, mean, sd in zip((first, second), means, sds, strict=True)
    )
    # (1 - r)(1 + r) of the SDs of difference and sum: 1 - r² would cancel.
    apart, together = (float(mean_and_sd(values)[1]) for values in (b - a, b + a))
    if min(apart, together) < _PROPORTION:
        raise RefusalError(
            "the values of both conditions move in proportion: their ratio has no interval."
        )
    rest = apart * together / 2.0  # sqrt(1 - r²)
    ratio = float(sds[1] / sds[0])
    half = rest * -float(special.stdtrit(n - 2, tail_of(level) / 2.0)) / np.sqrt(n - 2)
    # The roots of ratio² (k ± sqrt(k² - 1)), k = 1 + 2 half²; the smaller is the reciprocal of the
    # larger.
    wide = half + np.hypot(half, 1.0)
    t = (ratio - 1.0 / ratio) * np.sqrt(n - 2) / (2.0 * rest)
    p_value = 2.0 * float(special.stdtr(n - 2, -abs(t)))
    return SpreadRatio(ratio, float(ratio / wide), float(ratio * wide), p_value, n)
