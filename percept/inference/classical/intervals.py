"""The three kinds of interval: of the average user, of the next one, and of a share of all users.

An interval of a share is mean ± c·SD. The two-sided factor c solves, with ν = n − 1 and
Φ(x + r) − Φ(x − r) = P defining r(x),

    ∫₀^∞ P(χ²_ν < ν r(x)²/c²) · 2 √(n/2π) exp(−n x²/2) dx = 1 − γ.

The left side is the chance that the interval holds too little. Through the lower tail of χ² it is a
sum of positive terms as small as 1 − γ itself, so nothing cancels however close γ is to one. P
enters through its tail 1 − P likewise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import (
    Moments,
    check_option,
    fitted,
    plain,
    subject_counts,
    tail_of,
    tails,
)
from percept.inference.record import Family, FloatOrArray, Interval, Joint, Kind

Array = NDArray[np.float64]
#: Nodes of the integral: they keep 13 digits from n = 2 to 1e6.
_NODES = 200
#: What lies beyond the last node, of 1 − γ.
_NEGLIGIBLE = 1e-17
#: Requests kept: environments, families and studies ask for the same few.
_REMEMBERED = 4096
#: Most steps of Newton's method, which needs some ten, and its relative accuracy.
_NEWTON_STEPS = 60
_ACCURACY = 1e-15

_legendre = cache(np.polynomial.legendre.leggauss)


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
    moments, approximate = _family_moments(x, claim.family)
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


def _family_moments(x: ArrayLike | Moments, family: Family) -> tuple[Moments, bool]:
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


def tolerance_factor(
    n: ArrayLike,
    share: ArrayLike,
    confidence: ArrayLike,
) -> FloatOrArray:
    """Work out the exact factor of a normal tolerance interval.

    Mean ± factor·SD holds at least `share` of the population with `confidence`.

    Parameters
    ----------
    n : int or array_like of int
        Subjects, at least 2.
    share : float or array_like
        Share P of the population; 0 to 1, exclusive.
    confidence : float or array_like
        Confidence γ; 0 to 1, exclusive.

    Returns
    -------
    float or ndarray
        Broadcast shape; a float where every argument is a single number.

    Raises
    ------
    UsageError
        A share or confidence outside (0, 1), an n that is not whole, shapes that do not fit.
    RefusalError
        Fewer than 2 subjects.

    References
    ----------
    ISO 16269-6:2014; Krishnamoorthy and Mathew, Statistical Tolerance Regions, sections 2.2 and
    2.3.
    """
    beta = tails(share, "share")
    alpha = tails(confidence, "confidence")
    return factor_of_tails(subject_counts(n), beta, alpha)


def factor_of_tails(n: ArrayLike, beta: ArrayLike, alpha: ArrayLike) -> FloatOrArray:
    """Factor from the tails beta = 1 − P and alpha = 1 − γ, which broadcast with n."""
    arrays = [np.asarray(argument) for argument in (n, beta, alpha)]
    factors = np.vectorize(_factor, otypes=[float])
    return plain(factors(*fitted("n, share and confidence", *arrays)))


@lru_cache(_REMEMBERED)
def _factor(
    n: float,
    beta: float,
    alpha: float,
) -> float:
    """Factor for n subjects."""
    half_df = (n - 1.0) / 2.0
    root_n = math.sqrt(n)
    node, weight = _legendre(_NODES)
    half_edge = -special.ndtri(alpha * _NEGLIGIBLE) / 2.0
    z = half_edge * (1.0 + node)
    density = np.sqrt(2.0 / np.pi) * np.exp(-0.5 * z**2)
    weight = half_edge * weight * density
    radius = _content_radius(z / root_n, beta)
    log_gamma = special.gammaln(half_df)

    def miss_probability(log_factor: float) -> tuple[float, float]:
        x = half_df * (radius * math.exp(-log_factor)) ** 2
        with np.errstate(under="ignore"):
            density = np.exp(half_df * np.log(x) - x - log_gamma)  # times x
        probability = weight @ special.gammainc(half_df, x)
        return float(probability), -2.0 * float(weight @ density)

    # Enough: less is held only if the mean is farther off than alpha/4 a side, or the SD below its
    # alpha/2.
    farthest_mean = -special.ndtri(alpha / 4.0) / root_n
    least_sd = math.sqrt(special.gammaincinv(half_df, alpha / 2.0) / half_df)
    start = math.log(_content_radius(farthest_mean, beta) / least_sd)
    return math.exp(_newton(miss_probability, alpha, start))


def _content_radius(x: FloatOrArray, beta: float) -> FloatOrArray:
    """Solve Q(r + x) + Q(r − x) = beta for r, Q the upper normal tail."""

    def outside(r: FloatOrArray) -> tuple[FloatOrArray, FloatOrArray]:
        probability = special.ndtr(-(r + x)) + special.ndtr(x - r)
        near = np.exp(-0.5 * (r - x) ** 2)
        far = np.exp(-0.5 * (r + x) ** 2)
        return probability, -(far + near) / math.sqrt(2.0 * math.pi)

    start = x - special.ndtri(beta / 2.0)  # exact at x = 0, too large elsewhere
    return _newton(outside, beta, start)


def _newton(
    probability: Callable[..., tuple[FloatOrArray, FloatOrArray]],
    target: float,
    start: FloatOrArray,
) -> FloatOrArray:
    """Solve log probability = log target from above.

    The logarithms are concave and fall, so no step passes the root. `scipy.optimize` takes brackets
    that rounding spoils at large n, several times the time, and 0.3 s to import.
    """
    x = start
    for _ in range(_NEWTON_STEPS):
        value, slope = probability(x)
        step = np.log(value / target) * value / slope
        x = x - step
        rounding = _ACCURACY * np.maximum(1.0, np.abs(x))
        if np.all(np.abs(step) <= rounding):
            break
    return x
