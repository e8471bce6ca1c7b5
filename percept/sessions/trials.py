"""A file's trials as one table, step by step: melted, selected, its ids and numbers converted.

Published tables stand here too: limits, or means and SDs, by environment and parameter.

The table's columns have percept's names or are `FileColumn` labels; its index is the physical line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions import values
from percept.sessions.options import KEPT_COLUMNS, ExcludeRule, canonical_columns
from percept.sessions.quantities import factor, quantity_of, with_mass
from percept.sessions.records import (
    IDS,
    MASS,
    MOMENTS_COLUMNS,
    SUMMARY_COLUMNS,
    Exclusion,
    Found,
    shown,
)
from percept.sessions.tables import OpenFile

_CORRECT_CELL = "Correct the cell, or leave it empty if there was no adjustment."
#: Share of rows without an id from which on its cells seem to be merged.
_MERGED = 0.5
#: Limits at any level give back the mean and SD of a published table that they were made of.
_LEVEL = 0.95
#: Above this, doubles do not tell whole numbers apart.
_WHOLE = 2.0**53
_Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class FileColumn:
    """Label of a column of the file's own, whatever its name."""

    name: str
    is_number: bool = False  # Read for a limit


def read_trials(file: OpenFile) -> pd.DataFrame:
    """Give the observations of a file: canonical columns, groups, physical `row`."""
    data = _melted(file)
    data = _selected(file, data)
    _unpack_json(file, data)
    adjusted = [name for name in data if isinstance(name, str) and name.endswith("_adj")]
    blank = np.logical_and.reduce([file.is_missing(data[column]) for column in adjusted])
    data = _exclude(file, data, blank, "no adjustment")
    _check_ids(file, data)
    _convert(file, data)
    data = _last_events(file, data)
    data = _within_limits(file, data)
    return _laid_out(file, data)


def _groups(file: OpenFile) -> list[str]:
    """Name the columns of groups that the file has."""
    kept = [name for name in KEPT_COLUMNS if name in file.grid.header]
    return list(dict.fromkeys((*kept, *file.options.groups)))


def _melted(file: OpenFile) -> pd.DataFrame:
    """Give a row for each observation, with its ids: one set of columns, or several melted."""
    selection = file.options.sessions
    canonical = canonical_columns(file.options.quantities)
    own = [FileColumn(name) for name in (*_groups(file), *selection.only)]
    for rule in selection.exclude:
        if rule.column not in canonical:
            own.append(FileColumn(rule.column, is_number=not rule.equals))
    columns: dict[Any, int] = {column: file.grid.position(column.name) for column in own}
    parts = file.cells([columns | {**slot.columns} for slot in file.slots])
    parts = [part.assign(**slot.ids) for part, slot in zip(parts, file.slots, strict=True)]
    # Columns of other slots are blank in this one.
    data = pd.concat(parts).fillna("").sort_index(kind="stable").assign(**file.ids)
    if file.options.sessions.subject == "row":
        stem = PurePath(file.name).stem
        data["subject"] = [f"{stem} {row}" for row in data.index]
    return data


