"""A column of groups or conditions that divides the trials."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from percept.errors import UsageError, counted
from percept.sessions.read import Sessions
from percept.sessions.records import Factor

__all__ = ["by_level", "refuse_gaps"]


def refuse_gaps(sessions: Sessions, column: str) -> None:
    """Refuse a column that does not put every row of trials into a group."""
    if sessions.form == "summary":
        message = "published limits hold no subjects to divide."
        raise UsageError(message, column=column, hint="Give sessions, or two studies.")
    table = sessions.table
    if column not in table:
        message = f"the sessions have no such column; they have {', '.join(map(str, table))}."
        hint = (
            "Read the files with the scene that names it: read_sessions(files, scene=scene)."
            f' A column of groups is kept by [sessions] groups = ["{column}"].'
        )
        raise UsageError(message, column=column, hint=hint)
    blank = table[column].astype(str).str.strip() == ""
    if blank.any():
        file, row = sessions.locate(int(table.index[blank][0]))
        message = f"{counted(int(blank.sum()), 'row')} without a value, of no group."
        hint = "Fill them in, or leave such rows out with [sessions] exclude."
        raise UsageError(message, file=file, row=row, column=column, hint=hint)
    if table[column].nunique() < 2:
        raise UsageError("all rows have one value: there is nothing to compare.", column=column)


def by_level(sessions: Sessions, column: str) -> Sessions:
    """Make each environment at each level of a column an environment of its own, such as "VE1 (left)"."""
    if sessions.factor is not None:
        return sessions
    refuse_gaps(sessions, column)
    names = sessions.table["environment"]
    of_rows = sessions.table[column].astype(str)
    levels = tuple(of_rows.unique())
    present = set(zip(names, of_rows, strict=True))
    cells: dict[str, tuple[str, str]] = {}
    factor = Factor(column, levels, cells)
    for environment, level in product(sessions.environments, levels):
        if (environment, level) not in present:
            continue
        cell = factor.cell(environment, level)
        if cell in cells:
            message = f"two cells would have the name {cell!r}."
            hint = "Name environments or levels without brackets."
            raise UsageError(message, column=column, hint=hint)
        cells[cell] = (environment, level)
    table = sessions.table.assign(environment=names + " (" + of_rows + ")")
    return replace(sessions, table=table, factor=factor)
