"""Parquet files and Excel sheets to cells of text, within limits."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions.grids import Block, Dialect, Grid, Records
from percept.sessions.options import FileLimits
from percept.sessions.records import NoDataError

__all__ = ["PARQUET", "typed_block", "typed_rows"]

#: How a Parquet file begins.
PARQUET = b"PAR1"


def typed_rows(
    data: bytes, file: str, sheet: str | None, limits: FileLimits
) -> list[Sequence[Any]]:
    """Give the header and rows of a Parquet file, or of a sheet with the values Excel stored.

    Parameters
    ----------
    data : bytes
        The file.
    file : str
        Its name for messages.
    sheet : str or None
        The sheet of a workbook; None for its first.
    limits : FileLimits
        Most rows and cells.

    Raises
    ------
    UsageError
        The file is broken, lacks the sheet, passes a limit, or needs a package that is missing.
    """
    package = "pyarrow" if data.startswith(PARQUET) else "openpyxl"
    try:
        if package == "pyarrow":
            return _parquet_rows(data, file, limits)
        rows = list(_sheet_rows(data, file, sheet, limits))
    except UsageError:
        raise
    except ImportError:
        message = f"this file needs {package}."
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
        message = f"there is no such sheet; the sheets are {', '.join(book.sheetnames)}."
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


def typed_block(rows: Iterable[Sequence[Any]], file: str) -> Block:
    """Write the typed cells of a header and rows as text.

    Parameters
    ----------
    rows : iterable of sequences
        The header, then the rows.
    file : str
        The file's name for messages.

    Raises
    ------
    NoDataError
        There is a header alone.
    """
    header, *records = ([_text(value) for value in row] for row in rows)
    # A last column without a name is no mark of a delimiter here.
    names = tuple(name.strip() or f"column {number}" for number, name in enumerate(header, 1))
    dialect = Dialect(file, names=names)
    lines = list(range(2, len(records) + 2))
    grid = Grid.of(dialect, Records(records, lines), last=False)
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
