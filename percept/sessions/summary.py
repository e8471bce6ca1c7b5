"""Published tables: limits, or means and standard deviations, by environment and parameter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions.records import Found, shown
from percept.sessions.tables import OpenFile

#: Limits at any level give back the mean and SD they were made of.
_LEVEL = 0.95


def read_summary(file: OpenFile) -> pd.DataFrame:
    """Give the rows of a published table with limits; means and SDs become limits."""
    columns = file.resolution.slots[0].columns
    has_limits = {"lower", "upper"} <= columns.keys()
    names = ["reference", *(("lower", "upper") if has_limits else ("mean", "sd")), "n"]
    if has_limits or "level" in columns:
        names.append("level")
    _require(file, ("environment", *names))
    if has_limits and columns.keys() & {"mean", "sd"}:
        file.notice("mean and sd are not used: lower and upper are there")
    if "level" not in columns:
        file.notice(f"means and SDs without a level are kept as their limits at {_LEVEL}")
    positions = list(columns.values())
    cells = file.cells(positions)[positions].set_axis(list(columns), axis=1)
    numbers = file.numbers(cells, names, "Correct the cell.")
    for name in names:
        empty = cells.index[file.is_missing(cells[name])].tolist()
        message = "a published table has no empty cells."
        file.report(Found(message, name, row, hint="Fill it in.") for row in empty)
    frame = cells[["environment", "parameter"]].assign(level=_LEVEL, row=cells.index)
    for name, column in numbers.items():
        frame[name] = column
    frame = frame.reset_index(drop=True)
    return frame if has_limits else _with_limits(file, frame)


def _require(file: OpenFile, names: Sequence[str]) -> None:
    """Refuse a table that lacks a column, or declares a unit."""
    for column in names:
        if column not in file.resolution.slots[0].columns:
            there = shown(file.grid.header)
            message = f"a published table needs the column {column}; the columns are {there}."
            hint = "Add it, or name it in the scene's [columns]."
            raise file.grid.error(message, column, hint)
    if any(rule.unit is not None for rule in file.resolution.rules.values()):
        units = " and ".join(quantity.unit for quantity in file.options.quantities.values())
        message = f"a published table is in {units}."
        raise UsageError(message, file=file.name, key="columns", hint="Convert the table.")


def _with_limits(file: OpenFile, frame: pd.DataFrame) -> pd.DataFrame:
    """Replace means and SDs by their t-limits."""
    from scipy.special import stdtrit

    sd = frame["sd"]
    message = "a standard deviation is not negative."
    wrong = zip(frame["row"][sd < 0].tolist(), sd[sd < 0], strict=True)
    file.report(Found(message, "sd", row, value, "Correct it.") for row, value in wrong)
    n = frame["n"]
    level = frame["level"]
    # Impossible n and levels are told by the checks of the whole study.
    possible = (n >= 2) & (level > 0) & (level < 1)
    df = (n - 1).where(possible)
    tail = (0.5 * (1 - level)).where(possible)
    half = -stdtrit(df, tail) / np.sqrt(df + 1) * sd
    limits = frame.assign(lower=frame["mean"] - half, upper=frame["mean"] + half)
    return limits.drop(columns=["mean", "sd"])
