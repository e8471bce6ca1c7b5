"""The three kinds of interval, and the bias as a ratio to the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import (
    Moments,
    check_option,
    plain,
    tail_of,
)
from percept.inference.classical.tolerance import factor_of_tails
from percept.inference.record import Family, Interval, Joint, Kind

__all__ = [
    "Claim",
    "family_moments",
    "interval_of",
    "prediction_interval",
    "t_interval",
    "tolerance_interval",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What an interval states; fields as in `tolerance_interval`."""

    level: float = 0.99
    share: float | None = None
    confidence: float = 0.95
    family: Family = "normal"
    joint: Joint = "marginal"
    unit: str = ""


def t_interval(
    x: ArrayLike | Moments,
    *,
    level: float = 0.99,
    family: Family = "normal",
    joint: Joint = "marginal",
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
    claim = Claim(level=level, family=family, joint=joint, unit=unit)
    return interval_of("mean", x, claim)


def prediction_interval(
    x: ArrayLike | Moments,
    *,
    level: float = 0.99,
    family: Family = "normal",
    joint: Joint = "marginal",
    unit: str = "",
) -> Interval:
    """Work out the interval of the next user, kind ``"user"``: mean ± t·SD·√(1 + 1/n).

    Parameters
    ----------
    x, level, family, joint, unit
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
    claim = Claim(level=level, family=family, joint=joint, unit=unit)
    return interval_of("user", x, claim)


def tolerance_interval(
    x: ArrayLike | Moments,
    *,
    level: float = 0.99,
    share: float | None = None,
    confidence: float = 0.95,
    family: Family = "normal",
    joint: Joint = "marginal",
    unit: str = "",
) -> Interval:
    """Work out the interval of at least `share` of all users, kind ``"share"``.

    Parameters
    ----------
    x, level, family, unit
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
    claim = Claim(
        level=level,
        share=share,
        confidence=confidence,
        family=family,
        joint=joint,
        unit=unit,
    )
    return interval_of("share", x, claim)


def interval_of(
    kind: Kind,
    x: ArrayLike | Moments,
    claim: Claim,
) -> Interval:
    """Work out an interval of any kind.

    Parameters
    ----------
    kind : {"mean", "user", "share"}
        What is covered: the average user, the next user, or at least a share of all users.
    x : array_like or Moments
        As `t_interval`.
    claim : Claim
        What the interval states.

    Returns
    -------
    Interval
        Fields of shape (...), in the unit of `x`.

    Raises
    ------
    UsageError, RefusalError
        As `tolerance_interval`.
    """
    check_option("joint", claim.joint, ("marginal", "bonferroni"))
    moments, approximate = family_moments(x, claim.family)
    mean = np.asarray(moments.mean)
    n = np.asarray(moments.n)
    tail = tail_of(claim.level, joint=claim.joint)
    t = -np.asarray(special.stdtrit(n - 1.0, tail / 2.0), dtype=float)
    share = claim.level if claim.share is None else claim.share
    if kind == "mean":
        factor = t / np.sqrt(n)
    elif kind == "user":
        factor = t * np.sqrt(1.0 + 1.0 / n)
    else:
        outside = tail_of(share, "share", joint=claim.joint)
        miss = tail_of(claim.confidence, "confidence", joint=claim.joint)
        factor = np.asarray(factor_of_tails(n, outside, miss))
    half_width = factor * np.asarray(moments.sd)
    lower = mean - half_width
    upper = mean + half_width
    ends = np.stack([lower, mean, upper])
    if claim.family == "lognormal":
        with np.errstate(over="ignore"):  # a limit beyond the largest double is infinite
            ends = np.exp(ends)
    lower, estimate, upper = ends
    return Interval(
        kind=kind,
        method="classical",
        family=claim.family,
        level=claim.level,
        lower=plain(lower),
        upper=plain(upper),
        estimate=plain(estimate),
        n=moments.n,
        mean=moments.mean,
        sd=moments.sd,
        factor=plain(np.broadcast_to(factor, mean.shape)),
        share=share if kind == "share" else None,
        confidence=claim.confidence if kind == "share" else None,
        joint=claim.joint,
        expected_share=plain(_expected_share(t, n)) if kind == "mean" else None,
        repeats=moments.repeats,
        approximate=approximate,
        unit=claim.unit,
    )


def family_moments(x: ArrayLike | Moments, family: Family) -> tuple[Moments, bool]:
    """Return moments on the scale of a family, and whether they are moment-matched."""
    check_option("family", family, ("normal", "lognormal"))
    log = family == "lognormal"
    approximate = False
    if isinstance(x, Moments):
        approximate = log and x.scale == "linear"
        moments = x.on_scale(family)
    else:
        moments = Moments.from_values(x, log=log)
    still = np.asarray(moments.sd) == 0.0
    if still.any():
        first = np.argwhere(still)[0].tolist()
        where = f" (first at index {first})" if still.ndim else ""
        raise RefusalError(
            f"All subjects gave the same value{where}: with no scatter there is no interval.",
            hint=(
                "Check whether the adjustment was too coarse to show differences between subjects."
            ),
        )
    return moments, approximate


def _expected_share(t: Array, n: NDArray[np.int64]) -> Array:
    """Share of users that mean ± t·SD/√n holds on average over studies."""
    df = n - 1.0
    # The next user differs from the mean by SD·√(1 + 1/n) times a t.
    within = t / np.sqrt(n + 1.0)
    # One less twice the tail would lose what a small t holds.
    fraction = within**2 / (df + within**2)
    return np.asarray(special.betainc(0.5, df / 2.0, fraction), dtype=float)
