"""The summary form: a published table of limits, one row per environment and parameter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions.columns import Resolution
from percept.sessions.dialect import Grid
from percept.sessions.numbers import decimal_mark, is_missing, parse_numbers
from percept.sessions.options import ReadOptions
from percept.sessions.problems import Problems, shown

__all__ = ["read_summary"]


def read_summary(
    grid: Grid, resolution: Resolution, *, file: str, options: ReadOptions, problems: Problems
) -> pd.DataFrame:
    """Read a published table.

    Parameters
    ----------
    grid : Grid
        Its cells.
    resolution : Resolution
        Where its columns stand.
    file : str
        Its name, for messages.
    options : ReadOptions
        How to read it.
    problems : Problems
        Receives every cell that is empty or no number.

    Returns
    -------
    DataFrame
        `environment`, `parameter`, `reference`, `lower`, `upper` (N/m or N·s/m), `n`, `level`, `row`.

    Raises
    ------
    UsageError
        A missing column, or a declared unit.
    """
    columns = resolution.slots[0].columns
    missing = [c for c in ("environment", "reference", "n", "level") if c not in columns]
    if missing:
        raise UsageError(
            f"a summary needs the column {missing[0]}; the columns are {shown(grid.header)}.",
            file=file,
            row=1,
            column=missing[0],
            hint="Add it, or name it in the scene's [columns].",
        )
    text = {c: [record[at] for record in grid.cells] for c, at in columns.items()}
    numbers = [c for c in ("reference", "lower", "upper", "n", "level") if c in text]
    mark = decimal_mark(
        [(c, text[c]) for c in numbers], grid.rows, file=file, declared=options.decimal, problems=problems
    )
    frame: dict[str, Any] = {c: np.array(text[c], dtype=object) for c in ("environment", "parameter")}
    for c in numbers:
        frame[c] = parse_numbers(text[c], grid.rows, mark=mark, file=file, column=c, problems=problems)
        for at in np.flatnonzero(np.isnan(frame[c])):
            if is_missing(text[c][at]):
                problems.add(
                    "a summary leaves no cell empty.",
                    file=file,
                    row=grid.rows[at],
                    column=c,
                    hint="Fill it in.",
                )
    units = resolution.rules["reference"].unit, resolution.rules["lower"].unit, resolution.rules["upper"].unit
    if any(unit is not None for unit in units):
        raise UsageError(
            "units of a summary are N/m and N·s/m.", file=file, column="columns", hint="Convert the table."
        )
    frame["row"] = np.array(grid.rows, dtype=np.int64)
    return pd.DataFrame(frame)
