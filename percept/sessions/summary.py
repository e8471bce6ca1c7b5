"""The summary form: a published table of limits, one row per environment and parameter."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions.checks import typical_ratio, units_differ
from percept.sessions.columns import Resolution
from percept.sessions.grids import Grid
from percept.sessions.options import ReadOptions
from percept.sessions.quantities import Quantities
from percept.sessions.records import Notice, Place, Problems, shown
from percept.sessions.values import DecimalMark, decimal_mark, is_missing, parse_numbers

_Floats = npt.NDArray[np.float64]
_LIMITS = ("lower", "upper")
_MOMENTS = ("mean", "sd")
#: Limits at any level give back the mean and SD they were made of.
_LEVEL = 0.95


def read_summary(
    grid: Grid, found: Resolution, file: str, options: ReadOptions, problems: Problems, notices: list[Notice]
) -> pd.DataFrame:
    """Read a published table of limits, or of means and standard deviations."""
    columns = found.slots[0].columns
    limits, moments = (all(c in columns for c in pair) for pair in (_LIMITS, _MOMENTS))
    for c in ("environment", "reference", "n", *(("level",) if limits else ())):
        if c not in columns:
            message = f"a summary needs the column {c}; the columns are {shown(grid.header)}."
            hint = "Add it, or name it in the scene's [columns]."
            raise UsageError(message, file=file, row=1, column=c, hint=hint)
    if any(rule.unit is not None for rule in found.rules.values()):
        hint = "Convert the table."
        units = " and ".join(quantity.unit for quantity in options.quantities.values())
        raise UsageError(f"units of a summary are {units}.", file=file, key="columns", hint=hint)
    text = {c: grid.cells[at].tolist() for c, at in columns.items()}
    rows = grid.cells.index.tolist()
    numbers = ["reference", *(_LIMITS if limits else ()), *(_MOMENTS if moments else ()), "n"]
    numbers += ["level"] if "level" in text else []
    mark = DecimalMark(options.decimal) if options.decimal else None
    mark = mark or decimal_mark([(c, text[c]) for c in numbers], rows, file=file, problems=problems)
    frame: dict[str, Any] = {c: np.array(text[c], dtype=object) for c in ("environment", "parameter")}
    for c in numbers:
        frame[c] = parse_numbers(text[c], rows, mark, problems, file=file, column=c)
        for at, cell in enumerate(text[c]):
            if is_missing(cell) and not (limits and c in _MOMENTS):
                message = "a summary leaves no cell empty."
                problems.add(message, file=file, row=rows[at], column=c, hint="Fill it in.")
    if "level" not in frame:
        frame["level"] = np.full(len(rows), _LEVEL)
        notices.append(Notice(f"means and SDs without a level are kept as their limits at {_LEVEL}", file))
    if moments:
        frame = _with_limits(frame, text, rows, file, problems)
    return pd.DataFrame(frame | {"row": np.array(rows, dtype=np.int64)})


def _with_limits(
    frame: dict[str, Any], text: dict[str, list[str]], rows: Sequence[int], file: str, problems: Problems
) -> dict[str, Any]:
    """Put limits in the place of means and SDs; limits beside them have to be theirs."""
    from scipy.special import stdtrit

    mean, sd, n, level = frame.pop("mean"), frame.pop("sd"), frame["n"], frame["level"]
    for at in np.flatnonzero(sd < 0).tolist():
        where = {"file": file, "row": rows[at], "column": "sd", "value": float(sd[at])}
        problems.add("is negative.", hint="Correct it.", **where)
    # Impossible n and levels are reported by the study's checks; as NaN they contradict nothing.
    possible = (n >= 2) & (level > 0) & (level < 1)
    df, tail = np.where(possible, n - 1, np.nan), np.where(possible, (1 - level) / 2, np.nan)
    factor = -stdtrit(df, tail) / np.sqrt(df + 1)
    implied = {"lower": mean - factor * sd, "upper": mean + factor * sd}
    if _LIMITS[0] not in frame:
        return implied | frame
    near = 1e-9 * (np.abs(mean) + factor * sd)
    near += _half_digit(text["mean"], mean) + factor * _half_digit(text["sd"], sd)
    for c in _LIMITS:
        off = np.abs(frame[c] - implied[c]) > near + _half_digit(text[c], frame[c])
        for at in np.flatnonzero(off).tolist():
            message = (
                f"the mean {mean[at]:g}, SD {sd[at]:g}, n {n[at]:g} and level {level[at]:g} of this row make "
                f"it {implied[c][at]:.6g}."
            )
            hint = "Correct the row, or leave out either mean and sd or the limits."
            problems.add(message, file=file, row=rows[at], column=c, value=text[c][at], hint=hint)
    return frame


def _half_digit(cells: Sequence[str], numbers: _Floats) -> _Floats:
    """Half a unit of each number's last printed digit, the most that rounding can have changed it."""
    places = (
        Decimal(cell.replace(",", ".")).as_tuple().exponent if np.isfinite(number) else 0
        for cell, number in zip(cells, numbers, strict=True)
    )
    return np.array([0.5 * 10.0 ** int(place) for place in places])


def check_summary(table: pd.DataFrame, quantities: Quantities, place: Place, problems: Problems) -> None:
    """Check a published table: parameter, order of limits, n, level, units, and one row for each interval."""
    n, level = table["n"], table["level"]
    whole = (n >= 2) & (n < 2.0**53) & (n == np.round(n))
    names = " or ".join(f'"{name}"' for name in quantities)
    rules = (
        ("parameter", ~table["parameter"].isin(list(quantities)), f"must be {names}."),
        ("environment", table["environment"].str.strip() == "", "is empty."),
        ("upper", table["upper"] < table["lower"], "is below the lower limit."),
        ("n", ~whole, "must be a whole number of at least 2, and below 2^53."),
        ("level", (level <= 0) | (level >= 1), "must lie between 0 and 1, as in 0.99."),
    )
    for column, wrong, message in rules:
        for at in np.flatnonzero(np.asarray(wrong)):
            value = table[column].tolist()[at]
            problems.add(message, column=column, value=value, hint="Correct it.", **place(int(at)))
    _check_units(table, quantities, place, problems)
    for at in np.flatnonzero(table.duplicated(["environment", "parameter"]).to_numpy()):
        message, hint = "a second row for this environment and parameter.", "Remove one of them."
        where = {"column": "environment", "value": table["environment"].iloc[at], **place(int(at))}
        problems.add(message, hint=hint, **where)


def _check_units(table: pd.DataFrame, quantities: Quantities, place: Place, problems: Problems) -> None:
    """Compare published limits with their references, as adjustments are compared with theirs."""
    values, lower, upper = (table[c].to_numpy(dtype=float) for c in ("reference", "lower", "upper"))
    # Of what the limits hold, the nearest to the reference: wide limits are no sign of another unit.
    nearest = np.clip(values, lower, upper)
    for p, quantity in quantities.items():
        known = np.flatnonzero((table["parameter"] == p).to_numpy() & (nearest > 0) & (values > 0))
        ratio = typical_ratio(nearest[known], values[known]) if len(known) else 1.0
        if units_differ(ratio):
            problems.add(
                f"limits of {p} are typically {ratio:.3g} times the reference: their units seem to differ.",
                column="reference",
                value=float(values[known[0]]),
                hint=f"Write references and limits in {quantity.unit or 'one unit'}.",
                **place(int(known[0])),
            )
