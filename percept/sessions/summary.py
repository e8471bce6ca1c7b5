"""The summary form: a published table of limits, one row per environment and parameter."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions.columns import Resolution
from percept.sessions.dialect import Grid
from percept.sessions.numbers import decimal_mark, is_missing, parse_numbers
from percept.sessions.options import ReadOptions
from percept.sessions.problems import Problems, shown

__all__ = ["read_summary"]

_Floats = npt.NDArray[np.float64]


def read_summary(
    grid: Grid, resolution: Resolution, *, file: str, options: ReadOptions, problems: Problems
) -> pd.DataFrame:
    """Read a published table of limits, or of means and standard deviations.

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
        `environment`, `parameter`, `reference`, `lower`, `upper` (N/m or N·s/m), `n`, `level`, `row`. Means
        and standard deviations become the limits mean ± t·sd/√n of their t-interval at `level`.

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
    pair = ("lower", "upper") if "lower" in text and "upper" in text else ("mean", "sd")
    numbers = ["reference", *pair, "n", "level"]
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
    if any(rule.unit is not None for rule in resolution.rules.values()):
        raise UsageError(
            "units of a summary are N/m and N·s/m.", file=file, key="columns", hint="Convert the table."
        )
    if pair == ("mean", "sd"):
        mean, sd = frame.pop("mean"), frame.pop("sd")
        for at in np.flatnonzero(sd < 0):
            problems.add("is negative.", file=file, row=grid.rows[at], column="sd", value=float(sd[at]))
        half = _half_width(sd, frame["n"], frame["level"])
        frame |= {"lower": mean - half, "upper": mean + half}
    frame["row"] = np.array(grid.rows, dtype=np.int64)
    return pd.DataFrame(frame)


def _half_width(sd: _Floats, n: _Floats, level: _Floats) -> _Floats:
    from scipy.special import stdtrit

    # Impossible n and levels are reported by the study's checks; they must only not stop the arithmetic.
    possible = (n >= 2) & (level > 0) & (level < 1)
    n, level = np.where(possible, n, 2.0), np.where(possible, level, 0.5)
    return -stdtrit(n - 1, (1 - level) / 2) * sd / np.sqrt(n)
