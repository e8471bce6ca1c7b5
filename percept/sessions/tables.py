"""Files to tables whose header is known, one after the other, and what is said of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import chain, islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions.columns import Rules, Slot, check_columns, resolve, unused_columns
from percept.sessions.grid import Grid, refuse_headless, text_grid
from percept.sessions.inputs import WORKBOOK, Input, decode, expand, ids_from_name, load
from percept.sessions.options import DataTables, ExcludeRule
from percept.sessions.quantities import factor, quantity_of, with_mass
from percept.sessions.records import (
    Exclusion,
    Found,
    NoDataError,
    Notice,
    Problems,
    Source,
    shown,
)
from percept.sessions.typed import sheets, texts_of, typed_grid
from percept.sessions.values import SPACE, decimal_mark, parse_numbers

Form = Literal["trials", "summary"]
#: Rows that are read at a time.
_ROWS = 200


class Log(Problems):
    """What is said of a study while it is read: each step adds to it."""

    def __init__(self, scene: DataTables | None, paths: Sequence[str | Path] = ()) -> None:
        super().__init__()
        self.options = DataTables() if scene is None else scene
        if not isinstance(self.options, DataTables):
            hint = "Scene.load reads a scene's file."
            raise UsageError(f"a scene is needed, not {type(scene).__name__}.", hint=hint)
        self.paths = paths  # As they were given
        self.sources: list[Source] = []
        self.notices: list[Notice] = []
        self.exclusions: list[Exclusion] = []
        self.without_trials: list[NoDataError] = []
        self.at_limits: list[pd.DataFrame] = []  # Adjustments left out at limits of controls
        self.counts: Counter[str] = Counter()  # Rows by what became of them
        self.parameters: set[str] = set()  # Quantities with a column of adjustments
        self.applied: set[ExcludeRule] = set()  # Rules on texts that some row met
        self.declared_units = set(self.options.declared_references)

    def place(self, table: pd.DataFrame, index: Any) -> tuple[str, int]:
        """Return the file and physical line of a row of the table."""
        file, row = table.loc[index, ["file", "row"]]
        return self.sources[int(file)].name, int(row)

    def refuse(self, table: pd.DataFrame, problems: Iterable[Found]) -> None:
        """Take up what checks find wrong, with its file and physical line."""
        for message, column, index, value, hint in problems:
            file, row = (None, None) if index is None else self.place(table, index)
            self.add(message, file=file, row=row, column=column, value=value, hint=hint)


@dataclass(frozen=True)
class OpenFile:
    """A file whose header is known."""

    grid: Grid
    slots: tuple[Slot, ...]
    rules: Rules  # What each canonical column was found by
    ids: Mapping[str, str]  # Of the file's name
    digest: str  # SHA-256 of its bytes
    log: Log

    @property
    def name(self) -> str:
        """The file's name, for messages."""
        return self.grid.file

    @property
    def options(self) -> DataTables:
        """How the study is read."""
        return self.log.options

    @property
    def form(self) -> Form:
        """Whether it holds trials or a published table."""
        return "summary" if "parameter" in self.rules else "trials"

    def report(self, problems: Iterable[Found]) -> None:
        """Record problems of columns, by their canonical names or labels, and physical rows."""
        for message, column, row, value, hint in problems:
            canonical = str(getattr(column, "name", column))
            rule = self.rules.get(canonical)
            name = canonical if rule is None else rule.name
            hint = hint.replace("COLUMN", name).replace("CANONICAL", canonical)
            self.log.add(message, file=self.name, row=row, column=name, value=value, hint=hint)

    def cells(self, tables: Sequence[Mapping[Any, int]]) -> list[pd.DataFrame]:
        """Read all rows; give the texts of columns by label. The index is the physical line.

        A table says where each of its columns stands.
        """
        lines: list[int] = []
        texts: dict[int, list[str]] = {at: [] for table in tables for at in table.values()}
        rows = self.grid.rows()
        while part := list(islice(rows, _ROWS)):
            lines += [line for line, _ in part]
            self.options.files.hold_table(len(lines), len(texts), self.name)
            # Equal texts share their memory: most columns hold few.
            share = dict[str, str]().setdefault
            for at, column in texts.items():
                column += [share(row[at], row[at]) for _, row in part]
        self.log.counts["rows read"] += len(lines)
        self.log.counts.update(self.grid.dropped)
        self.log.sources.append(Source(self.name, self.digest, len(lines)))
        cells = pd.DataFrame(texts, index=lines, dtype="str")
        return [cells[list(table.values())].set_axis(list(table), axis=1) for table in tables]

    def is_missing(self, cells: pd.Series[str]) -> npt.NDArray[np.bool_]:
        """Which cells say that there is no value."""
        marks = self.options.sessions.marks
        return cells.str.strip(SPACE).str.lower().isin(marks).to_numpy(dtype=bool)

    def numbers(
        self, data: pd.DataFrame, names: Iterable[Any], correct: str
    ) -> dict[Any, npt.NDArray[np.float64]]:
        """Convert columns of text to numbers, by the one decimal mark of the file.

        `correct` says what to do about a cell that has no better remedy.
        """
        selection = self.options.sessions
        columns = {name: data[name] for name in names}
        mark = selection.decimal
        found: list[Found] = []
        if mark is None:
            mark, found = decimal_mark(columns, self.grid.delimiter)
        numbers = {}
        for name, cells in columns.items():
            numbers[name], odd = parse_numbers(name, cells, mark, selection.marks)
            found += odd
        self.report(problem._replace(hint=problem.hint or correct) for problem in found)
        return numbers


