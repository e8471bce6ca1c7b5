"""A study being read: inputs of any format opened one by one, and what is left out and counted on the way."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions import checks
from percept.sessions.columns import resolve
from percept.sessions.files import Input, expand, ids_from_name, is_workbook, load, open_text
from percept.sessions.grids import Block, Grid, text_blocks, with_names
from percept.sessions.options import ReadOptions
from percept.sessions.records import IDS, Exclusion, NoDataError, Notice, Place, Problems, Source
from percept.sessions.table import FileTable

_EXTRA = "Install what reads it: pip install 'percept[tables]'."


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
        self.numbered = False  # Whether a column of any file numbers the trials
        self.declared_units = {name for references in options.environments.values() for name in references}

    def tables(self, paths: Sequence[str | Path]) -> Generator[FileTable]:
        """Open the files; an error of one becomes a problem, so that the next is read too."""
        wants = self.options.files.wants
        files, inside, notices = expand(paths, wants)
        self.notices += notices
        for file in files:
            with self.problems.collecting():
                for entry in load(file):
                    if entry.path == file or wants(entry.path):
                        with self.problems.collecting():
                            yield from self._table(entry, asked=file not in inside and entry.path == file)

    def _table(self, entry: Input, *, asked: bool) -> Generator[FileTable]:
        with closing(open_blocks(entry, self.options, self.notices)) as blocks:
            try:
                named = ids_from_name(entry.path, self.options.filename, file=entry.name)
                table = FileTable(entry.name, blocks, self.options, named, self.problems)
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
                raise UsageError(f"byte for byte the same file as {twin}.", file=entry.name, hint=hint)
            yield table
            self._add(table, sha256)

    def frame(self, frame: pd.DataFrame) -> Generator[FileTable]:
        """Take a DataFrame as a file."""
        name = "<frame>"
        blocks = iter([Block(frame_grid(frame, file=name))])
        table = FileTable(name, blocks, self.options, {}, self.problems)
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
        self.notices += [Notice(f"left out: {error.message}", error.file) for error in self.left_out]
        if not any(map(len, frames)):
            hint = f"Rows: {', '.join(f'{n} {why}' for why, n in self.counts.items())}."
            raise UsageError("no row holds an adjustment.", file=self.sources[0].name, hint=hint)
        present = {name for frame in frames if len(frame) for name in frame["environment"].unique()}
        unnamed = (name for name in self.options.environments if name not in present)
        self.notices += [Notice("[environments] names it, and no row does", column=name) for name in unnamed]

    def place(self, table: pd.DataFrame) -> Place:
        """Return where a row of the table, by its position, stands."""
        files, rows = table["file"].to_numpy(), table["row"].to_numpy()
        return lambda at: {"file": self.sources[int(files[at])].name, "row": int(rows[at])}

    def pooled(self, table: pd.DataFrame) -> tuple[str, ...]:
        """Columns of groups that the analysis does not tell apart."""
        names = dict.fromkeys(("group", *self.options.groups))
        return tuple(c for c in names if c in table and c not in self.options.split)

    def settled(self, table: pd.DataFrame) -> pd.DataFrame:
        """Look at ids and cells over all files; a row of the table may stand for as many as `rows` says."""
        rows = table["rows"] if "rows" in table else pd.Series(1, index=table.index)
        if self.options.unfinished == "exclude":
            kept, unfinished = checks.drop_unfinished(table)
            self.exclusions += unfinished
            if unfinished:
                self.counts["excluded: unfinished subject"] = int(rows.sum() - rows[kept.index].sum())
            table, rows = kept.reset_index(drop=True), rows[kept.index]
        for what in IDS:
            self.notices += checks.look_alikes(table[what].unique(), what)
        if table["session"].nunique() > 1:
            self.notices += checks.repeats_over_sessions(table)
        self.counts.update(checks.count_grid(table, rows))
        return table


def open_blocks(entry: Input, options: ReadOptions, notices: list[Notice]) -> Generator[Block]:
    """Give the cells of one input, whatever its format, in blocks."""
    file, data = entry.name, entry.data or b""
    if data.startswith(b"PAR1"):
        yield Block(parquet_grid(data, file=file))
        return
    if data.startswith(b"PK\x03\x04") and is_workbook(data, file):
        yield Block(excel_grid(data, file=file, sheet=options.sheet))
        return
    text, encoding = open_text(entry, options.encoding)
    if encoding == "cp1252" and options.encoding is None:
        notices.append(Notice("not UTF-8; read as Windows-1252", file))

    def resolves(header: list[str]) -> bool:
        try:
            found = resolve(header, options, file=file)
        except UsageError:
            return False
        return found.form == "summary" or any(f"{p}_adj" in found.rules for p in options.quantities)

    yield from text_blocks(
        text, file=file, delimiter=options.delimiter, large=entry.data is None, resolves=resolves
    )


def frame_grid(frame: pd.DataFrame, *, file: str) -> Grid:
    """Grid of a DataFrame; a row's number is its position plus 2, as if a header were line 1."""
    columns = [frame.iloc[:, at].tolist() for at in range(frame.shape[1])]
    return _typed_grid([str(name) for name in frame.columns], columns, file)


