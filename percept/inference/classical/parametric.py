"""The three kinds of interval for normal and lognormal users: Eq. 15, and the two it is mistaken for."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.classical.claims import Claim
from percept.inference.classical.levels import OneMinus
from percept.inference.classical.moments import Moments, plain
from percept.inference.classical.quantiles import t_upper, t_within
from percept.inference.classical.tolerance import tolerance_factor
from percept.inference.intervals import Family, FloatOrArray, Interval, Kind

Array: TypeAlias = NDArray[np.float64]


def family_moments(x: ArrayLike | Moments, family: Family, *, axis: int = -1) -> tuple[Moments, bool]:
    """Return moments on the scale of a family, and whether they are moment-matched."""
    if isinstance(x, Moments):
        moments, approximate = x.on_scale(family), family == "lognormal" and x.scale == "linear"
    else:
        moments, approximate = Moments.from_values(x, log=family == "lognormal", axis=axis), False
    still = np.asarray(moments.sd) == 0.0
    if still.any():
        where = "" if still.ndim == 0 else f" (first at index {np.argwhere(still)[0].tolist()})"
        raise RefusalError(
            f"All subjects gave the same value{where}: with no scatter there is no interval.",
            hint="Check whether the adjustment was too coarse to show differences between subjects.",
        )
    return moments, approximate


def mean_interval(x: ArrayLike | Moments, claim: Claim, *, axis: int = -1) -> Interval:
    """Work out Eq. 15: mean ± t·SD/√n."""
    moments, approximate = family_moments(x, claim.family, axis=axis)
    n = np.asarray(moments.n)
    t = t_upper(claim.tail() / claim.tails, n - 1)
    # the next user differs from the mean by SD·√(1 + 1/n) times a t; against t·SD/√n that is t/√(n + 1)
    within = np.asarray(t) / np.sqrt(n + 1.0)
    held = t_within(within, n - 1) if claim.tails == 2 else np.asarray(special.stdtr(n - 1.0, within))
    return _interval("mean", moments, t / np.sqrt(n), claim, approximate, expected_share=plain(held))


def user_interval(x: ArrayLike | Moments, claim: Claim, *, axis: int = -1) -> Interval:
    """Work out the prediction interval: mean ± t·SD·√(1 + 1/n)."""
    moments, approximate = family_moments(x, claim.family, axis=axis)
    refuse_weights(moments)
    n = np.asarray(moments.n)
    factor = t_upper(claim.tail() / claim.tails, n - 1) * np.sqrt(1.0 + 1.0 / n)
    return _interval("user", moments, factor, claim, approximate)


def share_interval(x: ArrayLike | Moments, claim: Claim, *, axis: int = -1) -> Interval:
    """Work out the tolerance interval: mean ± factor·SD."""
    moments, approximate = family_moments(x, claim.family, axis=axis)
    refuse_weights(moments)
    factor = tolerance_factor(
        moments.n,
        OneMinus(claim.tail("share")),
        OneMinus(claim.tail("confidence")),
        sided="two" if claim.tails == 2 else "one",
    )
    return _interval("share", moments, np.asarray(factor), claim, approximate)


def _interval(
    kind: Kind,
    moments: Moments,
    factor: Array,
    claim: Claim,
    approximate: bool,
    *,
    expected_share: FloatOrArray | None = None,
) -> Interval:
    mean, sd = np.asarray(moments.mean), np.asarray(moments.sd)
    lower, upper, estimate = mean - factor * sd, mean + factor * sd, mean
    if claim.side == "lower":
        upper = np.full_like(upper, np.inf)
    elif claim.side == "upper":
        lower = np.full_like(lower, -np.inf)
    if claim.family == "lognormal":
        with np.errstate(over="ignore"):  # a limit beyond the largest double is infinite
            lower, upper, estimate = np.exp(lower), np.exp(upper), np.exp(estimate)
    return Interval(
        kind=kind,
        method="classical",
        family=claim.family,
        level=float(claim.level),
        lower=plain(lower),
        upper=plain(upper),
        estimate=plain(estimate),
        n=moments.n,
        mean=moments.mean,
        sd=moments.sd,
        factor=plain(np.broadcast_to(factor, mean.shape)),
        share=None if claim.share is None else float(claim.share),
        confidence=None if claim.confidence is None else float(claim.confidence),
        joint=claim.joint,
        side=claim.side,
        expected_share=expected_share,
        repeats=moments.repeats,
        approximate=approximate,
        unit=claim.unit,
    )


def refuse_weights(moments: Moments) -> None:
    """Refuse moments of a weighted mean."""
    if moments.weighted:
        raise UsageError(
            "A weighted mean says nothing on single users.",
            hint="Use the unweighted means per subject for kinds 'user' and 'share'.",
        )
