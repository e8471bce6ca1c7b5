"""Conditions within subjects: each reference at each level of a factor is a cell of its own."""

from __future__ import annotations

import dataclasses

from percept.errors import UsageError, counted
from percept.sessions.read import Sessions
from percept.sessions.records import Factor, shown


def filled(sessions: Sessions, column: str) -> None:
    """Refuse a column that does not put every row of trials into a group."""
    if sessions.form == "summary":
        raise UsageError(
            "published limits hold no subjects to divide.",
            column=column,
            hint="Give sessions, or two studies.",
        )
    table = sessions.table
    if column not in table:
        known = ", ".join(str(name) for name in table.columns)
        raise UsageError(
            f"there is no such column; the columns are {known}.",
            column=column,
            hint=f'A column that is no part of the format is kept by [sessions] groups = ["{column}"].',
        )
    blank = table[column].astype(str).str.strip() == ""
    if blank.any():
        file, row = sessions.locate(int(table.index[blank][0]))
        raise UsageError(
            f"{counted(int(blank.sum()), 'row')} without a value, of no group.",
            file=file,
            row=row,
            column=column,
            hint="Fill them in, or leave such rows out with [sessions] exclude.",
        )
    if table[column].nunique() < 2:
        raise UsageError("all rows have one value: there is nothing to compare.", column=column)


def by_level(sessions: Sessions, column: str) -> Sessions:
    """Make each environment at each level of a column an environment of its own, such as "VE1, left"."""
    if sessions.factor is not None:
        return sessions
    filled(sessions, column)
    table = sessions.table
    levels = tuple(str(level) for level in table[column].unique())
    factor = Factor(column, levels, {})
    present = set(zip(table["environment"], table[column].astype(str), strict=True))
    ordered = [(e, level) for e in sessions.environments for level in levels if (e, level) in present]
    cells = {factor.cell(*pair): pair for pair in ordered}
    if len(cells) < len(ordered):
        hint = "Name environments or levels without a comma and a space."
        raise UsageError(f"two cells would have one name: {shown(list(cells))}.", column=column, hint=hint)
    names = table["environment"].str.cat(table[column].astype(str), sep=", ")
    return dataclasses.replace(
        sessions,
        table=table.assign(environment=names),
        listed=tuple(cells),
        factor=dataclasses.replace(factor, cells=cells),
    )
