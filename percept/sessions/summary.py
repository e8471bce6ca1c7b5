"""The summary form: a published table of limits, one row per environment and parameter."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
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
from percept.sessions.records import Notice

_Floats = npt.NDArray[np.float64]
_LIMITS = ("lower", "upper")
_MOMENTS = ("mean", "sd")
# Limits at any level give back the mean and SD they were made of.
_LEVEL = 0.95


def read_summary(
    grid: Grid,
    resolution: Resolution,
    *,
    file: str,
    options: ReadOptions,
    problems: Problems,
    notices: list[Notice],
) -> pd.DataFrame:
    """Read a published table of limits, or of means and standard deviations."""
    columns = resolution.slots[0].columns
    limits, moments = (all(c in columns for c in pair) for pair in (_LIMITS, _MOMENTS))
    needed = ("environment", "reference", "n", *(("level",) if limits else ()))
    missing = [c for c in needed if c not in columns]
    if missing:
        raise UsageError(
            f"a summary needs the column {missing[0]}; the columns are {shown(grid.header)}.",
            file=file,
            row=1,
            column=missing[0],
            hint="Add it, or name it in the scene's [columns].",
        )
    text = {c: [record[at] for record in grid.cells] for c, at in columns.items()}
    numbers = ["reference", *(_LIMITS if limits else ()), *(_MOMENTS if moments else ()), "n"]
    numbers += ["level"] if "level" in text else []
    mark = decimal_mark(
        [(c, text[c]) for c in numbers], grid.rows, file=file, declared=options.decimal, problems=problems
    )
    frame: dict[str, Any] = {c: np.array(text[c], dtype=object) for c in ("environment", "parameter")}
    for c in numbers:
        frame[c] = parse_numbers(
            text[c], grid.rows, mark=mark, file=file, column=c, problems=problems, optional=False
        )
        for at in np.flatnonzero(np.isnan(frame[c])):
            if is_missing(text[c][at]) and not (limits and c in _MOMENTS):
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
    if "level" not in frame:
        frame["level"] = np.full(len(grid.rows), _LEVEL)
        notices.append(Notice(f"means and SDs without a level are kept as their limits at {_LEVEL}", file))
    if moments:
        mean, sd = frame.pop("mean"), frame.pop("sd")
        for at in np.flatnonzero(sd < 0):
            problems.add(
                "is negative.",
                file=file,
                row=grid.rows[at],
                column="sd",
                value=float(sd[at]),
                hint="Correct it.",
            )
        factor = _factor(frame["n"], frame["level"])
        implied = {"lower": mean - factor * sd, "upper": mean + factor * sd}
        if limits:
            near = 1e-9 * (np.abs(mean) + factor * sd)
            near += _half_digit(text["mean"], mean) + factor * _half_digit(text["sd"], sd)
            for c in _LIMITS:
                off = np.abs(frame[c] - implied[c]) > near + _half_digit(text[c], frame[c])
                for at in np.flatnonzero(off):
                    problems.add(
                        f"the mean {mean[at]:g}, SD {sd[at]:g}, n {frame['n'][at]:g} and level "
                        f"{frame['level'][at]:g} of this row make it {implied[c][at]:.6g}.",
                        file=file,
                        row=grid.rows[at],
                        column=c,
                        value=text[c][at],
                        hint="Correct the row, or leave out either mean and sd or the limits.",
                    )
        frame = implied | frame
    frame["row"] = np.array(grid.rows, dtype=np.int64)
    return pd.DataFrame(frame)


def _factor(n: _Floats, level: _Floats) -> _Floats:
    """Half-width of a t-interval in standard deviations."""
    from scipy.special import stdtrit

    # Impossible n and levels are reported by the study's checks; as NaN they contradict nothing.
    possible = (n >= 2) & (level > 0) & (level < 1)
    n, level = np.where(possible, n, np.nan), np.where(possible, level, np.nan)
    return np.asarray(-stdtrit(n - 1, (1 - level) / 2) / np.sqrt(n))


def _half_digit(cells: Sequence[str], numbers: _Floats) -> _Floats:
    """Half a unit of each number's last printed digit, the most that rounding can have changed it."""
    places = (
        Decimal(cell.replace(",", ".")).as_tuple().exponent if np.isfinite(number) else 0
        for cell, number in zip(cells, numbers, strict=True)
    )
    return np.array([0.5 * 10.0 ** int(place) for place in places])
