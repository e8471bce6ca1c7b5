"""Say in one sentence, without statistics, what an interval covers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from percept.inference.intervals import Interval

_AVERAGE = {
    "normal": "the average user's value",
    "lognormal": "the typical user's value (the geometric mean of all users)",
    "free": "the middle user's value (half of all users lie above it)",
}
_WHERE = {"both": "between the limits", "lower": "above the lower limit", "upper": "below the upper limit"}


def percent(probability: ArrayLike, digits: int = 15) -> str:
    """Write a probability as a percentage, an array as its range."""
    values = np.asarray(probability, dtype=float)
    low, high = (_percentage(float(v), digits) for v in (values.min(), values.max()))
    return f"{low} %" if low == high else f"{low} % to {high} %"


def coverage_sentence(interval: Interval) -> str:
    """Build the sentence an interval carries.

    Parameters
    ----------
    interval : Interval
        Of any kind, method and family.

    Returns
    -------
    str
        One sentence, the same for every environment of a vectorised interval.
    """
    claim = _claim(interval)
    clauses = [f"{claim} ({', '.join(_basis(interval))})"]
    if interval.expected_share is not None:
        clauses.append(f"it is not a range of users, of whom it holds an expected {_holds(interval)}")
    if interval.joint == "bonferroni":
        clauses.append("widened so that the statements on stiffness and damping are true together")
    if interval.approximate:
        clauses.append(
            "approximate, as a published mean and SD were turned into lognormal ones by moment matching"
        )
    return "; ".join(clauses) + "."


def _claim(interval: Interval) -> str:
    where = _WHERE[interval.side]
    if interval.kind == "share":
        assert interval.share is not None
        assert interval.confidence is not None
        sure = _assurance(interval, interval.confidence)
        return f"At least {percent(interval.share)} of all users lie {where}, with {sure}"
    sure = _assurance(interval, interval.level)
    if interval.kind == "user":
        return f"The next user's value lies {where}, with {sure}"
    average = _AVERAGE[interval.family]
    return f"{average[0].upper()}{average[1:]} lies {where}, with {sure}"


def _assurance(interval: Interval, level: float) -> str:
    if interval.method == "bayesian":
        return f"{percent(level)} probability under the model and its priors"
    if interval.attained is not None:
        return f"at least {percent(level)} confidence whatever the distribution"
    return f"{percent(level)} confidence"


def _basis(interval: Interval) -> list[str]:
    n = np.asarray(interval.n)
    low, high = int(n.min()), int(n.max())
    users = f"{low} users" if low == high else f"{low} to {high} users"
    parts = [f"from {users}"]
    if interval.repeats is False:
        parts.append("one trial each, trial noise included")
    elif interval.repeats and interval.method == "classical":
        parts.append("each the mean of repeated trials, the rest of the trial noise included")
    elif interval.repeats and interval.kind != "mean":
        parts.append("trial noise left out")
    if interval.unit:
        parts.append(f"in {interval.unit}")
    return parts


def _holds(interval: Interval) -> str:
    assert interval.expected_share is not None
    return percent(interval.expected_share, digits=3)


def _percentage(probability: float, digits: int) -> str:
    texts = (f"{100.0 * probability:.{count}g}" for count in range(digits, 18))
    return next(text for text in texts if text != "100" or probability == 1.0)
