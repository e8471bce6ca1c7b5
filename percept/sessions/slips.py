"""Adjustments that look mistyped: a digit too many or too few, or far from all beside them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
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
#: An environment with more of such values has wide scatter, and no slips.
_MOST_LOOKED_AT = 1_000
#: SDs of the other trials beyond which a value is no ordinary one: one in 16,000 of normal ones.
_FAR = 4.0
#: SD in decades that subjects usually have: a factor of 1.4.
_USUAL_SD = 0.15
#: SDs between the quartiles of normal values.
_QUARTILES = 1.349
#: Degrees of freedom that the scatter elsewhere counts for beside that of the environment itself.
_ELSEWHERE = 3.0


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
        trials = table[table[f"{name}_adj"] > 0]
        reference = trials[f"{name}_ref"]
        shown_at = np.log10(reference.where(reference > 0))
        values = trials[f"{name}_adj"]
        found = dict(_mistyped(trials, np.log10(values), shown_at))
        for index in sorted(found):
            environment = trials["environment"][index]
            text = (
                f"{name} = {values[index]:.6g} of subject {shown([trials['subject'][index]])},"
                f" where the other trials of {shown([environment])} have a median of"
                f" {values[found[index]].median():.6g}"
            )
            yield Slip(index, environment, name, text)


def _mistyped(
    trials: pd.DataFrame, decades: pd.Series[float], shown_at: pd.Series[float]
) -> Iterator[tuple[Any, pd.Index]]:
    """Find rows that a digit explains, or nothing does; with the rows beside each."""
    grouped = decades.groupby(trials["environment"], sort=False)
    off = decades - grouped.transform("median")
    sds = (grouped.quantile(0.75) - grouped.quantile(0.25)) / _QUARTILES
    environment: Any
    for environment, own in grouped:
        candidates = own[off[own.index].abs() > _LOOKED_AT]
        if len(own) < 2 or len(candidates) > _MOST_LOOKED_AT:
            continue
        elsewhere = sds.drop(environment).median() if len(sds) > 1 else _USUAL_SD
        subjects = trials["subject"][own.index].nunique()
        index: Any
        for index, value in candidates.items():
            others = own.drop(index)
            low, median, high = np.quantile(others, (0.25, 0.5, 0.75))
            distance = abs(value - median)
            is_gross = distance > _GROSS and subjects >= _FEWEST
            if not (is_gross or abs(distance - 1.0) <= _NEAR_TEN):
                continue
            # Of two trials either may be the slip: it is the one farther from what was shown.
            reference = shown_at[index]
            if len(others) == 1 and not abs(value - reference) > abs(median - reference):
                continue
            freedom = len(others) - 1
            own_sd = (high - low) / _QUARTILES
            variance = _ELSEWHERE * elsewhere**2 + freedom * own_sd**2
            variance /= _ELSEWHERE + freedom
            if distance <= _FAR * np.sqrt(variance * (1.0 + 1.0 / len(others))):
                continue
            # A subject who is as far off in other trials has a habit, or another unit.
            of_subject = off[trials["subject"] == trials["subject"][index]].drop(index)
            if not abs(value - median - of_subject.median()) < 1.0 - _NEAR_TEN:
                yield index, others.index
