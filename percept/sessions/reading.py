"""A study being read, file by file, with what is noticed and counted on the way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import chain
from pathlib import Path

import pandas as pd

from percept.errors import UsageError
from percept.sessions import checks
from percept.sessions.columns import Header, resolve
from percept.sessions.doubts import doubtful_ids
from percept.sessions.files import Input, load, open_text
from percept.sessions.grids import Block, text_blocks
from percept.sessions.layout import refuse_headless
from percept.sessions.options import ExcludeRule, ReadOptions
from percept.sessions.paths import expand, ids_from_name
from percept.sessions.records import (
    Exclusion,
    NoDataError,
    Notice,
    Place,
    Places,
    Problems,
    Source,
)
from percept.sessions.summary import SummaryTable
from percept.sessions.table import FileTable, OpenFile
from percept.sessions.trials import LongTable, WideTable
from percept.sessions.typed import is_typed, typed_block, typed_rows
from percept.sessions.values import Names

__all__ = ["Reading", "open_blocks"]


class Reading:
    """A study being read, file by file: its sources, and what was noticed so far."""

    def __init__(self, options: ReadOptions) -> None:
        self.options = options
        self.paths: list[str] = []  # As they were given
        self.problems = Problems()
        self.sources: list[Source] = []
        self.notices: list[Notice] = []
        self.exclusions: list[Exclusion] = []
        self.at_limits: list[pd.DataFrame] = []  # Adjustments left out at limits of controls
        self.without_trials: list[NoDataError] = []
        self.counts: Counter[str] = Counter()
        self.names = Names()
        for environment in options.environments:
            self.names.add("environment", environment)
        self.numbered = False  # Whether a column of any file numbers the trials
        self.applied: set[ExcludeRule] = set()  # Rules on texts that some row met
        self.declared_units = {name for own in options.environments.values() for name in own}

    def tables(self, paths: Sequence[str | Path]) -> Generator[FileTable]:
        """Open the files; an error of one becomes a problem, so that the next is read too."""
        self.paths = [str(path) for path in paths]
        wants = self.options.sessions.files.wants
        files, notices = expand(paths, wants)
        self.notices += notices
        for file, named in files.items():
            with self.problems.collecting():
                for entry in load(file, self.options.files):
                    is_file = entry.name == file
                    if is_file or wants(entry.path):
                        with self.problems.collecting():
                            yield from self._table(entry, named=named and is_file)

    def _table(self, entry: Input, *, named: bool) -> Generator[FileTable]:
        """Open one input, and take it up once all of it is read."""
        with closing(open_blocks(entry, self.options, self.notices)) as blocks:
            try:
                ids = ids_from_name(entry.path, self.options.sessions.filename, file=entry.name)
                table = self._open(entry.name, blocks, ids)
            except NoDataError as error:
                # A file that somebody named has to hold trials; one of a folder may be a companion.
                if error.column and named:
                    raise
                self.without_trials.append(error)
                return
            sha256 = entry.sha256()
            for source in self.sources:
                if source.sha256 == sha256 and entry.part is None:
                    message = f"byte for byte the same file as {source.name}."
                    raise UsageError(message, file=entry.name, hint="Leave one of them out.")
            yield table
            self._add(table, sha256)

    def frame(self, frame: pd.DataFrame) -> Generator[FileTable]:
        """Take a DataFrame as a file; a row's number is its position plus 2, as below a header."""
        limits = self.options.files
        limits.hold_table(len(frame), len(frame.columns), "<frame>")
        rows = [list(frame.columns), *frame.itertuples(index=False, name=None)]
        block = typed_block(rows, "<frame>", limits)
        table = self._open("<frame>", iter([block]), {})
        yield table
        self._add(table, "")

    def _open(self, name: str, blocks: Iterator[Block], ids: Mapping[str, str]) -> FileTable:
        """Find out from the header what kind of table a file is."""
        first = next(blocks)
        grid = first.grid()
        header = Header(grid.header, name, self.paths)
        found = resolve(header, self.options)
        file = OpenFile(
            name=name,
            header=header,
            blocks=chain([first], blocks),
            ids=ids,
            options=self.options,
            problems=self.problems,
            names=self.names,
        )
        if found.form == "summary":
            return SummaryTable(file, found)
        try:
            return WideTable(file, found) if found.wide else LongTable(file, found)
        except UsageError:
            columns = [column.tolist() for _, column in grid.cells.items()]
            refuse_headless(grid.header, columns, name)
            raise

    def _add(self, table: FileTable, sha256: str) -> None:
        """Take up what is known of a file once all of it is read."""
        self.sources.append(Source(table.name, sha256, table.counts["rows read"]))
        self.notices += table.notices
        self.numbered |= table.numbered
        self.exclusions += table.exclusions
        self.applied |= table.applied
        self.counts.update(table.counts)
        self.declared_units |= table.declared_units

    def refuse_nothing(self, frames: Sequence[pd.DataFrame]) -> None:
        """Raise the problems found, a rule that no row met, or that no row is left.

        Notice environments that no row has.
        """
        if not self.sources:
            for error in self.without_trials:
                self.problems.extend(error)
        self.problems.raise_if_any()
        for error in self.without_trials:
            self.notices.append(Notice(f"left out: {error.message}", error.file))
        self._refuse_idle_rules()
        if not any(len(frame) for frame in frames):
            rows = ", ".join(f"{number} {reason}" for reason, number in self.counts.items())
            message = "no row has an adjustment."
            raise UsageError(message, file=self.sources[0].name, hint=f"Rows: {rows}.")
        present = {name for frame in frames if len(frame) for name in frame["environment"].unique()}
        for name in self.options.environments:
            if name not in present:
                self.notices.append(
                    Notice("[environments] names it, but no row has it", column=name)
                )

    def _refuse_idle_rules(self) -> None:
        """Refuse a rule on texts that no row met; limits may well be kept by all rows."""
        for rule in self.options.sessions.exclude:
            if rule.equals and rule not in self.applied:
                raise UsageError(
                    f"no row has {' or '.join(map(repr, rule.equals))} in this column.",
                    key="sessions.exclude",
                    column=rule.column,
                    hint="Correct the text, or take the rule out.",
                )

    def places(self, table: pd.DataFrame) -> Places:
        """Return where a row of the table, by its position, stands."""
        files = table["file"].to_numpy()
        rows = table["row"].to_numpy()
        return lambda at: Place(file=self.sources[int(files[at])].name, row=int(rows[at]))

    def check(self, table: pd.DataFrame, parameters: Iterable[str]) -> None:
        """Look at units, ids and cells over all files."""
        quantities = [self.options.quantities[p] for p in parameters]
        places = self.places(table)
        self.notices += checks.check_plausible(
            table, quantities, self.declared_units, places, self.problems
        )
        self.problems.raise_if_any()
        self.notices += self.names.notices()
        self.notices += doubtful_ids(table, places)
        if table["session"].nunique() > 1:
            self.notices += checks.repeats_over_sessions(table)
        self.counts.update(checks.count_grid(table))


def open_blocks(entry: Input, options: ReadOptions, notices: list[Notice]) -> Generator[Block]:
    """Give the cells of one input, whatever its format, in blocks."""
    file = entry.name
    if is_typed(entry):
        part = entry.part or options.sessions.sheet
        rows = typed_rows(entry.read(options.files), file, part, options.files)
        yield typed_block(rows, file, options.files)
        return
    text, encoding = open_text(entry, options.sessions.encoding)
    if encoding == "cp1252" and options.sessions.encoding is None:
        notices.append(Notice("not UTF-8; read as Windows-1252", file))

    def resolves(names: list[str]) -> bool:
        """Whether a header, split by some delimiter, has columns that are read."""
        try:
            found = resolve(Header(names, file), options)
        except UsageError:
            return False
        adjusted = any(f"{p}_adj" in found.rules for p in options.quantities)
        return adjusted or found.form == "summary"

    yield from text_blocks(text, file=file, delimiter=options.sessions.delimiter, resolves=resolves)
