"""One input to blocks of cells, whatever its format: text, Parquet, an Excel workbook or a DataFrame."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions.columns import resolve
from percept.sessions.files import Input, is_workbook, open_text
from percept.sessions.grids import Block, Grid, text_blocks, with_names
from percept.sessions.options import ReadOptions
from percept.sessions.records import NoDataError, Notice

_EXTRA = "Install what reads it: pip install 'percept[tables]'."


def open_blocks(entry: Input, options: ReadOptions, notices: list[Notice]) -> Generator[Block]:
    """Give the cells of one input, whatever its format, in blocks."""
    file, data = entry.name, entry.data or b""
    if data.startswith(b"PAR1"):
        yield Block(cells=parquet_grid(data, file=file))
        return
    if data.startswith(b"PK\x03\x04") and is_workbook(data, file):
        yield Block(cells=excel_grid(data, file=file, sheet=options.sheet))
        return
    text, encoding = open_text(entry, options.encoding)
    if encoding == "cp1252" and options.encoding is None:
        notices.append(Notice("not UTF-8; read as Windows-1252", file))

    def resolves(header: list[str]) -> bool:
        try:
            found = resolve(header, options.columns, file=file)
        except UsageError:
            return False
        return found.form == "summary" or bool(found.present & {"k_adj", "b_adj"})

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
    return Grid(
        with_names([name.strip() for name in header]),
        [cells[at] for at in kept],
        [at + 2 for at in kept],
        blank,
    )


def _text(value: Any) -> str:
    """Write a typed cell as text; `repr` of a float reads back as the same double."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return "" if value != value else repr(float(value))
    if value is None or value is pd.NA or value is pd.NaT:
        return ""
    return str(value)
