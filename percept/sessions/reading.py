"""A study being read: inputs of any format opened one by one, and what is left out and counted on the way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from pathlib import Path

import pandas as pd

from percept.errors import UsageError
from percept.sessions import checks
from percept.sessions.columns import resolve
from percept.sessions.files import Input, expand, is_workbook, load, open_text
from percept.sessions.grids import Block, text_blocks
from percept.sessions.ids import Names, doubtful_ids, ids_from_name
from percept.sessions.options import ReadOptions
from percept.sessions.records import Exclusion, NoDataError, Notice, Place, Problems, Source
from percept.sessions.table import FileTable
from percept.sessions.typed import PARQUET, typed_block, typed_rows


class Reading:
    """A study being read, file by file: its sources, and what was noticed so far."""

    def __init__(self, options: ReadOptions) -> None:
        self.options = options
        self.problems = Problems()
        self.sources: list[Source] = []
        self.notices: list[Notice] = []
        self.exclusions: list[Exclusion] = []
        self.left_out: list[NoDataError] = []
        self.counts: Counter[str] = Counter()
        self.names = Names()
        for environment in options.environments:
            self.names.add("environment", environment)
        self.numbered = False  # Whether a column of any file numbers the trials
        self.declared_units = {
            name for references in options.environments.values() for name in references
        }

    def tables(self, paths: Sequence[str | Path]) -> Generator[FileTable]:
        """Open the files; an error of one becomes a problem, so that the next is read too."""
        wants = self.options.sessions.files.wants
        files, notices = expand(paths, wants)
        self.notices += notices
        for file, named in files.items():
            with self.problems.collecting():
                for entry in load(file, self.options.files):
                    if entry.path == file or wants(entry.path):
                        with self.problems.collecting():
                            yield from self._table(entry, asked=named and entry.path == file)

    def _table(self, entry: Input, *, asked: bool) -> Generator[FileTable]:
        with closing(open_blocks(entry, self.options, self.notices)) as blocks:
            try:
                named = ids_from_name(entry.path, self.options.sessions.filename, file=entry.name)
                table = FileTable(
                    entry.name, blocks, self.options, named, self.problems, self.names
                )
            except NoDataError as error:
                # A file that was named is asked for; what a folder holds may be a companion.
                if error.column and asked:
                    raise
                self.left_out.append(error)
                return
            sha256 = entry.sha256()
            twin = next((source.name for source in self.sources if source.sha256 == sha256), None)
            if twin is not None:
                hint = "Leave one of them out."
                raise UsageError(
                    f"byte for byte the same file as {twin}.", file=entry.name, hint=hint
                )
            yield table
            self._add(table, sha256)

    def frame(self, frame: pd.DataFrame) -> Generator[FileTable]:
        """Take a DataFrame as a file; a row's number is its position plus 2, as if a header were line 1."""
        block = typed_block(
            [list(frame.columns), *frame.itertuples(index=False, name=None)], "<frame>"
        )
        table = FileTable("<frame>", iter([block]), self.options, {}, self.problems, self.names)
        yield table
        self._add(table, "")

    def _add(self, table: FileTable, sha256: str) -> None:
        """Take up what is known of a file once all of it is read."""
        self.sources.append(Source(table.name, sha256, table.counts["rows read"]))
        self.notices += table.notices
        self.numbered |= table.numbered
        self.exclusions += table.exclusions
        self.counts.update(table.counts)
        self.declared_units |= table.declared_units

    def refuse_nothing(self, frames: Sequence[pd.DataFrame]) -> None:
        """Raise the problems found, or that no row is left; notice environments that no row has."""
        if not self.sources:
            for error in self.left_out:
                self.problems.extend(error)
        self.problems.raise_if_any()
        self.notices += [
            Notice(f"left out: {error.message}", error.file) for error in self.left_out
        ]
        if not any(map(len, frames)):
            hint = f"Rows: {', '.join(f'{n} {why}' for why, n in self.counts.items())}."
            raise UsageError("no row holds an adjustment.", file=self.sources[0].name, hint=hint)
        present = {name for frame in frames if len(frame) for name in frame["environment"].unique()}
        unnamed = (name for name in self.options.environments if name not in present)
        self.notices += [
            Notice("[environments] names it, and no row does", column=name) for name in unnamed
        ]

    def place(self, table: pd.DataFrame) -> Place:
        """Return where a row of the table, by its position, stands."""
        files, rows = table["file"].to_numpy(), table["row"].to_numpy()
        return lambda at: {"file": self.sources[int(files[at])].name, "row": int(rows[at])}

    def check(self, table: pd.DataFrame, parameters: Iterable[str], rows: pd.Series[int]) -> None:
        """Look at units, ids and cells over all files; a row stands for as many as `rows` says."""
        known = [self.options.quantities[p] for p in parameters]
        place, units = self.place(table), self.declared_units
        self.notices += checks.check_plausible(table, known, units, place, self.problems)
        self.problems.raise_if_any()
        self.notices += self.names.notices()
        self.notices += doubtful_ids(table, place)
        if table["session"].nunique() > 1:
            self.notices += checks.repeats_over_sessions(table)
        self.counts.update(checks.count_grid(table, rows))


def open_blocks(entry: Input, options: ReadOptions, notices: list[Notice]) -> Generator[Block]:
    """Give the cells of one input, whatever its format, in blocks."""
    file, data = entry.name, entry.data or b""
    if data.startswith(PARQUET) or is_workbook(data, file):
        rows = typed_rows(data, file, options.sessions.sheet, options.files)
        yield typed_block(rows, file)
        return
    text, encoding = open_text(entry, options.sessions.encoding)
    if encoding == "cp1252" and options.sessions.encoding is None:
        notices.append(Notice("not UTF-8; read as Windows-1252", file))

    def resolves(header: list[str]) -> bool:
        try:
            found = resolve(header, options, file=file)
        except UsageError:
            return False
        return found.form == "summary" or any(f"{p}_adj" in found.rules for p in options.quantities)

    yield from text_blocks(text, file=file, delimiter=options.sessions.delimiter, resolves=resolves)
