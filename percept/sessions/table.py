"""One file's cells to its observations, block by block: rows selected, numbers and units converted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions import values
from percept.sessions.columns import Resolution, Slot, check_columns, resolve, unused_columns
from percept.sessions.grids import Block, Grid, plain_columns
from percept.sessions.options import KEPT_COLUMNS, ExcludeRule, ReadOptions, canonical_columns
from percept.sessions.quantities import convert, numbers_of, quantity_of, with_mass
from percept.sessions.records import IDS, MASS, Exclusion, Notice, Problems, shown
from percept.sessions.summary import read_summary

#: Columns of a block by name: texts as read, numbers as doubles, and `row`, the physical row of each.
_Columns = dict[str, npt.NDArray[Any]]
_MEND = "Correct the cell, or leave it empty if there was no adjustment."
#: Above this, doubles do not tell whole numbers apart.
_WHOLE = 2.0**53


class FileTable:
    """One file: where its columns stand, its observations, and what became of its rows."""

    def __init__(
        self,
        name: str,
        blocks: Iterator[Block],
        options: ReadOptions,
        named: Mapping[str, str],
        problems: Problems,
    ) -> None:
        self.name, self.options, self.named, self.problems = name, options, named, problems
        self._numbers, self._canonical = numbers_of(options.quantities), canonical_columns(options.quantities)
        first = next(blocks)
        self._blocks = chain([first], blocks)
        self.header = header = first.grid().header
        self.counts: Counter[str] = Counter()  # Rows by what became of them
        self.exclusions: list[Exclusion] = []
        self.found: Resolution = resolve(header, options, file=name)
        if options.trial == "order":
            self.found = self.found.without("trial")
        self.form = self.found.form
        rules = self.found.rules
        self.notices = [Notice(text, name) for text in self.found.announced]
        self.notices += [
            Notice(f"{c} is taken from the file's name; column {rules[c].name!r} is not used", name)
            for c in sorted(named.keys() & rules.keys())
        ]
        if unused := unused_columns(header, self.found, options):
            self.notices.append(Notice(f"columns not used: {shown(unused)}", name))
        self.numbered = "trial" in rules or any(slot.trial for slot in self.found.slots)
        self.declared_units = {c for c, rule in rules.items() if rule.unit is not None}
        self.parameters: set[str] = set()
        if self.form == "trials":
            check_columns(header, self.found, options, named, file=name)
            self.parameters = {p for p in options.quantities if f"{p}_adj" in rules}
            self._prepare()

    def _prepare(self) -> None:
        options = self.options
        self._mark = None if options.decimal is None else values.DecimalMark(options.decimal)
        self._groups = list(dict.fromkeys([*(c for c in KEPT_COLUMNS if c in self.header), *options.groups]))
        rules = [rule for rule in options.exclude if rule.column not in self._canonical]
        own = [*self._groups, *options.only, *(rule.column for rule in rules if rule.equals)]
        own += [name for rule in self.found.rules.values() for name in rule.also]
        self._own = {f"own:{name}": self._position(name) for name in own}
        self._limited = {f"limit:{r.column}": self._position(r.column) for r in rules if not r.equals}
        # What JSON cells lack: the keys found instead, and whether any cell had the path.
        self._lacking: dict[str, dict[str, None]] = {}
        self._picked: set[str] = set()
        self._joins: dict[str, list[str]] = {}  # From a joined id to its parts

    def _position(self, name: str) -> int:
        if self.header.count(name) != 1:
            message = "this column is wanted, and is not there or there twice."
            hint = f"The columns are {shown(self.header)}."
            raise UsageError(message, file=self.name, row=1, column=name, hint=hint)
        return self.header.index(name)

    def _place(self, column: str, row: int | None = None) -> dict[str, Any]:
        """Where a canonical or an own column stands, for messages."""
        rule = self.found.rules.get(column)
        name = column.removeprefix("limit:") if rule is None else rule.name
        return {"file": self.name, "column": name} | ({} if row is None else {"row": int(row)})

    def frames(self) -> Iterator[pd.DataFrame]:
        """Give the observations of each block: canonical columns, groups, and the physical `row` of each."""
        events: list[_Columns] = []
        for block in self._blocks:
            if self.form == "summary":
                yield self._summary(block.grid())
                continue
            data = self._observations(self._fast(block) or self._cells(block.grid()))
            if self.options.keep is None:
                yield self._frame(self._within_limits(data))
            else:
                events.append(self._last_events(data))
        if events:
            data = self._last_events({c: np.concatenate([e[c] for e in events]) for c in events[0]})
            earlier, kept = self.counts["earlier event of a trial"], len(data["row"])
            text = f'keep = "last" leaves out {earlier:,} of {earlier + kept:,} rows '
            text += f"({earlier / max(earlier + kept, 1):.1%}) as earlier events of a trial"
            if not self.numbered:
                text += "; no column numbers the trials, so that of a subject in an environment one row stays"
            self.notices.append(Notice(text, self.name))
            yield self._frame(self._within_limits(data))
        if self.form == "trials":
            self._check_paths()

    def _summary(self, grid: Grid) -> pd.DataFrame:
        self._count(grid)
        return read_summary(grid, self.found, self.name, self.options, self.problems, self.notices)

    def _count(self, grid: Grid) -> None:
        self.counts["rows read"] += len(grid.cells)
        self.counts.update(grid.dropped)

    def _cells(self, grid: Grid) -> _Columns:
        """Take columns out of records; of a wide table each record gives a row for each of its slots."""
        self._count(grid)
        slots = [self._slot(slot, grid) for slot in self.found.slots]
        columns = {
            c: np.array([slot[c] for slot in slots], dtype=object).reshape(len(slots), -1).T.ravel()
            for c in slots[0]
        }
        return columns | {"row": np.repeat(np.array(grid.rows, dtype=np.int64), len(slots))}

    def _slot(self, slot: Slot, grid: Grid) -> dict[str, list[str]]:
        count = len(grid.cells)
        # Columns of other slots are blank in this one.
        out = {c: [""] * count for c in self._canonical if any(c in s.columns for s in self.found.slots)}
        columns = {**slot.columns, **self._own, **self._limited}
        out |= {c: [record[at] for record in grid.cells] for c, at in columns.items()}
        fixed = {"environment": slot.environment, "trial": slot.trial, **self.named}
        return out | {c: [value] * count for c, value in fixed.items() if value is not None}

    def _fast(self, block: Block) -> _Columns | None:
        """Take columns of a plain block at the speed of pandas' parser; None where it may not be used."""
        layout, slot = block.layout, self.found.slots[0]
        numbers = {c: at for c, at in slot.columns.items() if c in (*self._numbers, "trial")} | self._limited
        texts = {c: at for c, at in {**slot.columns, **self._own}.items() if c not in numbers}
        by_text = {rule.column for rule in self.options.exclude if rule.equals}
        if (
            block.cells is not None
            or layout is None
            or len(self.found.slots) > 1
            or slot.environment is not None
            or any(rule.path is not None for rule in self.found.rules.values())
            or by_text & numbers.keys()
            or set(texts.values()) & set(numbers.values())
            or (self._mark is None and layout.delimiter != "," and "," in block.text)
        ):
            return None
        sign = "." if self._mark is None else self._mark.sign
        columns = plain_columns(block, sorted(set(texts.values())), sorted(set(numbers.values())), sign)
        if columns is None:
            return None
        data = {c: columns[at] for c, at in (texts | numbers).items()}
        trial = data.get("trial", np.ones(1))
        if not ((np.abs(trial) < _WHOLE) & (trial == np.round(trial))).all():
            return None
        count = len(next(iter(data.values())))
        self.counts["rows read"] += count
        data |= {c: np.full(count, value, dtype=object) for c, value in self.named.items()}
        return data | {"row": np.arange(block.first_row, block.first_row + count)}

    def _observations(self, data: _Columns) -> _Columns:
        """Select and check the observations of a block, and convert their numbers."""
        data |= {c: self._joined(data, c, rule.also) for c, rule in self.found.rules.items() if rule.also}
        for name, texts in self.options.only.items():
            data = self._keep(data, _among(data[f"own:{name}"], texts), f"{name} is not {' or '.join(texts)}")
        for rule in (rule for rule in self.options.exclude if rule.equals):
            key = rule.column if rule.column in self._canonical else f"own:{rule.column}"
            if key not in data:
                self._position(rule.column)
            data = self._exclude(data, _among(data[key], rule.equals), rule.why)
        for canonical, found in self.found.rules.items():
            if found.path is not None:
                data[canonical] = self._pick(data, canonical, found.path)
        blank = np.logical_and.reduce(
            [_blank(data[c]) for c in self._numbers if c.endswith("_adj") and c in data]
        )
        data = self._exclude(data, blank, "no adjustment", of_trials=True)
        for c in (*IDS, "trial"):
            for at in self._without(data, c):
                hint = "Fill it in, or leave such rows out with [sessions] only or exclude."
                self.problems.add(f"an adjustment without {c}.", hint=hint, **self._place(c, data["row"][at]))
        self._convert(data)
        return data

    @staticmethod
    def _without(data: _Columns, c: str) -> Sequence[int]:
        """Rows whose id is blank; ids are few, so that they are looked at once each."""
        cells = data.get(c)
        if cells is None or cells.dtype != object or all(name.strip() for name in pd.unique(cells)):
            return ()
        return [at for at, cell in enumerate(cells) if not cell.strip()]

    def _keep(self, data: _Columns, mask: npt.NDArray[np.bool_], reason: str) -> _Columns:
        if mask.all():
            return data
        self.counts[reason] += int((~mask).sum())
        return {c: column[mask] for c, column in data.items()}

    def _exclude(
        self, data: _Columns, out: npt.NDArray[np.bool_], why: str, *, of_trials: bool = False
    ) -> _Columns:
        """Leave rows out and log them, or `of_trials` those alone that have a subject and an environment."""
        for at in np.flatnonzero(out).tolist():
            ids = {c: str(data[c][at]) if c in data else "" for c in (*IDS, "trial")}
            who = ids.pop("subject")
            if not of_trials or (who.strip() and ids["environment"].strip()):
                what = ", ".join(f"{c} {name}" for c, name in ids.items() if name)
                self.exclusions.append(Exclusion(who, what, why, self.name, int(data["row"][at])))
        return self._keep(data, ~out, f"excluded: {why}")

    def _joined(self, data: _Columns, canonical: str, also: Sequence[str]) -> npt.NDArray[np.object_]:
        """Ids made of several columns; one that lacks a part is blank, and so is told as missing."""
        parts = pd.DataFrame({canonical: data[canonical], **{name: data[f"own:{name}"] for name in also}})
        combinations = parts.drop_duplicates().to_numpy().tolist()
        ids = ["-".join(texts) if all(text.strip() for text in texts) else "" for texts in combinations]
        for texts, name in zip(combinations, ids, strict=True):
            if name and self._joins.setdefault(name, texts) != texts:
                message = f"{shown(texts)} and {shown(self._joins[name])} both join to {name!r}."
                hint = "Take the hyphens out of one of these columns."
                raise UsageError(message, hint=hint, **self._place(canonical))
        return np.array(ids, dtype=object)[parts.groupby(list(parts), sort=False).ngroup().to_numpy()]

    def _pick(self, data: _Columns, canonical: str, path: str) -> npt.NDArray[np.object_]:
        """Values inside the JSON cells of a column."""
        picked = np.full(len(data["row"]), "", dtype=object)
        for at, cell in enumerate(data[canonical]):
            try:
                picked[at] = values.pick(cell, path)
                if not values.is_missing(cell):
                    self._picked.add(canonical)
            except values.CellError as error:
                if error.keys is not None:
                    # Records of other kinds of trial lack the key; a path that no record has is a wrong one.
                    self._lacking.setdefault(canonical, {}).update(dict.fromkeys(error.keys))
                    continue
                self._picked.add(canonical)
                # Whether such a row holds no adjustment is the scene's to say, hence a problem, not a blank.
                message = f"{error}."
                hint = f"Correct the cell or the path of {canonical}, or pick rows with [sessions] only."
                self.problems.add(message, value=cell, hint=hint, **self._place(canonical, data["row"][at]))
        return picked

    def _check_paths(self) -> None:
        for canonical in (c for c in self._lacking if c not in self._picked):
            keys = shown(list(self._lacking[canonical]))
            self.problems.add(
                f"no row has this path; the keys there are {keys or 'none'}.",
                key=f"columns.{canonical}.path",
                value=self.found.rules[canonical].path,
                hint="A path begins inside the cell; correct it, or pick rows with [sessions] only.",
                **self._place(canonical),
            )

    def _convert(self, data: _Columns) -> None:
        """Convert columns of numbers to doubles in percept's units, by the file's one decimal mark."""
        names = [c for c in (*self._numbers, "trial", *self._limited) if c in data]
        texts = {c: data[c] for c in names if data[c].dtype == object}
        if self._mark is None and texts:
            columns = [(self._place(c)["column"], cells.tolist()) for c, cells in texts.items()]
            self._mark = values.decimal_mark(
                columns, data["row"].tolist(), file=self.name, problems=self.problems
            )
        for c, cells in texts.items():
            data[c] = values.parse_numbers(
                cells.tolist(), data["row"].tolist(), self._mark, self.problems, _MEND, **self._place(c)
            )
        for c, rule in ((c, self.found.rules[c]) for c in self._numbers if c in data):
            if rule.unit is not None or rule.offset:
                quantity = with_mass(self.options.quantities)[quantity_of(c)]
                data[c] = convert(data[c] + rule.offset, rule.unit, quantity)
        if "trial" in data:
            trial = data["trial"]
            whole = (np.abs(trial) < _WHOLE) & (trial == np.round(trial))
            for at in np.flatnonzero(~whole & ~np.isnan(trial)):
                self.problems.add(
                    "a trial's number must be whole.",
                    value=texts["trial"][at] if "trial" in texts else float(trial[at]),
                    hint="Number the trials 1, 2, 3 …",
                    **self._place("trial", data["row"][at]),
                )
            data["trial"] = np.where(whole, trial, 0).astype(np.int64)

    def _last_events(self, data: _Columns) -> _Columns:
        """Reduce each trial to its last event, with the last value of each number."""
        ids = [c for c in (*IDS, "trial") if c in data]
        numbers = [c for c in (*self._numbers, *self._limited) if c in data]
        events = pd.DataFrame({c: data[c] for c in (*ids, *numbers)})
        events[numbers] = events.groupby(ids, sort=False, dropna=False)[numbers].ffill()
        data = data | {c: events[c].to_numpy(dtype=float) for c in numbers}
        last = ~events.duplicated(ids, keep="last").to_numpy()
        return self._keep(data, last, "earlier event of a trial")

    def _within_limits(self, data: _Columns) -> _Columns:
        """Leave out what lies beyond a rule's limits; earlier events of a trial are gone by now."""
        for rule in (rule for rule in self.options.exclude if not rule.equals):
            column = self._limited_by(data, rule)
            out = np.zeros(len(column), dtype=bool)
            if rule.below is not None:
                out |= column < rule.below
            if rule.above is not None:
                out |= column > rule.above
            data = self._exclude(data, out, rule.why)
        return data

    def _limited_by(self, data: _Columns, rule: ExcludeRule) -> npt.NDArray[Any]:
        for key in (rule.column, f"limit:{rule.column}"):
            if key in data and data[key].dtype != object:
                return data[key]
        raise UsageError("limits need a column of numbers.", key=f"sessions.exclude {rule.column}")

    def _frame(self, data: _Columns) -> pd.DataFrame:
        """Lay out canonical columns; what the file lacks is session and trial 1, or NaN."""
        count = len(data["row"])
        one, nan = np.full(count, "1", dtype=object), np.full(count, np.nan)
        columns: dict[str, Any] = {c: data.get(c, one) for c in IDS}
        names = list(self.options.quantities)
        columns |= {f"{p}_ref": data.get(f"{p}_ref", nan) for p in names}
        columns["trial"] = data.get("trial", np.ones(count, dtype=np.int64))
        columns |= {f"{p}_adj": data.get(f"{p}_adj", nan) for p in names}
        if MASS in data or any(MASS in references for references in self.options.environments.values()):
            columns[MASS] = data.get(MASS, nan)
        columns |= {g: data[f"own:{g}"] for g in self._groups}
        return pd.DataFrame(columns | {"row": data["row"]})


def _among(cells: npt.NDArray[Any], texts: Sequence[str]) -> npt.NDArray[np.bool_]:
    wanted = set(texts)
    return np.array([cell in wanted for cell in cells], dtype=bool)


def _blank(cells: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    if cells.dtype != object:
        return np.isnan(cells)
    return np.array([values.is_missing(cell) for cell in cells], dtype=bool)
