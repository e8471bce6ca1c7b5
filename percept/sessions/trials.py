"""A file's trials as one table: rows selected, ids and numbers taken out of cells, units converted.

Its columns have percept's names or are `Own`; its index is the physical line.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions import values
from percept.sessions.columns import Slot
from percept.sessions.grids import Block
from percept.sessions.options import KEPT_COLUMNS, canonical_columns
from percept.sessions.quantities import convert, numbers_of, quantity_of, with_mass
from percept.sessions.records import IDS, MASS, Exclusion, shown
from percept.sessions.table import OpenFile

_CORRECT = "Correct the cell, or leave it empty if there was no adjustment."
#: Share of rows without an id from which on its cells seem to be merged.
_MERGED = 0.5
#: Above this, doubles do not tell whole numbers apart.
_WHOLE = 2.0**53
_EARLIER = "earlier event of a trial"
_Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Own:
    """Label of a column of the file's own, whatever its name."""

    name: str
    is_number: bool = False  # Read for a limit


def read_trials(file: OpenFile) -> pd.DataFrame:
    """Give the observations of a file: canonical columns, groups, physical `row`."""
    selection = file.options.sessions
    data = _cells(file)
    data = _with_ids(file, data)
    data = _selected(file, data)
    for canonical, rule in file.found.rules.items():
        if rule.path is not None:
            data[canonical] = _picks(file, data[canonical], canonical, rule.path)
    adjusted = [name for name in data if isinstance(name, str) and name.endswith("_adj")]
    blank = np.logical_and.reduce([_missing(data[column]) for column in adjusted])
    data = _exclude(file, data, blank, "no adjustment", of_trials=True)
    _check_ids(file, data)
    data = _converted(file, data)
    if selection.keep == "last":
        data = _last_events(file, data)
    data = _within_limits(file, data)
    return _laid_out(file, data)


def _groups(file: OpenFile) -> list[str]:
    """Name the columns of groups that the file has."""
    kept = [name for name in KEPT_COLUMNS if name in file.header.names]
    return list(dict.fromkeys((*kept, *file.options.sessions.groups)))


def _own_columns(file: OpenFile) -> dict[Any, int]:
    """Find the file's other columns that are read."""
    canonical = canonical_columns(file.options.quantities)
    selection = file.options.sessions
    names = [Own(name) for name in (*_groups(file), *selection.only)]
    for rule in selection.exclude:
        if rule.column not in canonical:
            names.append(Own(rule.column, is_number=not rule.equals))
    for column in file.found.rules.values():
        names += [Own(name) for name in column.also]
    return {own: file.header.position(own.name) for own in names}


def _cells(file: OpenFile) -> pd.DataFrame:
    """Give the cells of all blocks by canonical or own column, a row for each observation."""
    own = _own_columns(file)
    parts = []
    for block in file.blocks:
        if file.found.wide:
            cells = file.cells(block)
            slots = [_slot(cells, slot, own) for slot in file.found.slots]
            # Columns of other slots are blank in this one.
            parts.append(pd.concat(slots).fillna("").sort_index(kind="stable"))
        else:
            parts.append(_long(file, block, {**own, **file.found.slots[0].columns}))
    return pd.concat(parts).assign(**file.ids)


def _slot(cells: pd.DataFrame, slot: Slot, own: dict[Any, int]) -> pd.DataFrame:
    """Give the observations that one slot of a wide table holds."""
    columns: dict[Any, int] = {**own, **slot.columns}
    data = cells[list(columns.values())].set_axis(list(columns), axis=1)
    if slot.environment is not None:
        data["environment"] = slot.environment
    if slot.trial is not None:
        data["trial"] = slot.trial
    return data


def _long(file: OpenFile, block: Block, columns: dict[Any, int]) -> pd.DataFrame:
    """Give the cells of a block; one of plain numbers is split at the speed of pandas' parser."""
    rules = file.found.rules.values()
    selection = file.options.sessions
    numeric = set(_numbers(file, columns))
    numbers = {columns[name] for name in numeric}
    texts = {columns[name] for name in columns.keys() - numeric}
    comma_may_be_decimal = selection.decimal is None and block.dialect.delimiter != ","
    needs_text = (
        bool(texts & numbers)
        or any(rule.path is not None for rule in rules)
        or any(rule.equals and rule.column in numeric for rule in selection.exclude)
        or (comma_may_be_decimal and "," in block.text)
    )
    cells = None
    if not needs_text:
        cells = block.read_plain(sorted(texts), sorted(numbers), selection.decimal or ".")
    if cells is None:
        cells = file.cells(block)
    else:
        file.log.counts["rows read"] += len(cells)
    return cells[list(columns.values())].set_axis(list(columns), axis=1)


def _numbers(file: OpenFile, names: Iterable[Any]) -> list[Any]:
    """Give the columns of numbers among those named."""
    canonical = {"trial", *numbers_of(file.options.quantities)}
    return [name for name in names if name in canonical or getattr(name, "is_number", False)]


