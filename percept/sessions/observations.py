"""One file's grid of text to its observations: rows selected, cells picked, numbers and units converted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions.cells import CellError, NoKeyError, pick
from percept.sessions.columns import Resolution, Slot, resolve
from percept.sessions.dialect import Grid
from percept.sessions.numbers import DecimalMark, decimal_mark, is_missing, parse_numbers
from percept.sessions.options import CANONICAL, IDS, KEPT_COLUMNS, NUMBERS, ExcludeRule, ReadOptions
from percept.sessions.part import Part, check_columns
from percept.sessions.problems import Problems, shown
from percept.sessions.records import Exclusion
from percept.sessions.summary import read_summary
from percept.sessions.units import convert


def read_part(
    grid: Grid, *, file: str, options: ReadOptions, named: Mapping[str, str], problems: Problems
) -> Part:
    """Read the observations of one file."""
    resolution = resolve(grid.header, options.columns, file=file)
    part = Part(resolution.form, pd.DataFrame())
    part.counts["rows read"] = len(grid.cells)
    part.counts.update(grid.dropped)
    check_columns(part, grid.header, resolution, file=file, options=options, named=named)
    if resolution.form == "summary":
        part.frame = read_summary(
            grid, resolution, file=file, options=options, problems=problems, notices=part.notices
        )
        return part
    reader = _Reader(grid, resolution, file, options, named, problems, part)
    part.frame = reader.read()
    return part


class _Reader:
    """The steps from cells to numbers; each narrows or converts `text`, the columns still in play."""

    def __init__(
        self,
        grid: Grid,
        resolution: Resolution,
        file: str,
        options: ReadOptions,
        named: Mapping[str, str],
        problems: Problems,
        part: Part,
    ) -> None:
        self.grid = grid
        self.resolution = resolution
        self.file = file
        self.options = options
        self.problems = problems
        self.part = part
        kept = [name for name in KEPT_COLUMNS if name in grid.header]
        self.groups = list(dict.fromkeys([*kept, *options.groups]))
        own = [*self.groups, *options.only, *(r.column for r in options.exclude if r.column not in CANONICAL)]
        self.own = {name: self._own(name) for name in dict.fromkeys(own)}
        slots = [self._slot(slot, named) for slot in resolution.slots]
        count = len(slots)
        self.rows = list(grid.rows) if count == 1 else [row for row in grid.rows for _ in range(count)]
        self.text: dict[str, list[str]] = (
            slots[0]
            if count == 1
            else {c: [v for row in zip(*(s[c] for s in slots), strict=True) for v in row] for c in slots[0]}
        )

    def _own(self, name: str) -> int:
        if self.grid.header.count(name) != 1:
            raise UsageError(
                "this column is wanted, and is not there or there twice.",
                file=self.file,
                row=1,
                column=name,
                hint=f"The columns are {shown(self.grid.header)}.",
            )
        return self.grid.header.index(name)

    def _slot(self, slot: Slot, named: Mapping[str, str]) -> dict[str, list[str]]:
        cells = self.grid.cells
        every = {c for s in self.resolution.slots for c in s.columns}
        out: dict[str, list[str]] = {}
        for canonical in (c for c in CANONICAL if c in every):
            at = slot.columns.get(canonical)
            out[canonical] = [""] * len(cells) if at is None else [record[at] for record in cells]
        for canonical, value in {"environment": slot.environment, "trial": slot.trial, **named}.items():
            if value is not None:
                out[canonical] = [value] * len(cells)
        for name, at in self.own.items():
            out[f"own:{name}"] = [record[at] for record in cells]
        return out

    def _pick(self, canonical: str, path: str) -> None:
        picked = []
        keys: dict[str, None] = {}
        lacking = somewhere = False
        for row, cell in zip(self.rows, self.text[canonical], strict=True):
            try:
                picked.append(pick(cell, path))
                somewhere = somewhere or not is_missing(cell)
            except NoKeyError as error:
                # Records of other kinds of trial lack the key; a path that no record has is a wrong one.
                lacking = True
                keys |= dict.fromkeys(error.keys)
                picked.append("")
            except CellError as error:
                somewhere = True
                # Whether such a row holds no adjustment is the scene's to say, hence a problem, not a blank.
                self.problems.add(
                    f"{error}.",
                    file=self.file,
                    row=row,
                    column=self._name(canonical),
                    value=cell,
                    hint=f"Correct the cell or the path of {canonical}, or pick rows with [sessions] only.",
                )
                picked.append("")
        if lacking and not somewhere:
            self.problems.add(
                f"no row has this path; the keys there are {shown(list(keys)) or 'none'}.",
                file=self.file,
                column=self._name(canonical),
                key=f"columns.{canonical}.path",
                value=path,
                hint="A path begins inside the cell; correct it, or pick rows with [sessions] only.",
            )
        self.text[canonical] = picked

    def read(self) -> pd.DataFrame:
        for name, texts in self.options.only.items():
            wanted = set(texts)
            cells = self.text[f"own:{name}"]
            self._keep([cell in wanted for cell in cells], f"{name} is not {' or '.join(texts)}")
        for rule in self.options.exclude:
            if rule.equals:
                key = rule.column if rule.column in CANONICAL else f"own:{rule.column}"
                if key not in self.text:
                    raise UsageError(
                        "a rule names a column that the file does not have.",
                        file=self.file,
                        row=1,
                        key=f"sessions.exclude {rule.column}",
                        hint=f"The columns are {shown(self.grid.header)}.",
                    )
                cells = self.text[key]
                self._exclude([cell in rule.equals for cell in cells], rule.why)
        for canonical, found in self.resolution.rules.items():
            if found.path is not None:
                self._pick(canonical, found.path)
        adjusted = [self.text[c] for c in ("k_adj", "b_adj") if c in self.text]
        blank = [all(is_missing(cell) for cell in cells) for cells in zip(*adjusted, strict=True)]
        self._exclude(blank, "no adjustment", log=self._is_trial)
        self._check_ids()
        numbers = self._numbers()
        if self.options.keep == "last":
            numbers = self._last(numbers)
        # Limits judge observations, so an event that is not its trial's last is gone by now.
        for rule in self.options.exclude:
            if not rule.equals:
                self._out_of_range(rule, numbers)
        return self._frame(numbers)

    def _is_trial(self, at: int) -> bool:
        return all(self.text[c][at].strip() for c in ("subject", "environment"))

    def _exclude(self, out: Sequence[bool], why: str, log: Callable[[int], bool] = lambda _: True) -> None:
        for at in (at for at, gone in enumerate(out) if gone and log(at)):
            self.part.exclusions.append(self._record(at, why))
        self._keep([not gone for gone in out], f"excluded: {why}")

    def _record(self, at: int, why: str) -> Exclusion:
        text = self.text
        who = text["subject"][at] if "subject" in text else ""
        what = ", ".join(
            f"{c} {text[c][at]}" for c in ("session", "environment", "trial") if c in text and text[c][at]
        )
        return Exclusion(who, what, why, self.file, self.rows[at])

    def _keep(self, mask: Sequence[bool], reason: str) -> None:
        gone = len(mask) - sum(mask)
        if gone:
            self.part.counts[reason] += gone
            self.text = {c: [v for v, k in zip(t, mask, strict=True) if k] for c, t in self.text.items()}
            self.rows = [row for row, k in zip(self.rows, mask, strict=True) if k]

    def _check_ids(self) -> None:
        for c in (*IDS, "trial"):
            for at, cell in enumerate(self.text.get(c, ())):
                if not cell.strip():
                    self.problems.add(
                        f"an adjustment without {c}.",
                        file=self.file,
                        row=self.rows[at],
                        column=self._name(c),
                        hint="Fill it in, or leave such rows out with [sessions] only or exclude.",
                    )

    def _name(self, canonical: str) -> str:
        rule = self.resolution.rules.get(canonical)
        return canonical if rule is None else rule.name

    def _numbers(self) -> dict[str, npt.NDArray[np.float64]]:
        names = [c for c in (*NUMBERS, "trial") if c in self.text]
        ranged = [
            f"own:{r.column}" for r in self.options.exclude if not r.equals and r.column not in CANONICAL
        ]
        labels = {c: self._name(c) for c in names} | {c: c[4:] for c in ranged}
        mark = decimal_mark(
            [(labels[c], self.text[c]) for c in labels],
            self.rows,
            file=self.file,
            declared=self.options.decimal,
            problems=self.problems,
        )
        out = {c: self._parse(c, label, mark) for c, label in labels.items()}
        for c in (c for c in NUMBERS if c in out):
            out[c] = convert(out[c], self.resolution.rules[c].unit, c[0])
        if "trial" in out:
            self._check_whole(out["trial"])
        return out

    def _parse(self, column: str, label: str, mark: DecimalMark) -> npt.NDArray[np.float64]:
        return parse_numbers(
            self.text[column], self.rows, mark=mark, file=self.file, column=label, problems=self.problems
        )

    def _check_whole(self, trial: npt.NDArray[np.float64]) -> None:
        wrong = ~((np.abs(trial) < 2.0**53) & (trial == np.round(trial)))
        for at in np.flatnonzero(wrong & ~np.isnan(trial)):
            self.problems.add(
                "a trial's number must be whole.",
                file=self.file,
                row=self.rows[at],
                column=self._name("trial"),
                value=self.text["trial"][at],
                hint="Number the trials 1, 2, 3 …",
            )

    def _last(self, numbers: dict[str, npt.NDArray[np.float64]]) -> dict[str, npt.NDArray[np.float64]]:
        """Reduce each trial to its last event, with the last value of each number."""
        ids = {c: self.text[c] for c in IDS if c in self.text}
        events = pd.DataFrame({**ids, **numbers})
        trial = [c for c in (*IDS, "trial") if c in events]
        values = [c for c in numbers if c != "trial"]
        events[values] = events.groupby(trial, sort=False, dropna=False)[values].ffill()
        last = ~events.duplicated(trial, keep="last").to_numpy()
        self._keep(last.tolist(), "earlier event of a trial")
        return {c: events[c].to_numpy(dtype=float)[last] for c in numbers}

    def _out_of_range(self, rule: ExcludeRule, numbers: dict[str, npt.NDArray[np.float64]]) -> None:
        key = rule.column if rule.column in numbers else f"own:{rule.column}"
        if key not in numbers:
            raise UsageError("limits need a column of numbers.", key=f"sessions.exclude {rule.column}")
        values = numbers[key]
        out = np.zeros(len(values), dtype=bool)
        if rule.below is not None:
            out |= values < rule.below
        if rule.above is not None:
            out |= values > rule.above
        self._exclude(out.tolist(), rule.why)
        for c in numbers:
            numbers[c] = numbers[c][~out]

    def _frame(self, numbers: Mapping[str, npt.NDArray[np.float64]]) -> pd.DataFrame:
        count = len(self.rows)
        columns: dict[str, Any] = {
            c: np.array(self.text[c], dtype=object) if c in self.text else np.full(count, "1", dtype=object)
            for c in IDS
        }
        blank = np.full(count, np.nan)
        columns |= {c: numbers.get(c, blank) for c in ("k_ref", "b_ref")}
        trial = numbers.get("trial", np.ones(count))
        columns["trial"] = np.where(np.abs(trial) < 2.0**53, trial, 0).astype(np.int64)
        columns |= {c: numbers.get(c, blank) for c in ("k_adj", "b_adj")}
        columns |= {g: np.array(self.text[f"own:{g}"], dtype=object) for g in self.groups}
        columns["row"] = np.array(self.rows, dtype=np.int64)
        return pd.DataFrame(columns)
