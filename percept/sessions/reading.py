"""A study being read: inputs of any format opened one by one, and what is left out and counted on the way."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions import checks
from percept.sessions.columns import resolve
from percept.sessions.doubts import doubtful_ids
from percept.sessions.files import Input, expand, ids_from_name, is_workbook, load, open_text
from percept.sessions.grids import Block, Dialect, Grid, text_blocks
from percept.sessions.options import FileLimits, ReadOptions
from percept.sessions.records import Exclusion, NoDataError, Notice, Place, Problems, Source
from percept.sessions.table import FileTable
from percept.sessions.values import Names

#: How a Parquet file begins.
_PARQUET = b"PAR1"


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
        block = _typed_block(
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
    if data.startswith(_PARQUET) or is_workbook(data, file):
        rows = _typed_rows(data, file, options.sessions.sheet, options.files)
        yield _typed_block(rows, file)
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


def _typed_rows(
    data: bytes, file: str, sheet: str | None, limits: FileLimits
) -> list[Sequence[Any]]:
    """Give the header and rows of a Parquet file, or of a sheet with the values Excel stored."""
    package = "pyarrow" if data.startswith(_PARQUET) else "openpyxl"
    try:
        if package == "pyarrow":
            return _parquet_rows(data, file, limits)
        rows = list(_sheet_rows(data, file, sheet, limits))
    except UsageError:
        raise
    except ImportError:
        message = f"such a file needs {package}."
        hint = f"Install it: pip install {package}."
        raise UsageError(message, file=file, hint=hint) from None
    # What the XML reader meets escapes: KeyError, zlib.error and others.
    except Exception as error:  # noqa: BLE001
        message = f"a broken file: {str(error).rstrip('.')}."
        raise UsageError(message, file=file, hint="Write it again, or as CSV.") from None
    if not rows:
        hint = "Name another with [sessions] sheet."
        raise UsageError("the sheet is empty.", file=file, hint=hint)
    # Cells right of the last column name hold notes.
    width = len(rows[0])
    return [row[:width] + [""] * (width - len(row)) for row in rows]


def _parquet_rows(data: bytes, file: str, limits: FileLimits) -> list[Sequence[Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = pa.BufferReader(data)
    size = pq.read_metadata(buffer)
    limits.hold_table(size.num_rows, size.num_columns, file)
    table = pq.read_table(pa.BufferReader(data))
    columns = [column.to_pylist() for column in table.columns]
    return [table.column_names, *zip(*columns, strict=True)]


def _sheet_rows(
    data: bytes, file: str, sheet: str | None, limits: FileLimits
) -> Iterator[list[Any]]:
    """Give the rows of a sheet without their trailing blank cells."""
    import openpyxl

    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    name = book.sheetnames[0] if sheet is None else sheet
    if name not in book.sheetnames:
        message = f"no such sheet; there are {', '.join(book.sheetnames)}."
        raise UsageError(message, file=file, value=sheet)
    page = book[name]
    # The size that a sheet states may be wrong.
    page.reset_dimensions()
    blank_rows = 0
    width = 0
    for number, cells in enumerate(page.iter_rows(), 1):
        values = [_sheet_value(cell) for cell in cells]
        while values and values[-1] == "":
            values.pop()
        width = max(width, len(values))
        limits.hold_table(number, width, file)
        if not values:
            blank_rows += 1
            continue
        yield from ([] for _ in range(blank_rows))
        blank_rows = 0
        yield values


def _sheet_value(cell: Any) -> Any:
    """Value of a cell; whole numbers are written without a point, and errors are blank."""
    value = cell.value
    if value is None or cell.data_type == "e":
        return ""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _typed_block(rows: Iterable[Sequence[Any]], file: str) -> Block:
    """Write the typed cells of a header and rows as text."""
    header, *records = ([_text(value) for value in row] for row in rows)
    # A last column without a name is no mark of a delimiter here.
    names = tuple(name.strip() or f"column {number}" for number, name in enumerate(header, 1))
    dialect = Dialect(file, names=names)
    lines = list(range(2, len(records) + 2))
    grid = Grid.of(dialect, records, lines, last=False)
    if grid.cells.empty:
        raise NoDataError("there are no data below the header.", file=file, hint="Leave it out.")
    return Block(dialect, grid)


def _text(value: Any) -> str:
    """Write a typed cell as text; `repr` of a float reads back as the same double."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return "" if value != value else repr(float(value))
    return "" if value is None or value is pd.NA or value is pd.NaT else str(value)
