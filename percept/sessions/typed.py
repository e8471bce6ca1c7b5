"""Files of typed values to cells of text, within limits; Parquet and Excel are read here."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions.files import Input, is_workbook, load
from percept.sessions.grids import Block, Dialect, Grid, Records
from percept.sessions.layout import FirstRows, refuse_layout
from percept.sessions.options import FileLimits
from percept.sessions.records import NoDataError
from percept.sessions.stores import chosen, database_rows, json_rows, matlab_rows, r_rows

_Reader = Callable[[bytes, str, str | None, FileLimits], list[Sequence[Any]]]
#: How JSON begins that holds records or lists.
_JSON = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*[\"}]|\[\s*[\[{])")
#: Rows of a sheet in which text around the table is looked for.
_FIRST_ROWS = 60
#: Bytes that tell a format.
_BEGINNING = 256


def _reader(beginning: bytes) -> _Reader | None:
    """Return what reads a file that begins so; None for plain text."""
    for signature, reader in _READERS.items():
        if beginning.startswith(signature):
            return reader
    return json_rows if _JSON.match(beginning) else None


def is_typed(entry: Input) -> bool:
    """Whether a file holds typed values instead of delimited text."""
    with entry.open() as stream:
        beginning = stream.read(_BEGINNING)
    if _reader(beginning) is None and _is_unread_matlab(beginning, entry.name):
        message = "not a MATLAB file that percept reads (versions 5, 7 and 7.3)."
        raise UsageError(message, file=entry.name, hint="In Octave, save with -v7.")
    return _reader(beginning) is not None or is_workbook(entry.data or b"", entry.name)


def _is_unread_matlab(beginning: bytes, name: str) -> bool:
    """Whether a file is of MATLAB 4, which has no header, or of Octave's formats."""
    is_octave = beginning.startswith((b"Octave-1-", b"# Created by Octave"))
    return is_octave or (name.casefold().endswith(".mat") and b"\0" in beginning)


def csv_frame(path: str, limits: FileLimits) -> pd.DataFrame:
    """Read a CSV of numbers within the limits, packed or not.

    Parameters
    ----------
    path : str
        The file.
    limits : FileLimits
        Most bytes, unpacked too, rows and cells.

    Returns
    -------
    DataFrame

    Raises
    ------
    UsageError
        The file cannot be read, or passes a limit.
    """
    entry, *_ = load(path, limits)
    try:
        table = pd.read_csv(io.BytesIO(entry.read(limits)))
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot be read: {error}.", file=path) from error
    limits.hold_table(len(table), len(table.columns), path)
    return table


def typed_rows(data: bytes, file: str, part: str | None, limits: FileLimits) -> list[Sequence[Any]]:
    """Give the header and rows of a table, with the values that the file stores.

    Parameters
    ----------
    data : bytes
        The file: Parquet, Excel, JSON, SQLite, MATLAB or R.
    file : str
        Its name for messages.
    part : str or None
        The sheet, table or variable; None for the first sheet or the only table.
    limits : FileLimits
        Most rows and cells.

    Raises
    ------
    UsageError
        The file is broken, lacks the part, passes a limit, or needs a package that is missing.
    """
    reader = _reader(data[:_BEGINNING]) or _sheet_rows
    try:
        rows = reader(data, file, part, limits)
    except UsageError:
        raise
    except ImportError as error:
        message = f"this file needs {error.name}."
        hint = f"Install it: pip install {error.name}."
        raise UsageError(message, file=file, hint=hint) from None
    # What the readers meet in a broken file escapes: KeyError, zlib.error and others.
    except Exception as error:  # noqa: BLE001
        message = f"a broken file: {str(error).rstrip('.')}."
        raise UsageError(message, file=file, hint="Write it again, or as CSV.") from None
    if not rows or not rows[0]:
        raise NoDataError("the table is empty.", file=file, hint="Leave it out, or name another.")
    return rows


