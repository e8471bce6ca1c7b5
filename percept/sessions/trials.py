"""Tables of trials: rows selected, ids and numbers taken out of their cells, units converted."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import PurePath
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions import values
from percept.sessions.columns import Resolution, check_columns
from percept.sessions.grids import Block
from percept.sessions.options import KEPT_COLUMNS, canonical_columns
from percept.sessions.quantities import convert, numbers_of, quantity_of, with_mass
from percept.sessions.records import IDS, MASS, Exclusion, shown
from percept.sessions.table import FileTable, OpenFile

__all__ = ["LongTable", "WideTable"]

_CORRECT = "Correct the cell, or leave it empty if there was no adjustment."
#: Share of rows without an id from which on its cells seem to be merged.
_MERGED = 0.5
#: Above this, doubles do not tell whole numbers apart.
_WHOLE = 2.0**53
#: Before the name of a column of the file's own that is read as text, or as numbers for a limit.
_OWN = "own:"
_LIMIT = "limit:"
_EARLIER = "earlier event of a trial"
_Mask = npt.NDArray[np.bool_]


class TrialTable(FileTable):
    """A table of trials. In frames of a block the index is the physical line."""

    form: ClassVar[Literal["trials", "summary"]] = "trials"

    def __init__(self, file: OpenFile, found: Resolution) -> None:
        super().__init__(file, found)
        check_columns(file.header, found, file.options, file.ids)
        self._rules = found.rules
        self._selection = file.options.sessions
        self._mark = self._selection.decimal
        self.numbered = "trial" in found.rules or any(slot.trial for slot in found.slots)
        self.parameters = {p for p in file.options.quantities if f"{p}_adj" in found.rules}
        self._groups = [name for name in KEPT_COLUMNS if name in file.header.names]
        for name in self._selection.groups:
            if name not in self._groups:
                self._groups.append(name)
        self._own = self._own_columns()
        self._number_columns = set(numbers_of(file.options.quantities))
        self._number_columns |= {name for name in self._own if name.startswith(_LIMIT)}
        # Of columns with a path: a cell that lacks it, and whether any cell had it.
        self._lacking: dict[str, str] = {}
        self._picked: set[str] = set()
        self._joins: dict[str, tuple[str, ...]] = {}  # From a joined id to its parts

    def _own_columns(self) -> dict[str, int]:
        """Find the file's other columns that are read."""
        canonical = canonical_columns(self.quantities)
        rules = [rule for rule in self._selection.exclude if rule.column not in canonical]
        texts = [*self._groups, *self._selection.only]
        texts += [rule.column for rule in rules if rule.equals]
        for column in self._rules.values():
            texts += column.also
        names = {f"{_OWN}{text}": text for text in texts}
        for rule in rules:
            if not rule.equals:
                names[f"{_LIMIT}{rule.column}"] = rule.column
        return {key: self.file.header.position(name) for key, name in names.items()}

    @abstractmethod
    def _cells(self, block: Block) -> pd.DataFrame:
        """Give the cells of a block by canonical column, a row for each observation."""

    def frames(self) -> Iterator[pd.DataFrame]:
        """Give the observations of each block: canonical columns, groups, physical `row`."""
        if self._selection.keep == "last":
            yield from self._frames_of_last_events()
        else:
            for block in self.file.blocks:
                yield self._frame(self._observations(self._cells(block)))
        self._check_paths()

    def _frames_of_last_events(self) -> Iterator[pd.DataFrame]:
        """Give one frame, since the last event of a trial may stand in any block."""
        observations = (self._observations(self._cells(block)) for block in self.file.blocks)
        events = [self._last_events(data) for data in observations]
        if not events:
            return
        data = self._last_events(pd.concat(events))
        earlier = self.counts[_EARLIER]
        rows = earlier + len(data)
        text = (
            f'keep = "last" leaves out {earlier:,} of {rows:,} rows ({earlier / max(rows, 1):.1%})'
            " as earlier events of a trial"
        )
        if not self.numbered:
            text += "; no column numbers the trials, so one row stays per subject and environment"
        self._notice(text)
        yield self._frame(data)

    def _observations(self, data: pd.DataFrame) -> pd.DataFrame:
        """Select and check the observations of a block, and convert their numbers."""
        data = self._with_ids(data)
        data = self._selected(data)
        for canonical, rule in self._rules.items():
            if rule.path is not None:
                picked = self._picks(data[canonical], canonical, rule.path)
                data = data.assign(**{canonical: picked})
        adjusted = [f"{p}_adj" for p in self.quantities if p in self.parameters]
        blank = np.logical_and.reduce([_missing(data[column]) for column in adjusted])
        data = self._exclude(data, blank, "no adjustment", of_trials=True)
        self._check_ids(data)
        return self._converted(data)

    def _with_ids(self, data: pd.DataFrame) -> pd.DataFrame:
        """Join ids of several columns, and write ids and groups in one spelling."""
        if self._selection.subject == "row":
            stem = PurePath(self.name).stem
            data = data.assign(subject=[f"{stem} {row}" for row in data.index])
        for canonical, rule in self._rules.items():
            if rule.also:
                joined = self._joined(data, canonical, rule.also)
                data = data.assign(**{canonical: joined})
        groups = [f"{_OWN}{name}" for name in self._groups]
        for column in (*IDS, *groups):
            if column not in data:
                continue
            name = column.removeprefix(_OWN)
            settled = self.file.names.settle(name, data[column], self.name)
            data = data.assign(**{column: settled})
        return data

    def _joined(self, data: pd.DataFrame, canonical: str, also: tuple[str, ...]) -> list[str]:
        """Join ids of several columns; one that lacks a part is blank, and so missing."""
        columns = [data[canonical]]
        for name in also:
            columns.append(data[f"{_OWN}{name}"])
        records = list(zip(*columns, strict=True))
        ids: dict[tuple[str, ...], str] = {}
        for parts in records:
            if parts in ids:
                continue
            complete = all(part.strip() for part in parts)
            joined = "-".join(parts) if complete else ""
            ids[parts] = joined
            if joined and self._joins.setdefault(joined, parts) != parts:
                other = shown(self._joins[joined])
                message = f"{shown(parts)} and {other} both join to {joined!r}."
                hint = "Take the hyphens out of one of these columns."
                raise UsageError(message, hint=hint, **self._place(canonical))
        return [ids[parts] for parts in records]

    def _selected(self, data: pd.DataFrame) -> pd.DataFrame:
        """Keep the rows that the scene's rules on texts leave."""
        for name, texts in self._selection.only.items():
            kept = _among(data[f"{_OWN}{name}"], texts)
            data = self._keep(data, kept, f"{name} is not {' or '.join(texts)}")
        for rule in self._selection.exclude:
            if not rule.equals:
                continue
            column = f"{_OWN}{rule.column}"
            if column not in data:
                column = rule.column
            if column not in data:
                self.file.header.position(rule.column)
            excluded = _among(data[column], rule.equals)
            if excluded.any():
                self.applied.add(rule)
            data = self._exclude(data, excluded, rule.why)
        return data

    def _keep(self, data: pd.DataFrame, kept: _Mask, reason: str) -> pd.DataFrame:
        """Keep rows, and count the others by reason."""
        if kept.all():
            return data
        self.counts[reason] += int((~kept).sum())
        return data[kept]

    def _exclude(
        self, data: pd.DataFrame, excluded: _Mask, why: str, *, of_trials: bool = False
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
            exclusion = Exclusion(own["subject"], ", ".join(what), why, self.name, row)
            self.exclusions.append(exclusion)
        return self._keep(data, ~excluded, f"excluded: {why}")

    def _picks(self, cells: pd.Series[str], canonical: str, path: str) -> list[str]:
        """Values inside the JSON cells of a column."""
        picked = []
        for row, cell in zip(cells.index.tolist(), cells, strict=True):
            value: str | None = ""
            try:
                value = values.pick(cell, path)
            except values.CellError as error:
                # Only the scene knows whether such a row has no adjustment: it is no blank.
                hint = (
                    f"Correct the cell or the path of {canonical}, or pick rows with [sessions]"
                    " only."
                )
                place = self._place(canonical, row)
                self.problems.add(f"{error}.", value=cell, hint=hint, **place)
            if value is None:
                self._lacking.setdefault(canonical, cell)
            elif not values.is_missing(cell):
                self._picked.add(canonical)
            picked.append(value or "")
        return picked

    def _check_paths(self) -> None:
        """Refuse a path that no record has; records of other kinds of trial may lack it."""
        for canonical, cell in self._lacking.items():
            if canonical in self._picked:
                continue
            self.problems.add(
                "no row has this path.",
                key=f"columns.{canonical}.path",
                value=self._rules[canonical].path,
                hint=f"Correct it: it begins inside a cell such as {shown([cell])}.",
                **self._place(canonical),
            )

    def _check_ids(self, data: pd.DataFrame) -> None:
        """Refuse observations without an id, or without a number in a column of trials."""
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
                first = int(data.index[missing][0])
                message = (
                    f"{missing.sum()} of {len(data)} rows have no {column}: cells merged down?"
                )
                hint = "Write it in every row: unmerge the cells, and fill each down."
                self.problems.add(message, hint=hint, **self._place(column, first))
                continue
            for row in data.index[missing]:
                hint = "Fill it in, or leave such rows out with [sessions] only or exclude."
                place = self._place(column, row)
                self.problems.add(f"an adjustment has no {column}.", hint=hint, **place)

    def _converted(self, data: pd.DataFrame) -> pd.DataFrame:
        """Convert columns of numbers to percept's units, by the file's one decimal mark."""
        names = [name for name in data if name in self._number_columns or name == "trial"]
        texts = {name: data[name].tolist() for name in names if data[name].dtype != np.float64}
        rows = data.index.to_numpy()
        if self._mark is None and texts:
            columns = [(self._place(name)["column"], cells) for name, cells in texts.items()]
            self._mark = values.decimal_mark(columns, rows, file=self.name, problems=self.problems)
        numbers: dict[str, npt.NDArray[Any]] = {}
        for name, cells in texts.items():
            place = self._place(name)
            numbers[name] = values.parse_numbers(
                cells,
                rows,
                self._mark,
                self.problems,
                place,
                correct=_CORRECT,
                canonical=name,
            )
        quantities = with_mass(self.quantities)
        for name in names:
            rule = self._rules.get(name)
            if name == "trial" or rule is None:
                continue
            column = (numbers.get(name, data[name].to_numpy()) + rule.offset) * rule.scale
            if rule.response == "log":
                column = np.power(10.0, column)
            numbers[name] = convert(column, rule.unit, quantities[quantity_of(name)])
        if "trial" in data:
            trials = numbers.get("trial", data["trial"].to_numpy())
            numbers["trial"] = self._whole(trials, rows)
        return data.assign(**numbers)

    def _whole(
        self, trials: npt.NDArray[np.float64], rows: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64]:
        """Numbers of trials; those that are not whole are problems."""
        whole = (np.abs(trials) < _WHOLE) & (trials == np.round(trials))
        for position in np.flatnonzero(~whole & ~np.isnan(trials)).tolist():
            self.problems.add(
                "a trial number must be whole.",
                value=float(trials[position]),
                hint="Number the trials 1, 2, 3 …",
                **self._place("trial", rows[position]),
            )
        return np.where(whole, trials, 0).astype(np.int64)

    def _last_events(self, data: pd.DataFrame) -> pd.DataFrame:
        """Reduce each trial to its last event, with the last value of each number."""
        ids = [column for column in (*IDS, "trial") if column in data]
        numbers = [column for column in data if column in self._number_columns]
        last = data.groupby(ids, sort=False, dropna=False)[numbers].ffill()
        data = data.assign(**{column: last[column].to_numpy() for column in numbers})
        return self._keep(data, ~data.duplicated(ids, keep="last").to_numpy(), _EARLIER)

    def _within_limits(self, data: pd.DataFrame) -> pd.DataFrame:
        """Leave out what lies beyond a rule's limits; earlier events of a trial are gone by now."""
        for rule in self._selection.exclude:
            if rule.equals:
                continue
            column = rule.column if rule.column in data else f"{_LIMIT}{rule.column}"
            if column not in data or not pd.api.types.is_numeric_dtype(data[column]):
                key = f"sessions.exclude {rule.column}"
                raise UsageError("limits need a column of numbers.", key=key)
            numbers = data[column].to_numpy()
            outside = np.zeros(len(numbers), dtype=bool)
            if rule.below is not None:
                outside |= numbers < rule.below
            if rule.above is not None:
                outside |= numbers > rule.above
            data = self._exclude(data, outside, rule.why)
        return data

    def _frame(self, data: pd.DataFrame) -> pd.DataFrame:
        """Lay out canonical columns; what the file lacks is session and trial 1, or NaN."""
        data = self._within_limits(data)
        options = self.file.options
        defaults: dict[str, str | float] = dict.fromkeys(IDS, "1")
        defaults |= {f"{p}_ref": np.nan for p in options.quantities}
        defaults["trial"] = 1
        defaults |= {f"{p}_adj": np.nan for p in options.quantities}
        if MASS in data or any(MASS in own for own in options.environments.values()):
            defaults[MASS] = np.nan
        columns = {column: data.get(column, value) for column, value in defaults.items()}
        for name in self._groups:
            columns[name] = data[f"{_OWN}{name}"]
        frame = pd.DataFrame(columns, index=data.index).assign(row=data.index)
        return frame.astype(dict.fromkeys(IDS, "str"))


class LongTable(TrialTable):
    """A row for each observation."""

    def _cells(self, block: Block) -> pd.DataFrame:
        columns = {**self._own, **self.found.slots[0].columns}
        cells = self._parsed(block, columns)
        if cells is None:
            cells = self._counted(block).cells
        else:
            self.counts["rows read"] += len(cells)
        named = cells[list(columns.values())].set_axis(list(columns), axis=1)
        return named.assign(**self.file.ids)

    def _parsed(self, block: Block, columns: dict[str, int]) -> pd.DataFrame | None:
        """Split a plain block at the speed of pandas' parser; None where it may not be used."""
        numeric = {name for name in columns if name in self._number_columns or name == "trial"}
        numbers = {columns[name] for name in numeric}
        texts = {columns[name] for name in columns.keys() - numeric}
        comma_may_be_decimal = self._mark is None and block.dialect.delimiter != ","
        if (
            texts & numbers
            or any(rule.path is not None for rule in self._rules.values())
            or any(rule.equals and rule.column in numeric for rule in self._selection.exclude)
            or (comma_may_be_decimal and "," in block.text)
        ):
            return None
        return block.read_plain(sorted(texts), sorted(numbers), self._mark or ".")


class WideTable(TrialTable):
    """A row for several observations: each slot of the header gives one."""

    def _cells(self, block: Block) -> pd.DataFrame:
        cells = self._counted(block).cells
        parts = []
        for slot in self.found.slots:
            columns = {**self._own, **slot.columns}
            part = cells[list(columns.values())].set_axis(list(columns), axis=1)
            fixed = dict(self.file.ids)
            if slot.environment is not None:
                fixed.setdefault("environment", slot.environment)
            if slot.trial is not None:
                fixed["trial"] = slot.trial
            parts.append(part.assign(**fixed))
        # Columns of other slots are blank in this one.
        return pd.concat(parts).fillna("").sort_index(kind="stable")


def _among(cells: pd.Series[Any], texts: Sequence[str]) -> _Mask:
    """Which cells hold one of the texts, however it is spelled."""
    wanted = {values.fold(text) for text in texts}
    spelled = [cell for cell in cells.unique() if values.fold(str(cell)) in wanted]
    return cells.isin(spelled).to_numpy()


def _missing(cells: pd.Series[Any]) -> _Mask:
    """Which cells say that there is no value."""
    blank = cells.isna() if cells.dtype == np.float64 else cells.map(values.is_missing)
    return blank.to_numpy(dtype=bool)