def parquet_grid(data: bytes, *, file: str) -> Grid:
    """Grid of a Parquet file."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise UsageError("a Parquet file needs pyarrow.", file=file, hint=_EXTRA) from None
    try:
        table = pq.read_table(io.BytesIO(data))
    except (pa.ArrowException, OSError, ValueError) as error:
        message = f"a broken Parquet file: {str(error).rstrip('.')}."
        raise UsageError(message, file=file, hint="Write it again.") from None
    return _typed_grid(list(table.column_names), [column.to_pylist() for column in table.columns], file)


def excel_grid(data: bytes, *, file: str, sheet: str | None) -> Grid:
    """Grid of one sheet of an Excel workbook; formulas count with the values Excel stored."""
    try:
        import openpyxl  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise UsageError("an Excel workbook needs openpyxl.", file=file, hint=_EXTRA) from None
    try:
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        names = list(book.sheetnames)
        known = sheet is None or sheet in names
        page = (book[sheet] if sheet else book.worksheets[0]) if known else None
        rows = [] if page is None else list(page.iter_rows(values_only=True))
        book.close()
    # openpyxl lets whatever its XML reader meets escape: KeyError, ValueError, zlib.error and others.
    except Exception as error:  # noqa: BLE001
        hint = "Save it again, or as CSV."
        raise UsageError(f"a broken workbook: {error}.", file=file, hint=hint) from None
    if not known:
        raise UsageError(f"no such sheet; there are {', '.join(names)}.", file=file, value=sheet)
    if not rows:
        raise UsageError("the sheet is empty.", file=file, hint="Name another with [sessions] sheet.")
    width = max((at + 1 for at, name in enumerate(rows[0]) if name is not None), default=0)
    columns = [[row[at] if at < len(row) else None for row in rows[1:]] for at in range(width)]
    return _typed_grid([_text(name) for name in rows[0][:width]], columns, file)


def _typed_grid(header: Sequence[str], columns: Iterable[Iterable[Any]], file: str) -> Grid:
    cells = [[_text(value) for value in record] for record in zip(*columns, strict=True)]
    kept = [at for at, record in enumerate(cells) if any(cell.strip() for cell in record)]
    if not kept:
        raise NoDataError("there are no data below the header.", file=file, hint="Leave it out.")
    blank = Counter({"blank line": len(cells) - len(kept)} if len(kept) < len(cells) else {})
    names = with_names([name.strip() for name in header])
    return Grid.of(names, [cells[at] for at in kept], [at + 2 for at in kept], blank)


def _text(value: Any) -> str:
    """Write a typed cell as text; `repr` of a float reads back as the same double."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return "" if value != value else repr(float(value))
    if value is None or value is pd.NA or value is pd.NaT:
        return ""
    return str(value)
