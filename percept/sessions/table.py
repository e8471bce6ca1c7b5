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
from percept.sessions.columns import check_columns, position, resolve, unused_columns
from percept.sessions.grids import Block, Grid
from percept.sessions.options import KEPT_COLUMNS, ReadOptions, canonical_columns
from percept.sessions.quantities import convert, numbers_of, quantity_of, with_mass
from percept.sessions.records import IDS, MASS, Exclusion, Notice, Problems, shown
from percept.sessions.values import Names, fold

_LIMITS, _MOMENTS = ("lower", "upper"), ("mean", "sd")
#: Limits at any level give back the mean and SD they were made of.
_LEVEL = 0.95
_MEND = "Correct the cell, or leave it empty if there was no adjustment."
#: Above this, doubles do not tell whole numbers apart.
_WHOLE = 2.0**53
_Mask = npt.NDArray[np.bool_]


class FileTable:
    """One file: where its columns stand, its observations, and what became of its rows.

    In frames of a block the index is the physical line. Columns are canonical ones, "own:NAME" for
    texts and "limit:NAME" for numbers of the file's other columns.
    """

    def __init__(
        self,
        name: str,
        blocks: Iterator[Block],
        options: ReadOptions,
        named: Mapping[str, str],
        problems: Problems,
        names: Names,
    ) -> None:
        self.name, self.options, self.named, self.problems = name, options, named, problems
        self._names = names
        first = next(blocks)
        self._blocks = chain([first], blocks)
        self.header = header = first.grid().header
        self.counts: Counter[str] = Counter()  # Rows by what became of them
        self.exclusions: list[Exclusion] = []
        self.found = resolve(header, options, file=name)
        self.form, self._rules = self.found.form, self.found.rules
        notices = list(self.found.announced)
        for c in sorted(named.keys() & self._rules.keys()):
            column = self._rules[c].name
            notices.append(f"{c} is taken from the file's name; column {column!r} is not used")
        if unused := unused_columns(header, self.found, options):
            notices.append(f"columns not used: {shown(unused)}")
        self.notices = [Notice(text, name) for text in notices]
        self.numbered = "trial" in self._rules or any(slot.trial for slot in self.found.slots)
        self.declared_units = {c for c, rule in self._rules.items() if rule.unit is not None}
        self.parameters: set[str] = set()
        self._mark = options.sessions.decimal
        if self.form == "trials":
            check_columns(header, self.found, options, named, file=name)
            self.parameters = {p for p in options.quantities if f"{p}_adj" in self._rules}
            self._prepare()

    def _prepare(self) -> None:
        """Find the file's other columns that are read."""
        own = self.options.sessions
        self._groups = list(
            dict.fromkeys([*(c for c in KEPT_COLUMNS if c in self.header), *own.groups])
        )
        canonical = canonical_columns(self.options.quantities)
        rules = [rule for rule in own.exclude if rule.column not in canonical]
        texts = [*self._groups, *own.only, *(rule.column for rule in rules if rule.equals)]
        texts += [name for rule in self._rules.values() for name in rule.also]
        limits = [rule.column for rule in rules if not rule.equals]
        places = {f"own:{name}": name for name in texts} | {
            f"limit:{name}": name for name in limits
        }
        self._own = {c: position(self.header, name, self.name) for c, name in places.items()}
        self._numbers = {
            *numbers_of(self.options.quantities),
            *(c for c in places if c.startswith("limit:")),
        }
        # Of columns with a path: a cell that lacks it, and whether any cell had it.
        self._lacking: dict[str, str] = {}
        self._picked: set[str] = set()
        self._joins: dict[str, tuple[str, ...]] = {}  # From a joined id to its parts

    def _place(self, column: str, row: int | None = None) -> dict[str, Any]:
        """Where a canonical or an own column stands, for messages."""
        rule = self._rules.get(column)
        name = column.removeprefix("limit:") if rule is None else rule.name
        return {"file": self.name, "column": name} | ({} if row is None else {"row": int(row)})

    def frames(self) -> Iterator[pd.DataFrame]:
        """Give the observations of each block: canonical columns, groups, and the physical `row` of each."""
        events: list[pd.DataFrame] = []
        for block in self._blocks:
            if self.form == "summary":
                yield self._summary(self._counted(block))
            elif self.options.sessions.keep is None:
                yield self._frame(self._within_limits(self._observations(self._cells(block))))
            else:
                events.append(self._last_events(self._observations(self._cells(block))))
        if events:
            data = self._last_events(pd.concat(events))
            earlier, kept = self.counts["earlier event of a trial"], len(data)
            text = f'keep = "last" leaves out {earlier:,} of {earlier + kept:,} rows '
            text += f"({earlier / max(earlier + kept, 1):.1%}) as earlier events of a trial"
            if not self.numbered:
                text += (
                    "; no column numbers the trials, so that of a subject in an environment one row"
                    " stays"
                )
            self.notices.append(Notice(text, self.name))
            yield self._frame(self._within_limits(data))
        if self.form == "trials":
            self._check_paths()

    def _counted(self, block: Block) -> Grid:
        grid = block.grid()
        self.counts["rows read"] += len(grid.cells)
        self.counts.update(grid.dropped)
        return grid

    def _summary(self, grid: Grid) -> pd.DataFrame:
        """Read a published table of limits, or of means and standard deviations."""
        columns = self.found.slots[0].columns
        limits = all(c in columns for c in _LIMITS)
        numbers = ["reference", *(_LIMITS if limits else _MOMENTS), "n"]
        numbers += ["level"] if limits or "level" in columns else []
        for c in (c for c in ("environment", *numbers) if c not in columns):
            message = f"a summary needs the column {c}; the columns are {shown(grid.header)}."
            hint = "Add it, or name it in the scene's [columns]."
            raise UsageError(message, file=self.name, row=1, column=c, hint=hint)
        if self.declared_units:
            units = " and ".join(quantity.unit for quantity in self.options.quantities.values())
            message, hint = f"units of a summary are {units}.", "Convert the table."
            raise UsageError(message, file=self.name, key="columns", hint=hint)
        text, rows = (
            {c: grid.cells[at].tolist() for c, at in columns.items()},
            grid.cells.index.to_numpy(),
        )
        problems, file = self.problems, self.name
        cells = [(c, text[c]) for c in numbers]
        mark = self._mark or values.decimal_mark(cells, rows, file=file, problems=problems)
        frame: dict[str, Any] = {"environment": text["environment"], "parameter": text["parameter"]}
        for c in numbers:
            place: dict[str, Any] = {"file": file, "column": c}
            frame[c] = values.parse_numbers(text[c], rows, mark, problems, **place)
            for row in rows[[values.is_missing(cell) for cell in text[c]]].tolist():
                problems.add(
                    "a summary leaves no cell empty.", hint="Fill it in.", row=row, **place
                )
        if "level" not in frame:
            frame["level"] = np.full(len(rows), _LEVEL)
            kept = f"means and SDs without a level are kept as their limits at {_LEVEL}"
            self.notices.append(Notice(kept, file))
        if limits and any(c in columns for c in _MOMENTS):
            self.notices.append(Notice("mean and sd are not used: lower and upper are there", file))
        elif not limits:
            mean, sd, n, level = frame.pop("mean"), frame.pop("sd"), frame["n"], frame["level"]
            for at in np.flatnonzero(sd < 0).tolist():
                where = {"file": file, "row": int(rows[at]), "column": "sd", "value": float(sd[at])}
                problems.add("is negative.", hint="Correct it.", **where)
            from scipy.special import stdtrit

            # Impossible n and levels are told by the study's checks.
            possible = (n >= 2) & (level > 0) & (level < 1)
            df, tail = (
                np.where(possible, n - 1, np.nan),
                np.where(possible, (1 - level) / 2, np.nan),
            )
            half = -stdtrit(df, tail) / np.sqrt(df + 1) * sd
            frame |= {"lower": mean - half, "upper": mean + half}
        return pd.DataFrame(frame | {"row": rows})

    def _cells(self, block: Block) -> pd.DataFrame:
        """Take columns out of records; of a wide table each record gives a row for each of its slots."""
        cells = self._plain(block)
        if cells is None:
            cells = self._counted(block).cells
        parts = []
        for slot in self.found.slots:
            columns = {**self._own, **slot.columns}
            part = cells[list(columns.values())].set_axis(list(columns), axis=1)
            fixed = {"environment": slot.environment, "trial": slot.trial, **self.named}
            parts.append(part.assign(**{c: text for c, text in fixed.items() if text is not None}))
        # Columns of other slots are blank in this one.
        return (
            parts[0] if len(parts) == 1 else pd.concat(parts).fillna("").sort_index(kind="stable")
        )

    def _plain(self, block: Block) -> pd.DataFrame | None:
        """Split a plain block at the speed of pandas' parser; None where it may not be used."""
        slot = self.found.slots[0]
        columns = {**slot.columns, **self._own}
        numeric = {c for c in columns if c in self._numbers or c == "trial"}
        numbers, texts = (
            {columns[c] for c in numeric},
            {columns[c] for c in columns.keys() - numeric},
        )
        if (
            slot.environment is not None
            or any(rule.path is not None for rule in self._rules.values())
            or any(rule.equals and rule.column in numeric for rule in self.options.sessions.exclude)
            or texts & numbers
            or (self._mark is None and block.dialect.delimiter != "," and "," in block.text)
        ):
            return None
        cells = block.plain(sorted(texts), sorted(numbers), self._mark or ".")
        if cells is not None:
            self.counts["rows read"] += len(cells)
        return cells

    def _observations(self, data: pd.DataFrame) -> pd.DataFrame:
        """Select and check the observations of a block, and convert their numbers."""
        own = self.options.sessions
        for canonical, rule in self._rules.items():
            if rule.also:
                data = data.assign(**{canonical: self._joined(data, canonical, rule.also)})
        for c in (c for c in (*IDS, *(f"own:{name}" for name in self._groups)) if c in data):
            data = data.assign(
                **{c: self._names.settle(c.removeprefix("own:"), data[c], self.name)}
            )
        for name, texts in own.only.items():
            kept = _among(data[f"own:{name}"], texts)
            data = self._keep(data, kept, f"{name} is not {' or '.join(texts)}")
        for left in (rule for rule in own.exclude if rule.equals):
            key = f"own:{left.column}" if f"own:{left.column}" in data else left.column
            if key not in data:
                position(self.header, left.column, self.name)
            data = self._exclude(data, _among(data[key], left.equals), left.why)
        for canonical, rule in self._rules.items():
            if rule.path is not None:
                data = data.assign(
                    **{canonical: self._picks(data[canonical], canonical, rule.path)}
                )
        adjusted = [f"{p}_adj" for p in self.options.quantities if p in self.parameters]
        blank = np.logical_and.reduce([_missing(data[c]) for c in adjusted])
        data = self._exclude(data, blank, "no adjustment", of_trials=True)
        for c in (c for c in (*IDS, "trial") if c in data):
            # Ids are few, so that each is looked at once.
            empty = () if c == "trial" else [name for name in data[c].unique() if not name.strip()]
            for row in data.index[_missing(data[c]) if c == "trial" else data[c].isin(empty)]:
                hint = "Fill it in, or leave such rows out with [sessions] only or exclude."
                self.problems.add(f"an adjustment without {c}.", hint=hint, **self._place(c, row))
        return self._converted(data)

    def _keep(self, data: pd.DataFrame, kept: _Mask, reason: str) -> pd.DataFrame:
        if kept.all():
            return data
        self.counts[reason] += int((~kept).sum())
        return data[kept]

    def _exclude(
        self, data: pd.DataFrame, out: _Mask, why: str, *, of_trials: bool = False
    ) -> pd.DataFrame:
        """Leave rows out and log them, or `of_trials` those alone that have a subject and an environment."""
        ids = data[out].reindex(columns=[*IDS, "trial"], fill_value="").astype(str)
        for row, who, *others in ids.itertuples():
            if not of_trials or (who.strip() and others[1].strip()):
                names = [name.removesuffix(".0") for name in others]
                what = (
                    f"{c} {name}" for c, name in zip(ids.columns[1:], names, strict=True) if name
                )
                self.exclusions.append(Exclusion(who, ", ".join(what), why, self.name, int(row)))
        return self._keep(data, ~out, f"excluded: {why}")

    def _joined(self, data: pd.DataFrame, canonical: str, also: tuple[str, ...]) -> list[str]:
        """Ids made of several columns; one that lacks a part is blank, and so is told as missing."""
        records = list(
            zip(*(data[c] for c in (canonical, *(f"own:{name}" for name in also))), strict=True)
        )
        ids = {texts: "-".join(texts) if all(map(str.strip, texts)) else "" for texts in records}
        for texts, name in ids.items():
            if name and self._joins.setdefault(name, texts) != texts:
                message = f"{shown(texts)} and {shown(self._joins[name])} both join to {name!r}."
                hint = "Take the hyphens out of one of these columns."
                raise UsageError(message, hint=hint, **self._place(canonical))
        return [ids[texts] for texts in records]

    def _picks(self, cells: pd.Series[str], canonical: str, path: str) -> list[str]:
        """Values inside the JSON cells of a column."""
        picked = []
        for row, cell in zip(cells.index.tolist(), cells, strict=True):
            value: str | None = ""
            try:
                value = values.pick(cell, path)
            except values.CellError as error:
                # Whether such a row holds no adjustment is the scene's to say, hence a problem, no
                # blank.
                hint = (
                    f"Correct the cell or the path of {canonical}, or pick rows with [sessions]"
                    " only."
                )
                self.problems.add(f"{error}.", value=cell, hint=hint, **self._place(canonical, row))
            if value is None:
                self._lacking.setdefault(canonical, cell)
            elif not values.is_missing(cell):
                self._picked.add(canonical)
            picked.append(value or "")
        return picked

    def _check_paths(self) -> None:
        """Refuse a path that no record has; records of other kinds of trial may lack it."""
        for canonical in (c for c in self._lacking if c not in self._picked):
            key, path = f"columns.{canonical}.path", self._rules[canonical].path
            hint = (
                f"Correct it: it begins inside a cell such as {shown([self._lacking[canonical]])}."
            )
            place = self._place(canonical)
            self.problems.add("no row has this path.", key=key, value=path, hint=hint, **place)

    def _converted(self, data: pd.DataFrame) -> pd.DataFrame:
        """Convert columns of numbers to doubles in percept's units, by the file's one decimal mark."""
        names = [c for c in map(str, data) if c in self._numbers or c == "trial"]
        texts = {c: data[c].tolist() for c in names if data[c].dtype != np.float64}
        rows = data.index.to_numpy()
        if self._mark is None and texts:
            columns = [(self._place(c)["column"], cells) for c, cells in texts.items()]
            self._mark = values.decimal_mark(columns, rows, file=self.name, problems=self.problems)
        numbers: dict[str, npt.NDArray[Any]] = {
            c: values.parse_numbers(cells, rows, self._mark, self.problems, _MEND, **self._place(c))
            for c, cells in texts.items()
        }
        quantities = with_mass(self.options.quantities)
        for c, rule in ((c, self._rules[c]) for c in names if c in self._rules and c != "trial"):
            if rule.unit is not None or rule.offset:
                found = numbers.get(c, data[c].to_numpy()) + rule.offset
                numbers[c] = convert(found, rule.unit, quantities[quantity_of(c)])
        if "trial" in data:
            trial = numbers.get("trial", data["trial"].to_numpy())
            whole = (np.abs(trial) < _WHOLE) & (trial == np.round(trial))
            for at in np.flatnonzero(~whole & ~np.isnan(trial)).tolist():
                place = self._place("trial", rows[at]) | {"value": float(trial[at])}
                hint = "Number the trials 1, 2, 3 …"
                self.problems.add("a trial's number must be whole.", hint=hint, **place)
            numbers["trial"] = np.where(whole, trial, 0).astype(np.int64)
        return data.assign(**numbers)

    def _last_events(self, data: pd.DataFrame) -> pd.DataFrame:
        """Reduce each trial to its last event, with the last value of each number."""
        ids = [c for c in (*IDS, "trial") if c in data]
        numbers = [c for c in map(str, data) if c in self._numbers]
        last = data.groupby(ids, sort=False, dropna=False)[numbers].ffill()
        data = data.assign(**{c: last[c].to_numpy() for c in numbers})
        return self._keep(
            data, ~data.duplicated(ids, keep="last").to_numpy(), "earlier event of a trial"
        )

    def _within_limits(self, data: pd.DataFrame) -> pd.DataFrame:
        """Leave out what lies beyond a rule's limits; earlier events of a trial are gone by now."""
        for rule in (rule for rule in self.options.sessions.exclude if not rule.equals):
            key = rule.column if rule.column in data else f"limit:{rule.column}"
            if key not in data or not pd.api.types.is_numeric_dtype(data[key]):
                raise UsageError(
                    "limits need a column of numbers.", key=f"sessions.exclude {rule.column}"
                )
            low = -np.inf if rule.below is None else rule.below
            high = np.inf if rule.above is None else rule.above
            column = data[key].to_numpy()
            data = self._exclude(data, (column < low) | (column > high), rule.why)
        return data

    def _frame(self, data: pd.DataFrame) -> pd.DataFrame:
        """Lay out canonical columns; what the file lacks is session and trial 1, or NaN."""
        lacking: dict[str, Any] = dict.fromkeys(IDS, "1")
        lacking |= {f"{p}_ref": np.nan for p in self.options.quantities} | {"trial": 1}
        lacking |= {f"{p}_adj": np.nan for p in self.options.quantities}
        if MASS in data or any(
            MASS in references for references in self.options.environments.values()
        ):
            lacking[MASS] = np.nan
        columns = {c: data.get(c, value) for c, value in lacking.items()}
        columns |= {name: data[f"own:{name}"] for name in self._groups}
        frame = pd.DataFrame(columns | {"row": data.index}, index=data.index)
        return frame.astype(dict.fromkeys(IDS, "str"))


def _among(cells: pd.Series[Any], texts: Sequence[str]) -> _Mask:
    """Which cells hold one of the texts, however it is spelled."""
    wanted = {fold(text) for text in texts}
    return cells.isin([cell for cell in cells.unique() if fold(str(cell)) in wanted]).to_numpy()


def _missing(cells: pd.Series[Any]) -> _Mask:
    """Which cells say that there is no value."""
    blank = cells.isna() if cells.dtype == np.float64 else cells.map(values.is_missing)
    return blank.to_numpy(dtype=bool)
