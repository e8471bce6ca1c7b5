"""Adjustments at the ends of a control: they say only that the setting meant lies beyond.

A scene states the ends, `limits` of a quantity, in its unit. What lies at them or beyond is left
out, counted per environment and logged. The intervals then describe the other adjustments only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import counted
from percept.sessions.quantities import Quantity
from percept.sessions.records import Exclusion, Notice, Places, clip

__all__ = ["Ends", "by_environment", "without_ends"]

#: Environments that a sentence lists.
_LISTED = 8
_Mask = npt.NDArray[np.bool_]


@dataclass
class Ends:
    """Trials without the adjustments at the ends of their controls, and what is said of these."""

    table: pd.DataFrame
    exclusions: list[Exclusion] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    #: Rows whose adjustment is left out, with its quantity as `parameter`.
    left_out: list[pd.DataFrame] = field(default_factory=list)


def without_ends(table: pd.DataFrame, quantities: Iterable[Quantity], place: Places) -> Ends:
    """Leave out adjustments at the limits of their quantities; a row without any goes.

    Parameters
    ----------
    table : DataFrame
        Trials with ids and adjustments in the quantities' units.
    quantities : iterable of Quantity
        Those that the trials have.
    place : callable
        From a row's position to its file and line.

    Returns
    -------
    Ends
    """
    ends = Ends(table)
    adjusted = []
    for quantity in quantities:
        column = f"{quantity.name}_adj"
        adjusted.append(column)
        if quantity.limits is None:
            continue
        lowest, highest = quantity.limits
        values = ends.table[column].to_numpy()
        at_end = (values <= lowest) | (values >= highest)
        if at_end.any():
            _leave_out(ends, quantity, at_end, place)
    if ends.counts:
        ends.table = ends.table.dropna(subset=adjusted, how="all").reset_index(drop=True)
    return ends


def _leave_out(
    ends: Ends, quantity: Quantity, at_end: npt.NDArray[np.bool_], place: Places
) -> None:
    """Blank the adjustments at the ends of a control, log each and say how many there are."""
    why = f"{quantity.label} at a limit of its control"
    rows = ends.table[at_end]
    positions = np.flatnonzero(at_end).tolist()
    ids = zip(positions, rows["subject"], rows["environment"], strict=True)
    for position, subject, environment in ids:
        what = f"{quantity.name} in environment {environment}"
        exclusion = Exclusion(subject, what, why, **place(position))
        ends.exclusions.append(exclusion)
    column = f"{quantity.name}_adj"
    known = int(ends.table[column].notna().sum())
    text = (
        f"{counted(len(rows), 'value')} of {known} at the limits of the control,"
        f" {quantity.amounts(quantity.limits or ())}, are left out:"
        f" {by_environment(ends.table, at_end)}. Every interval describes the other values only"
    )
    ends.notices.append(Notice(text, column=column))
    ends.counts[f"left out: {why}"] = len(rows)
    ends.left_out.append(rows.assign(parameter=quantity.name))
    ends.table = ends.table.assign(**{column: ends.table[column].mask(at_end)})


def by_environment(table: pd.DataFrame, chosen: _Mask) -> str:
    """Count chosen trials per environment, such as "5 of 12 in 'hard' (3 subjects)"."""
    trials = table["environment"].value_counts()
    texts = []
    for name, rows in table[chosen].groupby("environment", sort=False):
        subjects = counted(rows["subject"].nunique(), "subject")
        texts.append(f"{len(rows)} of {trials[name]} in {clip(str(name))!r} ({subjects})")
    more = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return ", ".join(texts[:_LISTED]) + more
