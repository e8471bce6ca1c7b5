"""The three kinds of interval, as asked for by an analyst."""

from __future__ import annotations

from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.inference.classical import parametric
from percept.inference.classical.claims import Claim
from percept.inference.classical.free import free_interval
from percept.inference.classical.levels import Level
from percept.inference.classical.moments import Moments
from percept.inference.intervals import Family, Interval, Joint, Kind, Side


def t_interval(
    x: ArrayLike | Moments,
    *,
    level: Level = 0.99,
    family: Family = "normal",
    joint: Joint = "marginal",
    side: Side = "both",
    axis: int = -1,
    unit: str = "",
) -> Interval:
    """Work out the interval of the average user, kind ``"mean"`` (Eq. 15).

    The paper reads it as "99 percent of users". It is a statement on their mean; how many users it holds on
    average is in `expected_share` of the result (.647 at n = 10 and level .99) and in its sentence.

    Parameters
    ----------
    x : array_like or Moments
        One value per subject, shape (..., n) with `axis` = −1, any unit; or mean, SD and n, or published
        limits, as `Moments`.
    level : float or OneMinus
        Confidence level; 0 to 1, exclusive.
    family : {"normal", "lognormal", "free"}
        Distribution between users. Under ``"lognormal"`` everything happens on the logarithms and the mean
        becomes the typical (geometric-mean) user; linear `Moments` are turned into lognormal ones by moment
        matching. ``"free"`` assumes none: the interval of the median from order statistics; needs values.
    joint : {"marginal", "bonferroni"}
        ``"bonferroni"``: level 1 − (1 − level)/2, so that the intervals of k and b hold together.
    side : {"both", "lower", "upper"}
        Both limits, equal-tailed, or one.
    axis : int
        Which axis of the values runs over subjects.
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
        Fewer than 2 subjects, no scatter, zero or negative values under ``"lognormal"``, too few subjects for
        ``"free"``.
    """
    claim = Claim(level, family, joint, side, unit)
    if family == "free":
        return free_interval("mean", x, claim, axis=axis)
    return parametric.mean_interval(x, claim, axis=axis)


def prediction_interval(
    x: ArrayLike | Moments,
    *,
    level: Level = 0.99,
    family: Family = "normal",
    joint: Joint = "marginal",
    side: Side = "both",
    axis: int = -1,
    unit: str = "",
) -> Interval:
    """Work out the interval of the next user, kind ``"user"``: mean ± t·SD·√(1 + 1/n).

    Parameters
    ----------
    x, level, family, joint, side, axis, unit
        As `t_interval`.

    Returns
    -------
    Interval
        Fields of shape (...), in the unit of `x`.

    Raises
    ------
    UsageError, RefusalError
        As `t_interval`; weighted moments.
    """
    claim = Claim(level, family, joint, side, unit)
    if family == "free":
        return free_interval("user", x, claim, axis=axis)
    return parametric.user_interval(x, claim, axis=axis)


def tolerance_interval(
    x: ArrayLike | Moments,
    *,
    level: Level = 0.99,
    share: Level | None = None,
    confidence: Level = 0.95,
    family: Family = "normal",
    joint: Joint = "marginal",
    side: Side = "both",
    axis: int = -1,
    unit: str = "",
) -> Interval:
    """Work out the interval of at least `share` of all users, kind ``"share"``.

    Parameters
    ----------
    x, level, family, side, axis, unit
        As `t_interval`.
    share : float or OneMinus, optional
        Share of all users; `level` where not given.
    confidence : float or OneMinus
        Confidence in that share.
    joint : {"marginal", "bonferroni"}
        ``"bonferroni"``: both share and confidence at half their tails, so that k and b hold together.

    Returns
    -------
    Interval
        Fields of shape (...), in the unit of `x`.

    Raises
    ------
    UsageError, RefusalError
        As `prediction_interval`; a share or confidence outside (0, 1).
    """
    share = level if share is None else share
    claim = Claim(level, family, joint, side, unit, share, confidence)
    if family == "free":
        return free_interval("share", x, claim, axis=axis)
    return parametric.share_interval(x, claim, axis=axis)


def interval_of(
    kind: Kind,
    x: ArrayLike | Moments,
    *,
    level: Level = 0.99,
    share: Level | None = None,
    confidence: Level = 0.95,
    family: Family = "normal",
    joint: Joint = "marginal",
    unit: str = "",
) -> Interval:
    """Work out the interval of a kind."""
    if kind == "mean":
        return t_interval(x, level=level, family=family, joint=joint, unit=unit)
    if kind == "user":
        return prediction_interval(x, level=level, family=family, joint=joint, unit=unit)
    if kind == "share":
        return tolerance_interval(
            x, level=level, share=share, confidence=confidence, family=family, joint=joint, unit=unit
        )
    raise UsageError('kind must be "mean", "user" or "share".', value=kind)
