"""Tables that are not text: Parquet, Excel workbooks and DataFrames, turned into the same grid of text."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions.dialect import Dialect, Grid

_EXTRA = "Install what reads it: pip install 'percept[tables]'."
_NO_DIALECT = Dialect("", "plain")


def frame_grid(frame: pd.DataFrame, *, file: str) -> Grid:
    """Grid of a DataFrame; a row's number is its position plus 2, as if a header were line 1."""
    columns = [_texts(frame.iloc[:, at].tolist()) for at in range(frame.shape[1])]
    return _grid([str(name) for name in frame.columns], columns, file)


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
        raise UsageError(
            f"a broken Parquet file: {str(error).rstrip('.')}.", file=file, hint="Write it again."
        ) from None
    return _grid(list(table.column_names), [_texts(column.to_pylist()) for column in table.columns], file)


def excel_grid(data: bytes, *, file: str, sheet: str | None) -> Grid:
    """Grid of one sheet of an Excel workbook; formulas count with the values Excel stored."""
    try:
        import openpyxl  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise UsageError("an Excel workbook needs openpyxl.", file=file, hint=_EXTRA) from None
    try:
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        names = list(book.sheetnames)
        rows = [] if sheet is not None and sheet not in names else list(
            (book[sheet] if sheet else book.worksheets[0]).iter_rows(values_only=True)
        )  # fmt: skip
        book.close()
    # openpyxl lets whatever its XML reader meets escape: KeyError, ValueError, zlib.error and others.
    except Exception as error:  # noqa: BLE001
        raise UsageError(
            f"a broken workbook: {error}.", file=file, hint="Save it again, or as CSV."
        ) from None
    if sheet is not None and sheet not in names:
        raise UsageError(f"no such sheet; there are {', '.join(names)}.", file=file, value=sheet)
    if not rows:
        raise UsageError("the sheet is empty.", file=file, hint="Name another with [sessions] sheet.")
    width = max((at + 1 for at, name in enumerate(rows[0]) if name is not None), default=0)
    columns = [_texts(row[at] if at < len(row) else None for row in rows[1:]) for at in range(width)]
    return _grid(_texts(rows[0][:width]), columns, file)


def _grid(header: Sequence[str], columns: Sequence[list[str]], file: str) -> Grid:
    cells = [list(record) for record in zip(*columns, strict=True)]
    rows = list(range(2, len(cells) + 2))
    kept = [at for at, record in enumerate(cells) if any(cell.strip() for cell in record)]
    if not kept:
        raise UsageError("there are no data below the header.", file=file, hint="Leave it out.")
    dropped = {"blank line": len(cells) - len(kept)} if len(kept) < len(cells) else {}
    return Grid(
        [name.strip() for name in header],
        [cells[at] for at in kept],
        [rows[at] for at in kept],
        _NO_DIALECT,
        dropped,
    )


def _texts(values: Iterable[Any]) -> list[str]:
    return [_text(value) for value in values]


def _text(value: Any) -> str:
    """Write a typed cell as text; `repr` of a float reads back as the same double."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return "" if value != value else repr(float(value))
    if value is None or value is pd.NA or value is pd.NaT:
        return ""
    return str(value)