def _with_ids(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Join ids of several columns, and write ids and groups in one spelling."""
    if file.options.sessions.subject == "row":
        stem = PurePath(file.name).stem
        data["subject"] = [f"{stem} {row}" for row in data.index]
    for canonical, rule in file.found.rules.items():
        if rule.also:
            data[canonical] = _joined(file, data, canonical, rule.also)
    columns: dict[Any, str] = {name: name for name in IDS if name in data}
    columns |= {Own(name): name for name in _groups(file)}
    for column, name in columns.items():
        data[column] = file.log.names.settle(name, data[column], file.name)
    return data


def _joined(file: OpenFile, data: pd.DataFrame, canonical: str, also: tuple[str, ...]) -> list[str]:
    """Join ids of several columns; one that lacks a part is blank, and so missing."""
    columns = [data[canonical], *(data[Own(name)] for name in also)]
    records = list(zip(*columns, strict=True))
    ids: dict[tuple[str, ...], str] = {}
    parts_of: dict[str, tuple[str, ...]] = {}
    for parts in dict.fromkeys(records):
        complete = all(part.strip() for part in parts)
        joined = "-".join(parts) if complete else ""
        ids[parts] = joined
        if joined and parts_of.setdefault(joined, parts) != parts:
            message = f"{shown(parts)} and {shown(parts_of[joined])} both join to {joined!r}."
            hint = "Take the hyphens out of one of these columns."
            raise UsageError(message, hint=hint, **file.place(canonical))
    return [ids[parts] for parts in records]


def _selected(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Keep the rows that the scene's rules on texts leave."""
    for name, texts in file.options.sessions.only.items():
        kept = _among(data[Own(name)], texts)
        data = _keep(file, data, kept, f"{name} is not {' or '.join(texts)}")
    for rule in file.options.sessions.exclude:
        if not rule.equals:
            continue
        column = Own(rule.column) if Own(rule.column) in data else rule.column
        if column not in data:
            file.header.position(rule.column)
        excluded = _among(data[column], rule.equals)
        if excluded.any():
            file.log.applied.add(rule)
        data = _exclude(file, data, excluded, rule.why)
    return data


def _keep(file: OpenFile, data: pd.DataFrame, kept: _Mask, reason: str) -> pd.DataFrame:
    """Keep rows, and count the others by reason."""
    if kept.all():
        return data
    file.log.counts[reason] += int((~kept).sum())
    return data[kept].copy()


def _exclude(
    file: OpenFile, data: pd.DataFrame, excluded: _Mask, why: str, *, of_trials: bool = False
) -> pd.DataFrame:
    """Leave rows out and log them; `of_trials` logs those with a subject and environment."""
    ids = data[excluded].reindex(columns=[*IDS, "trial"], fill_value="").astype(str)
    for row, own in zip(ids.index.tolist(), ids.to_dict("records"), strict=True):
        if of_trials and not (own["subject"].strip() and own["environment"].strip()):
            continue
        what = []
        for column in ("session", "environment", "trial"):
            name = own[column].removesuffix(".0")
            if name:
                what.append(f"{column} {name}")
        exclusion = Exclusion(own["subject"], ", ".join(what), why, file.name, row)
        file.log.exclusions.append(exclusion)
    return _keep(file, data, ~excluded, f"excluded: {why}")


def _picks(file: OpenFile, cells: pd.Series[str], canonical: str, path: str) -> list[str]:
    """Values inside the JSON cells of a column; records of other kinds of trial may lack them."""
    lacking = []
    picked = []
    found = False
    for row, cell in zip(cells.index.tolist(), cells, strict=True):
        value: str | None = ""
        try:
            value = values.pick(cell, path)
        except values.CellError as error:
            # Only the scene knows whether such a row has no adjustment: it is no blank.
            hint = (
                f"Correct the cell or the path of {canonical}, or pick rows with [sessions] only."
            )
            place = file.place(canonical, row)
            file.log.problems.add(f"{error}.", value=cell, hint=hint, **place)
        if value is None:
            lacking.append(cell)
        else:
            found |= not values.is_missing(cell)
        picked.append(value or "")
    if lacking and not found:
        file.log.problems.add(
            "no row has this path.",
            key=f"columns.{canonical}.path",
            value=path,
            hint=f"Correct it: it begins inside a cell such as {shown(lacking[:1])}.",
            **file.place(canonical),
        )
    return picked


def _check_ids(file: OpenFile, data: pd.DataFrame) -> None:
    """Refuse observations without an id, or without a number in a column of trials."""
    problems = file.log.problems
    for column in (*IDS, "trial"):
        if column not in data:
            continue
        if column == "trial":
            missing = _missing(data[column])
        else:
            # Ids are few, so that each is looked at once.
            empty = [name for name in data[column].unique() if not name.strip()]
            missing = data[column].isin(empty).to_numpy()
        if missing.sum() > 1 and missing.mean() >= _MERGED and not missing[0]:
            place = file.place(column, data.index[missing][0])
            message = f"{missing.sum()} of {len(data)} rows have no {column}: cells merged down?"
            hint = "Write it in every row: unmerge the cells, and fill each down."
            problems.add(message, hint=hint, **place)
            continue
        for row in data.index[missing]:
            hint = "Fill it in, or leave such rows out with [sessions] only or exclude."
            problems.add(f"an adjustment has no {column}.", hint=hint, **file.place(column, row))


def _converted(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Convert columns of numbers to percept's units, by the file's one decimal mark."""
    problems = file.log.problems
    rows = data.index.to_numpy()
    quantities = with_mass(file.options.quantities)
    names = _numbers(file, data)
    texts = {name: data[name].tolist() for name in names if data[name].dtype != np.float64}
    places = {name: file.place(name.name if isinstance(name, Own) else name) for name in names}
    mark = file.options.sessions.decimal
    if mark is None and texts:
        columns = [(places[name]["column"], cells) for name, cells in texts.items()]
        mark = values.decimal_mark(columns, rows, file=file.name, problems=problems)
    for name in names:
        numbers = data[name].to_numpy()
        if name in texts:
            numbers = values.parse_numbers(
                texts[name],
                rows,
                mark,
                problems,
                places[name],
                correct=_CORRECT,
                canonical=str(getattr(name, "name", name)),
            )
        rule = file.found.rules.get(name)
        if name == "trial":
            numbers = _whole(file, numbers, rows)
        elif rule is not None:
            numbers = (numbers + rule.offset) * rule.scale
            if rule.response == "log":
                numbers = np.power(10.0, numbers)
            numbers = convert(numbers, rule.unit, quantities[quantity_of(name)])
        data[name] = numbers
    return data


def _whole(
    file: OpenFile, trials: npt.NDArray[np.float64], rows: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Numbers of trials; those that are not whole are problems."""
    whole = (np.abs(trials) < _WHOLE) & (trials == np.round(trials))
    for position in np.flatnonzero(~whole & ~np.isnan(trials)).tolist():
        file.log.problems.add(
            "a trial number must be whole.",
            value=float(trials[position]),
            hint="Number the trials 1, 2, 3 …",
            **file.place("trial", rows[position]),
        )
    return np.where(whole, trials, 0).astype(np.int64)


def _last_events(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Reduce each trial to its last event, with the last value of each number."""
    ids = [column for column in (*IDS, "trial") if column in data]
    numbers = [column for column in _numbers(file, data) if column != "trial"]
    filled = data.groupby(ids, sort=False, dropna=False)[numbers].ffill()
    # Physical lines may repeat in a wide table: values go by position.
    for column in numbers:
        data[column] = filled[column].to_numpy()
    last = _keep(file, data, ~data.duplicated(ids, keep="last").to_numpy(), _EARLIER)
    rows = len(data)
    earlier = rows - len(last)
    text = (
        f'keep = "last" leaves out {earlier:,} of {rows:,} rows ({earlier / max(rows, 1):.1%})'
        " as earlier events of a trial"
    )
    if not file.is_numbered:
        text += "; no column numbers the trials, so one row stays per subject and environment"
    file.notice(text)
    return last


def _within_limits(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Leave out what lies beyond a rule's limits; earlier events of a trial are gone by now."""
    for rule in file.options.sessions.exclude:
        if rule.equals:
            continue
        column = rule.column if rule.column in data else Own(rule.column, is_number=True)
        if column not in data or not pd.api.types.is_numeric_dtype(data[column]):
            key = f"sessions.exclude {rule.column}"
            raise UsageError("limits need a column of numbers.", key=key)
        numbers = data[column].to_numpy()
        outside = np.zeros(len(numbers), dtype=bool)
        if rule.below is not None:
            outside |= numbers < rule.below
        if rule.above is not None:
            outside |= numbers > rule.above
        data = _exclude(file, data, outside, rule.why)
    return data


def _laid_out(file: OpenFile, data: pd.DataFrame) -> pd.DataFrame:
    """Lay out canonical columns; what the file lacks is session and trial 1, or NaN."""
    options = file.options
    defaults: dict[str, str | float] = dict.fromkeys(IDS, "1")
    defaults |= {f"{p}_ref": np.nan for p in options.quantities}
    defaults["trial"] = 1
    defaults |= {f"{p}_adj": np.nan for p in options.quantities}
    if MASS in data or any(MASS in own for own in options.environments.values()):
        defaults[MASS] = np.nan
    columns = {column: data.get(column, value) for column, value in defaults.items()}
    for name in _groups(file):
        columns[name] = data[Own(name)]
    frame = pd.DataFrame(columns, index=data.index).assign(row=data.index)
    return frame.astype(dict.fromkeys(IDS, "str"))


def _among(cells: pd.Series[Any], texts: Sequence[str]) -> _Mask:
    """Which cells hold one of the texts, however it is spelled."""
    wanted = {values.fold(text) for text in texts}
    spelled = [cell for cell in cells.unique() if values.fold(str(cell)) in wanted]
    return cells.isin(spelled).to_numpy()


def _missing(cells: pd.Series[Any]) -> _Mask:
    """Which cells say that there is no value."""
    blank = cells.isna() if cells.dtype == np.float64 else cells.map(values.is_missing)
    return blank.to_numpy(dtype=bool)
