"""Adjustments that look mistyped: a digit too many or too few, or far from all beside them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.sessions.quantities import Quantity
from percept.sessions.records import shown

#: Decades from the median of the others (a factor of 30) that are hardly ever a person's.
_GROSS = float(np.log10(30.0))
#: Subjects an environment needs for its median to say anything of one of them.
_FEWEST = 3
#: Decades by which a digit too many or too few may miss ten: within a factor of two.
_NEAR_TEN = float(np.log10(2.0))
#: Decades from the median of all trials at which a value is looked at: of two trials the median
#: lies half-way.
_LOOKED_AT = 0.5 * (1.0 - _NEAR_TEN)
#: SDs of the other trials beyond which a value is no ordinary one: one in 16,000 of normal ones.
_FAR = 4.0
#: SD in decades that subjects usually have: a factor of 1.4.
_USUAL_SD = 0.15
#: SDs between the quartiles of normal values.
_QUARTILES = 1.349
#: Degrees of freedom that the scatter elsewhere counts for beside that of the environment itself.
_ELSEWHERE = 3.0
_Numbers = npt.NDArray[np.float64]
_Rows = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Slip:
    """One adjustment that may be mistyped, and the other trials of its environment."""

    index: int  # Label of its row in the table of trials
    environment: str
    parameter: str
    text: str  # The value, and what lets one doubt it


def slips(table: pd.DataFrame, quantities: Iterable[Quantity]) -> Iterator[Slip]:
    """Find adjustments that look mistyped, by quantity and in the order of the rows.

    Parameters
    ----------
    table : DataFrame
        Trials as `Sessions.table` has them.
    quantities : iterable of Quantity
        What was adjusted.

    Yields
    ------
    Slip
        A value about ten times, or a tenth of, what the others and the same subject's other trials
        lead one to expect; or thirty times off the median of the others, either way.
    """
    for quantity in quantities:
        name = quantity.name
        columns = ["subject", "environment", f"{name}_adj", f"{name}_ref"]
        trials = table[columns].set_axis(["subject", "environment", "value", "reference"], axis=1)
        trials = trials[trials["value"] > 0]
        rows = _mistyped(trials)
        codes = trials.groupby("environment", sort=False).ngroup().to_numpy()
        usual = _of_others(trials["value"].to_numpy(), codes, rows, 0.5)
        one: Any
        for one, median in zip(trials.iloc[rows].itertuples(), usual, strict=True):
            text = (
                f"{name} = {one.value:.6g} of subject {shown([one.subject])}, where the"
                f" other trials of {shown([one.environment])} have a median of {median:.6g}"
            )
            yield Slip(one.Index, one.environment, name, text)


def _mistyped(trials: pd.DataFrame) -> _Rows:
    """Rows that a digit explains, or nothing does, by how far they lie from those beside them."""
    decades = np.log10(trials["value"].to_numpy())
    environments = trials.assign(decades=decades).groupby("environment", sort=False)
    off = decades - environments["decades"].transform("median").to_numpy()
    rows = np.flatnonzero(np.abs(off) > _LOOKED_AT)
    codes = environments.ngroup().to_numpy()
    size = environments["decades"].transform("size").to_numpy()[rows]
    rows = rows[size > 1]
    size = size[size > 1]
    of_row = codes[rows]
    low, typical, high = (_of_others(decades, codes, rows, share) for share in (0.25, 0.5, 0.75))
    distance = np.abs(decades[rows] - typical)
    gross = (distance > _GROSS) & (environments["subject"].nunique().to_numpy()[of_row] >= _FEWEST)
    explained = gross | (np.abs(distance - 1.0) <= _NEAR_TEN)
    # Of two trials either may be the slip: it is the one farther from what was shown.
    reference = trials["reference"].to_numpy()[rows]
    shown_at = np.log10(np.where(reference > 0, reference, np.nan))
    explained &= (size > 2) | (np.abs(decades[rows] - shown_at) > np.abs(typical - shown_at))
    own_sd = (high - low) / _QUARTILES
    elsewhere = _ELSEWHERE * _usual_sds(environments["decades"])[of_row] ** 2
    variance = (elsewhere + (size - 2) * own_sd**2) / (_ELSEWHERE + size - 2)
    far = distance > _FAR * np.sqrt(variance * (1.0 + 1.0 / (size - 1)))
    # A subject who is as far off in other trials has a habit, or another unit.
    subjects = trials.groupby("subject", sort=False).ngroup().to_numpy()
    habit = _of_others(off, subjects, rows, 0.5)
    has_habit = np.abs(decades[rows] - typical - habit) < 1.0 - _NEAR_TEN
    return rows[explained & far & ~has_habit]


def _usual_sds(decades: Any) -> _Numbers:
    """SD that the other environments usually have, in decades, for each environment."""
    sds = ((decades.quantile(0.75) - decades.quantile(0.25)) / _QUARTILES).to_numpy()
    if len(sds) == 1:
        return np.array([_USUAL_SD])
    return _of_others(sds, np.zeros(len(sds)), np.arange(len(sds)), 0.5)


def _of_others(values: _Numbers, groups: npt.NDArray[Any], rows: _Rows, share: float) -> _Numbers:
    """Quantile of the group of each of the rows, without the row; NaN where it is alone."""
    quantiles = np.full(len(rows), np.nan)
    for group in np.unique(groups[rows]):
        own = np.flatnonzero(groups[rows] == group)
        ordered = np.sort(values[groups == group])
        last = len(ordered) - 2
        if last < 0:
            continue
        gap = np.searchsorted(ordered, values[rows[own]])
        below = int(share * last)
        above = min(below + 1, last)
        # Behind the gap each number stands one place later.
        low = ordered[below + (below >= gap)]
        high = ordered[above + (above >= gap)]
        quantiles[own] = low + (share * last - below) * (high - low)
    return quantiles