def open_files(paths: Sequence[str | Path], log: Log) -> Iterator[OpenFile]:
    """Open files; an error of one becomes a problem, so that the next is read too."""
    files, notices = expand(paths)
    log.notices += notices
    for file, named in files.items():
        with log.collecting():
            for entry in load(file, log.options.files):
                with log.collecting():
                    part = entry.part or log.options.sessions.sheet
                    parts = [replace(entry, part=part)]
                    if part == "*" and re.match(WORKBOOK, entry.data):
                        parts = sheets(entry)
                    for one in parts:
                        yield from _open_input(one, log, named=named and entry.name == file)


def _open_input(entry: Input, log: Log, *, named: bool) -> Iterator[OpenFile]:
    """Open one input; nothing comes of a file without trials."""
    digest = sha256(entry.data).hexdigest()
    try:
        grid = read_grid(entry, log.options)
        ids = ids_from_name(entry.path, log.options.sessions.filename, file=entry.name)
        file = _open(grid, ids, digest, log)
    except NoDataError as error:
        # A file that somebody named has to hold trials; one of a folder may be a companion.
        if error.column and named:
            raise
        log.without_trials.append(error)
        return
    for source in log.sources:
        if source.sha256 == digest and "::" not in entry.name:
            message = f"byte for byte the same file as {source.name}."
            raise UsageError(message, file=entry.name, hint="Leave one of them out.")
    yield file


def open_frame(frame: pd.DataFrame, log: Log) -> Iterator[OpenFile]:
    """Take a DataFrame as a file; a row's number is its position plus 2, as below a header."""
    rows = chain([list(frame.columns)], frame.itertuples(index=False, name=None))
    entry = Input("<frame>", "", b"", log.options.files)
    yield _open(Grid(texts_of(rows, entry), entry.name), {}, "", log)


def _open(
    grid: Grid,
    ids: Mapping[str, str],
    digest: str,
    log: Log,
) -> OpenFile:
    """Find out from the header what kind of table a file is."""
    options = log.options
    slots, rules = resolve(grid, options)
    _take_units(grid, slots, rules, options)
    file = OpenFile(grid, slots, rules, ids, digest, log)
    if file.form == "trials":
        present = {*rules, *ids}.union(*(slot.ids for slot in slots))
        if options.sessions.subject == "row":
            present.add("subject")
        try:
            check_columns(grid, present, options, log.paths)
        except UsageError:
            refuse_headless(grid)
            raise
        log.parameters |= {name for name in options.quantities if f"{name}_adj" in rules}
        log.declared_units |= {
            name
            for name, rule in rules.items()
            if rule.unit is not None or rule.response == "ratio"
        }
    for column in sorted(ids.keys() & rules.keys()):
        name = rules[column].name
        grid.notice(f"{column} is taken from the file's name; column {name!r} is not used")
    if unused := unused_columns(grid, slots, options):
        grid.notice(f"columns not used: {shown(unused)}")
    return file


def _take_units(grid: Grid, slots: Iterable[Slot], rules: Rules, options: DataTables) -> None:
    """Give the columns of numbers the units of a row below the header, where there is one."""
    if not grid.units:
        return
    quantities = with_mass(options.quantities)
    read = []
    for canonical, rule in rules.items():
        quantity = quantities.get(quantity_of(canonical))
        columns = [slot.columns[canonical] for slot in slots if canonical in slot.columns]
        words = {grid.units.get(grid.header[column], "") for column in columns}
        unit = max(words)
        if quantity is None or not unit:
            continue
        words.add(unit if rule.unit is None else rule.unit)
        try:
            factors = {factor(word, quantity) for word in words}
        except UsageError:
            factors = set()
        if len(factors) != 1 or rule.response == "ratio":
            raise _second_header(grid, rule.name, unit)
        rules[canonical] = rule.model_copy(update={"unit": unit})
        read.append(f"{shown([unit])} of {shown([rule.name])}")
    if not read:
        raise _second_header(grid, *next(iter(grid.units.items())))
    grid.notice(f"line {grid.units_row} is read as units: {', '.join(read)}", grid.units_row)


def _second_header(grid: Grid, column: str, word: str) -> UsageError:
    """Say that a row of words below the header is no row of units, or that the scene differs."""
    row = grid.units_row
    message = (
        f"line {row} is a second header, or a row of units that do not fit:"
        f" {shown([*grid.units.values()])}."
    )
    hint = (
        "Remove it. Units stand in the scene, below [columns], such as"
        ' k_adj = { name = "…", unit = "N/mm" }.'
    )
    return UsageError(message, file=grid.file, row=row, column=column, value=word, hint=hint)


def read_grid(entry: Input, options: DataTables) -> Grid:
    """Give the cells of one input, whatever its format."""
    if (grid := typed_grid(entry)) is not None:
        return grid
    text, encoding = decode(entry, options.sessions.encoding)
    grid = text_grid(text, entry.name, options.sessions.delimiter)
    if encoding == "cp1252" and options.sessions.encoding is None:
        grid.notice("not UTF-8; read as Windows-1252")
    return grid
