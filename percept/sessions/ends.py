"""Adjustments at the ends of a control: they say only that the setting meant lies beyond.

A scene states the ends, `limits` of a quantity, in its unit. What lies at them or beyond is left
out, counted per environment and logged. The intervals then describe the other adjustments only.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions.quantities import Quantity
from percept.sessions.records import Exclusion, Notice, Places, clip
from percept.sessions.tables import Log

#: Environments that a sentence lists.
_LISTED = 8
_Mask = npt.NDArray[np.bool_]


def without_ends(table: pd.DataFrame, quantities: Iterable[Quantity], log: Log) -> pd.DataFrame:
    """Leave out adjustments at the limits of their quantities; a row without any goes.

    Parameters
    ----------
    table : DataFrame
        Trials with ids and adjustments in the quantities' units.
    quantities : iterable of Quantity
        Those that the trials have.
    log : Log
        Takes up what is left out.

    Returns
    -------
    DataFrame

    Raises
    ------
    UsageError
        Nothing is left.
    """
    adjusted = []
    place = log.places(table)
    for quantity in quantities:
        column = f"{quantity.name}_adj"
        adjusted.append(column)
        if quantity.limits is None:
            continue
        lowest, highest = quantity.limits
        values = table[column].to_numpy()
        at_end = (values <= lowest) | (values >= highest)
        if at_end.any():
            _log(table, quantity, at_end, place, log)
            table = table.assign(**{column: table[column].mask(at_end)})
    if log.at_limits:
        table = table.dropna(subset=adjusted, how="all").reset_index(drop=True)
    if table.empty:
        hint = "Correct limits in [quantities]."
        raise UsageError("every adjustment lies at a limit of its control.", hint=hint)
    return table


def _log(table: pd.DataFrame, quantity: Quantity, at_end: _Mask, place: Places, log: Log) -> None:
    """Log each adjustment at an end of a control, and say how many there are."""
    why = f"{quantity.label} at a limit of its control"
    rows = table[at_end]
    positions = np.flatnonzero(at_end).tolist()
    ids = zip(positions, rows["subject"], rows["environment"], strict=True)
    for position, subject, environment in ids:
        what = f"{quantity.name} in environment {environment}"
        log.exclusions.append(Exclusion(subject, what, why, **place(position)))
    column = f"{quantity.name}_adj"
    known = int(table[column].notna().sum())
    text = (
        f"{counted(len(rows), 'value')} of {known} at the limits of the control,"
        f" {quantity.amounts(quantity.limits or ())}, are left out:"
        f" {by_environment(table, at_end)}. Every interval describes the other values only"
    )
    log.notices.append(Notice(text, column=column))
    log.counts[f"left out: {why}"] = len(rows)
    log.at_limits.append(rows.assign(parameter=quantity.name))


def by_environment(table: pd.DataFrame, chosen: _Mask) -> str:
    """Count chosen trials per environment, such as "5 of 12 in 'hard' (3 subjects)"."""
    trials = table["environment"].value_counts()
    texts = []
    for name, rows in table[chosen].groupby("environment", sort=False):
        subjects = counted(rows["subject"].nunique(), "subject")
        texts.append(f"{len(rows)} of {trials[name]} in {clip(str(name))!r} ({subjects})")
    more = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return ", ".join(texts[:_LISTED]) + more