def _selected(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Keep the rows that the scene's rules on texts leave."""
    for name, texts in file.options.sessions.only.items():
        kept = _among(data[FileColumn(name)], texts)
        data = _keep(file, data, kept, f"{name} is not {' or '.join(texts)}")
    for rule in file.options.sessions.exclude:
        if not rule.equals:
            continue
        excluded = _among(_ruled(file, data, rule), rule.equals)
        if excluded.any():
            file.log.applied.add(rule)
        data = _exclude(file, data, excluded, rule.why)
    return data


def _ruled(file: OpenFile, data: pd.DataFrame, rule: ExcludeRule) -> pd.Series[Any]:
    """Give the column of a rule: the file's own, or percept's."""
    own = FileColumn(rule.column, is_number=not rule.equals)
    if own not in data and rule.column not in data:
        file.grid.position(rule.column)
    return data[own if own in data else rule.column]


def _among(cells: pd.Series[Any], texts: Sequence[str]) -> _Mask:
    """Which cells hold one of the texts, however it is spelled."""
    wanted = set(map(values.fold, texts))
    spelled = [cell for cell in cells.unique() if values.fold(str(cell)) in wanted]
    return cells.isin(spelled).to_numpy()


def _keep(
    file: OpenFile,
    data: pd.DataFrame,
    kept: _Mask,
    reason: str,
) -> pd.DataFrame:
    """Keep rows, and count the others by reason."""
    if kept.all():
        return data
    file.log.counts[reason] += int((~kept).sum())
    return data[kept].copy()


def _exclude(file: OpenFile, data: pd.DataFrame, excluded: _Mask, why: str) -> pd.DataFrame:
    """Leave rows out, and log those with a subject and environment."""
    names = [*IDS, "trial"]
    ids = data[excluded].reindex(columns=names, fill_value="").astype(str)
    records = ids.to_dict("records")
    for row, cells in zip(ids.index.tolist(), records, strict=True):
        who = cells.pop("subject")
        if who.strip() and cells["environment"].strip():
            what = [f"{name} {text.removesuffix('.0')}" for name, text in cells.items() if text]
            exclusion = Exclusion(who, ", ".join(what), why, file.name, row)
            file.log.exclusions.append(exclusion)
    return _keep(file, data, ~excluded, f"excluded: {why}")


def _unpack_json(file: OpenFile, data: pd.DataFrame) -> None:
    """Take values out of JSON cells; records of other kinds of trial may lack them."""
    for canonical, rule in file.rules.items():
        if rule.path is None:
            continue
        picked: list[str | None] = []
        for row, cell in data[canonical].items():
            try:
                picked.append(values.pick(cell, rule.path))
            except ValueError as error:
                # Only the scene knows whether such a row has no adjustment: it is no blank.
                hint = "Correct the cell or the path, or pick rows with [sessions] only."
                file.report([Found(f"{error}.", canonical, row, cell, hint)])
                picked.append("")
        texts = pd.Series(picked, index=data.index, dtype="str")
        lacking = data[canonical][texts.isna()].tolist()
        if lacking and not any(picked):
            file.log.add(
                "no row has this path.",
                file=file.name,
                column=rule.name,
                key=f"columns.{canonical}.path",
                value=rule.path,
                hint=f"Correct it: it begins inside a cell such as {shown(lacking[:1])}.",
            )
        data[canonical] = texts.fillna("")


def _check_ids(file: OpenFile, data: pd.DataFrame) -> None:
    """Refuse observations without an id, or without a number in a column of trials."""
    for column in (*IDS, "trial"):
        if column not in data:
            continue
        missing = data[column].str.strip() == ""
        if column == "trial":
            missing |= file.is_missing(data[column])
        rows = data.index[missing]
        message = f"an adjustment has no {column}."
        hint = "Fill it in, or leave such rows out with [sessions] only or exclude."
        if len(rows) > 1 and missing.mean() >= _MERGED and not missing.iloc[0]:
            message = f"{len(rows)} of {len(data)} rows have no {column}: cells merged down?"
            hint = "Write it in every row: unmerge the cells, and fill each down."
            rows = rows[:1]
        file.report(Found(message, column, row, hint=hint) for row in rows)


def _convert(file: OpenFile, data: pd.DataFrame) -> None:
    """Convert columns of numbers to percept's units, by the file's one decimal mark."""
    quantities = with_mass(file.options.quantities)
    names = [name for name in data if name not in IDS and getattr(name, "is_number", True)]
    for name, numbers in file.numbers(data, names, _CORRECT_CELL).items():
        data[name] = numbers
        rule = file.rules.get(name)
        if rule is not None and name != "trial":
            data[name] *= rule.scale * factor(rule.unit, quantities[quantity_of(name)])
    if "trial" in data:
        trials = data["trial"]
        whole = (trials.abs() < _WHOLE) & (trials == trials.round())
        hint = "Number the trials 1, 2, 3 …"
        for row, value in trials[~whole & trials.notna()].items():
            file.report([Found("a trial number must be whole.", "trial", row, value, hint)])
        data["trial"] = trials.where(whole, 0).astype(np.int64)


def _last_events(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Reduce each trial to its last event, with the last value of each number, if declared."""
    if file.options.sessions.keep != "last":
        return data
    ids = [column for column in (*IDS, "trial") if column in data]
    trials = data.rename_axis("line").reset_index().groupby(ids, sort=False)
    last = trials.last().reset_index().set_index("line").sort_index(kind="stable")
    file.log.counts["earlier event of a trial"] += len(data) - len(last)
    file.grid.notice(f'keep = "last" leaves one row per {", ".join(ids)}')
    return last


def _within_limits(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Leave out what lies beyond a rule's limits; earlier events of a trial are gone by now."""
    for rule in file.options.sessions.exclude:
        if rule.equals:
            continue
        numbers = _ruled(file, data, rule)
        if not pd.api.types.is_numeric_dtype(numbers):
            key = f"sessions.exclude {rule.column}"
            raise UsageError("limits need a column of numbers.", key=key)
        is_beyond = numbers.notna() & (numbers != numbers.clip(rule.below, rule.above))
        data = _exclude(file, data, is_beyond.to_numpy(), rule.why)
    return data


def _laid_out(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Lay out canonical columns; what the file lacks is session and trial 1, or NaN."""
    options = file.options
    names = list(options.quantities)
    columns = [*IDS, *(f"{name}_ref" for name in names), "trial"]
    columns += [f"{name}_adj" for name in names]
    if MASS in data or MASS in options.declared_references:
        columns.append(MASS)
    groups = {name: data[FileColumn(name)] for name in _groups(file)}
    frame = data.reindex(columns=columns).assign(**groups, row=data.index)
    for name in ("session", "trial"):
        if name not in data:
            frame[name] = 1
    return frame.astype({**dict.fromkeys(IDS, "str"), "trial": np.int64})


def read_summary(file: OpenFile) -> pd.DataFrame:
    """Give the rows of a published table with limits; means and SDs become limits."""
    columns = file.slots[0].columns
    is_of_moments = "mean" in columns
    needed = [*(MOMENTS_COLUMNS if is_of_moments else SUMMARY_COLUMNS)]
    if is_of_moments and "level" not in columns:
        needed.remove("level")
        file.grid.notice(f"means and SDs without a level are kept as their limits at {_LEVEL}")
    for column in needed:
        if column not in columns:
            there = shown(file.grid.header)
            message = f"a published table needs the column {column}; the columns are {there}."
            hint = "Add it, or name it in the scene's [columns]."
            raise file.grid.error(message, column, hint)
    if any(rule.unit is not None for rule in file.rules.values()):
        units = " and ".join(quantity.unit for quantity in file.options.quantities.values())
        message = f"a published table is in {units}."
        raise UsageError(message, file=file.name, key="columns", hint="Convert the table.")
    (cells,) = file.cells([columns])
    numbers = file.numbers(cells, needed[2:], "Correct the cell.")
    frame = cells.assign(level=_LEVEL).assign(**numbers, row=cells.index)
    if is_of_moments:
        from scipy.special import stdtrit

        # Impossible n, levels and SDs are told by the checks of the whole study.
        with np.errstate(invalid="ignore", divide="ignore"):
            t = -stdtrit(frame["n"] - 1, 0.5 * (1 - frame["level"]))
            half = t / np.sqrt(frame["n"]) * frame["sd"]
        frame = frame.assign(lower=frame["mean"] - half, upper=frame["mean"] + half)
    return frame.reset_index(drop=True)