def _parquet_rows(
    data: bytes, file: str, part: str | None, limits: FileLimits
) -> list[Sequence[Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = pa.BufferReader(data)
    size = pq.read_metadata(buffer)
    limits.hold_table(size.num_rows, size.num_columns, file)
    table = pq.read_table(pa.BufferReader(data))
    columns = [column.to_pylist() for column in table.columns]
    return [table.column_names, *zip(*columns, strict=True)]


def _sheet_rows(
    data: bytes, file: str, part: str | None, limits: FileLimits
) -> list[Sequence[Any]]:
    """Give the rows of a sheet, each as wide as its header."""
    rows = list(_ragged_rows(data, file, part, limits))
    if not rows:
        hint = "Name another with [sessions] sheet."
        raise UsageError("the sheet is empty.", file=file, hint=hint)
    widest = max(map(len, rows))
    padded = [row + [""] * (widest - len(row)) for row in rows[:_FIRST_ROWS]]
    texts = [[_text(value) for value in row] for row in padded]
    refuse_layout(FirstRows.of(file, texts, range(1, len(texts) + 1)))
    # Cells right of the last column name hold notes.
    width = len(rows[0])
    return [row[:width] + [""] * (width - len(row)) for row in rows]


def _ragged_rows(
    data: bytes, file: str, sheet: str | None, limits: FileLimits
) -> Iterator[list[Any]]:
    """Give the rows of a sheet without their trailing blank cells."""
    import openpyxl

    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    names = book.sheetnames
    if sheet is None:
        names = sheets(data) or names[:1]
    name = chosen(names, sheet, file, 'Or read all that are alike: [sessions] sheet = "*".')
    page = book[name]
    written = openpyxl.load_workbook(io.BytesIO(data), read_only=True)[name]
    # The size that a sheet states may be wrong.
    page.reset_dimensions()
    written.reset_dimensions()
    blank_rows = 0
    width = 0
    for number, rows in enumerate(zip(page.iter_rows(), written.iter_rows(), strict=True), 1):
        values = [_sheet_value(*cells) for cells in zip(*rows, strict=True)]
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


def sheets(data: bytes) -> list[str]:
    """Name the sheets of a workbook that have a cell with a value."""
    import openpyxl

    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    return [name for name in book.sheetnames if _is_filled(book[name])]


def _is_filled(page: Any) -> bool:
    """Whether a sheet has a cell with a value."""
    rows = page.iter_rows(values_only=True)
    return any(value is not None for row in rows for value in row)


#: How files begin, and what reads them.
_READERS: dict[bytes, _Reader] = {
    b"PAR1": _parquet_rows,
    b"SQLite format 3": database_rows,
    b"MATLAB 5": matlab_rows,
    b"MATLAB 7": matlab_rows,
    b"RDX2\n": r_rows,
    b"RDX3\n": r_rows,
    b"X\n\0\0\0": r_rows,
}


def _sheet_value(cell: Any, written: Any) -> Any:
    """Value of a cell, or its formula if no program has worked that out; errors are blank.

    Whole numbers are written without a point.
    """
    value = cell.value
    if value is None and written.data_type == "f":
        return written.value
    if value is None or cell.data_type == "e":
        return ""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def typed_block(rows: Iterable[Sequence[Any]], file: str, limits: FileLimits) -> Block:
    """Write the typed cells of a header and rows as text.

    Parameters
    ----------
    rows : iterable of sequences
        The header, then the rows.
    file : str
        The file's name for messages.
    limits : FileLimits
        Most bytes of all texts together: a file may hold one text many times.

    Raises
    ------
    NoDataError
        There is a header alone, or nothing.
    UsageError
        The texts pass the limit, or one is no text that can be written.
    """
    header, *records = _texts(rows, file, limits)
    if not header:
        raise NoDataError("the table is empty.", file=file, hint="Leave it out, or name another.")
    # A last column without a name is no mark of a delimiter here.
    names = tuple(name.strip() or f"column {number}" for number, name in enumerate(header, 1))
    dialect = Dialect(file, names=names)
    lines = list(range(2, len(records) + 2))
    grid = Grid.of(dialect, Records(records, lines), last=False)
    if grid.cells.empty:
        raise NoDataError("there are no data below the header.", file=file, hint="Leave it out.")
    return Block(dialect, grid)


def _texts(rows: Iterable[Sequence[Any]], file: str, limits: FileLimits) -> Iterator[list[str]]:
    """Write the cells of each row as text, and hold all together to the limit."""
    size = 0
    for number, row in enumerate(rows, 1):
        texts = [_text(value) for value in row]
        for text in texts:
            size += len(text)
            # Half of a character, which JSON and Python can write, is in no file.
            if not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text):
                message = "half of a character (a lone surrogate)."
                hint = "Write the text again."
                raise UsageError(message, file=file, row=number, value=text, hint=hint)
        limits.hold_size(size, file)
        yield texts


def _text(value: Any) -> str:
    """Write a typed cell as text; `repr` of a float reads back as the same double."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return "" if value != value else repr(float(value))
    return "" if value is None or value is pd.NA or value is pd.NaT else str(value)
