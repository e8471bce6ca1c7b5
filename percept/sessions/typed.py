"""Tables of typed values to rows of text: Parquet, Excel, JSON, SQLite, MATLAB and R.

Nothing in the files is run. Each reader holds what a file says of its size to the limits before it
makes the rows.
"""

from __future__ import annotations

import io
import json
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions import matlab
from percept.sessions.grid import Grid
from percept.sessions.inputs import Input, is_workbook, load
from percept.sessions.options import FileLimits
from percept.sessions.records import NoDataError, shown
from percept.sessions.text import refuse_half
from percept.sessions.values import loaded_json

#: The header, then the rows.
_Table = list[Sequence[Any]]
_Reader = Callable[[Input, FileLimits], _Table]
#: How JSON begins that holds records or lists.
_JSON = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*[\"}]|\[\s*[\[{])")
#: Bytes from the beginning that tell a format: signatures are shorter, JSON may begin with blanks.
_BEGINNING = 256
#: Bytes of one cell of a database: more than any mouse track has.
_LONGEST_CELL = 16 << 20
_MAKE_FRAME = 'In R: write.csv(as.data.frame(OBJECT), "data.csv"), then read data.csv.'


def _reader(entry: Input) -> _Reader | None:
    """Return what reads a file; None for plain text."""
    beginning = entry.data[:_BEGINNING]
    for signature, reader in _READERS.items():
        if beginning.startswith(signature):
            return reader
    if is_workbook(entry.data, entry.name):
        return _sheet
    return _json if _JSON.match(beginning) else None


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
        table = pd.read_csv(io.BytesIO(entry.data))
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot be read: {error}.", file=path) from error
    limits.hold_table(len(table), len(table.columns), path)
    return table


def typed_grid(entry: Input, limits: FileLimits) -> Grid | None:
    """Read the header and rows of a table, and write their values as text; None for plain text.

    Raises
    ------
    UsageError
        The file is broken, lacks the part, passes a limit, or needs a package that is missing.
    """
    reader = _reader(entry)
    beginning = entry.data[:_BEGINNING]
    # MATLAB 4 has no header, and Octave has formats of its own.
    unread = beginning.startswith((b"Octave-1-", b"# Created by Octave"))
    unread |= entry.name.casefold().endswith(".mat") and b"\0" in beginning
    if reader is None and unread:
        message = "not a MATLAB file that percept reads (versions 5 to 7)."
        raise UsageError(message, file=entry.name, hint="In Octave, save with -v7.")
    if reader is None:
        return None
    with _refusing(entry):
        rows = reader(entry, limits)
    return grid_of(rows, entry.name, limits, has_notes=reader is _sheet)


@contextmanager
def _refusing(entry: Input) -> Iterator[None]:
    """Refuse a file in which a reader meets what it cannot read, or that needs another package."""
    try:
        yield
    except UsageError as error:
        error.file = entry.name
        raise
    except ImportError as error:
        message = f"this file needs {error.name}."
        hint = f"Install it: pip install {error.name}."
        raise UsageError(message, file=entry.name, hint=hint) from None
    # What the readers meet in a broken file escapes: KeyError, zlib.error and others.
    except Exception as error:  # noqa: BLE001
        message = f"a broken file: {str(error).rstrip('.')}."
        raise UsageError(message, file=entry.name, hint="Write it again, or as CSV.") from None


def grid_of(
    rows: Sequence[Sequence[Any]],
    file: str,
    limits: FileLimits,
    *,
    has_notes: bool = False,
) -> Grid:
    """Write a header and rows of values as text, within the limits.

    Raises
    ------
    UsageError
        There is no row below a header, the texts pass the limit, or one cannot be written.
    """
    texts = enumerate(_texts(rows, file, limits), 1)
    return Grid(texts, file, has_notes=has_notes)


def _texts(rows: Iterable[Sequence[Any]], file: str, limits: FileLimits) -> Iterator[list[str]]:
    """Write the cells of each row; a file may hold one long text many times."""
    size = 0
    for number, row in enumerate(rows, 1):
        texts = [_text(value) for value in row]
        joined = "".join(texts)
        refuse_half(joined, file, number)
        size += len(joined)
        limits.hold_size(size, file)
        yield texts


def _text(value: Any) -> str:
    """Write a typed cell as text; `repr` of a float reads back as the same double."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return "" if value != value else repr(float(value))
    return "" if value is None or value is pd.NA or value is pd.NaT else str(value)


def _chosen(names: Sequence[str], entry: Input, remedy: str = "") -> str:
    """Choose the part that is named, or the only one; a hint shows the first, then a remedy."""
    wanted = [name for name in names if entry.part in (None, name)]
    if len(wanted) == 1:
        return wanted[0]
    if not names:
        raise NoDataError("the file holds no table.", file=entry.name, hint="Leave it out.")
    what = "several tables" if entry.part is None else "no such table"
    message = f"the file holds {what}; there are {shown(names)}."
    place = entry.name.partition("::")[0]
    hint = f"Name one behind two colons: {place}::{names[0]}. {remedy}"
    raise UsageError(message, file=entry.name, hint=hint.strip())


def _side_by_side(columns: matlab.Columns, entry: Input, limits: FileLimits) -> _Table:
    """Put columns side by side; columns of another length than most are no part of the table."""
    lists = {name: [cells] if np.ndim(cells) == 0 else cells for name, cells in columns.items()}
    lengths = Counter(map(len, lists.values()))
    if not lengths:
        return []
    length = lengths.most_common(1)[0][0]
    table = {name: cells for name, cells in lists.items() if len(cells) == length}
    limits.hold_table(length, len(table), entry.name)
    return [list(table), *zip(*(map(_plain, cells) for cells in table.values()), strict=True)]


def _plain(item: Any) -> Any:
    """Take a single value out of NumPy's arrays; an empty one is a blank cell."""
    if isinstance(item, list | np.ndarray):
        values = np.ravel(np.array(item, dtype=object)).tolist()
        item = values[0] if len(values) == 1 else str(values) if values else ""
    # MATLAB's and R's numbers are doubles: 3 is no 3.0.
    return int(item) if isinstance(item, float) and item.is_integer() else item


def _parquet(entry: Input, limits: FileLimits) -> _Table:
    """Read a Parquet file, whose footer states its size."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = pa.BufferReader(entry.data)
    size = pq.read_metadata(buffer)
    limits.hold_table(size.num_rows, size.num_columns, entry.name)
    table = pq.read_table(pa.BufferReader(entry.data))
    columns = [column.to_pylist() for column in table.columns]
    return [table.column_names, *zip(*columns, strict=True)]


def sheets(entry: Input) -> list[Input]:
    """Give each sheet of a workbook that has a cell with a value as an input of its own."""
    found = []
    with _refusing(entry):
        for page in _workbook(entry):
            rows = page.iter_rows(values_only=True)
            if any(value is not None for row in rows for value in row):
                name = f"{entry.name}::{page.title}"
                path = f"{entry.path}/{page.title}"
                found.append(replace(entry, name=name, path=path, part=page.title))
    return found


def _workbook(entry: Input, *, values: bool = True) -> Any:
    """Open a workbook, for what its formulas gave or for the formulas themselves."""
    import openpyxl

    return openpyxl.load_workbook(io.BytesIO(entry.data), read_only=True, data_only=values)


def _sheet(entry: Input, limits: FileLimits) -> _Table:
    """Read a sheet; all rows are as wide as the widest."""
    book = _workbook(entry)
    names = book.sheetnames
    if entry.part is None:
        names = [sheet.part for sheet in sheets(entry)] or names[:1]
    remedy = 'Or read all that are alike: [sessions] sheet = "*".'
    name = _chosen(names, entry, remedy)
    rows = list(_ragged(book[name], _workbook(entry, values=False)[name], entry.name, limits))
    if not rows:
        hint = "Name another with [sessions] sheet."
        raise UsageError("the sheet is empty.", file=entry.name, hint=hint)
    widest = max(map(len, rows))
    return [row + [""] * (widest - len(row)) for row in rows]


def _ragged(
    page: Any,
    written: Any,
    file: str,
    limits: FileLimits,
) -> Iterator[list[Any]]:
    """Give the rows of a sheet without their trailing blank cells."""
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


def _json(entry: Input, limits: FileLimits) -> _Table:
    """Read records: a list of objects, one behind each key, columns as lists, or JSON Lines."""
    text = entry.data.decode("utf-8-sig")
    try:
        values = [loaded_json(text)]
    except ValueError:
        values = [loaded_json(line) for line in text.splitlines() if line.strip()]
    if len(values) == 1 and isinstance(values[0], dict):
        lists = {key: value for key, value in values[0].items() if isinstance(value, list)}
        if any(value and not isinstance(value[0], dict) for value in lists.values()):
            return _side_by_side(lists, entry, limits)
        if lists:
            values = [lists[_chosen(list(lists), entry)]]
    records = list(_flat(values))
    if not all(isinstance(record, dict) for record in records):
        message = "this JSON is not a list of records."
        raise UsageError(message, file=entry.name, hint="Export the table as CSV.")
    keys: dict[str, None] = {}
    for record in records:
        keys.update(dict.fromkeys(record))
    limits.hold_table(len(records), len(keys), entry.name)
    rows = [[_json_cell(record.get(key)) for key in keys] for record in records]
    return [list(keys), *rows]


def _flat(values: Sequence[Any]) -> Iterator[Any]:
    """Give the records of lists in lists: a file may hold a list for each subject."""
    for value in values:
        if isinstance(value, list):
            yield from _flat(value)
        else:
            yield value


def _json_cell(value: Any) -> str:
    """Write a value of a record as the text of a cell; what is nested stays JSON."""
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _database(entry: Input, limits: FileLimits) -> _Table:
    """Read a table of an SQLite database; its views and triggers are not used."""
    import sqlite3

    with closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(entry.data)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_CELL)
        connection.execute("PRAGMA trusted_schema = OFF")
        listing = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        names = [name for (name,) in connection.execute(listing)]
        table = _chosen(names, entry).replace('"', '""')
        cursor = connection.execute(f'SELECT * FROM "{table}"')
        rows: _Table = [[column[0] for column in cursor.description]]
        size = 0
        for row in cursor:
            limits.hold_table(len(rows), len(row), entry.name)
            # A generated column is worked out here: it takes no room in the file.
            size += sum(len(value) for value in row if isinstance(value, str | bytes))
            limits.hold_size(size, entry.name)
            rows.append(row)
    return rows


def _matlab(entry: Input, limits: FileLimits) -> _Table:
    """Read a struct of columns, an array of structs, a matrix, or vectors of one length."""
    found, alone = matlab.tables(entry.data, entry.name, limits)
    # Structs of single values say something about the table.
    tables = [
        name
        for name, columns in found.items()
        if max(map(np.size, columns.values()), default=0) > 1
    ]
    if entry.part is None and not tables:
        if alone or not found:
            return _side_by_side(alone, entry, limits)
        message = f"{shown(list(found))} hold no columns of one length, and no rows."
        hint = "Save the table alone. In MATLAB: T = study.trials; save('T.mat', 'T', '-v7')."
        raise NoDataError(message, file=entry.name, hint=hint)
    name = _chosen(tables if entry.part is None else list(found), entry)
    return _side_by_side(found[name], entry, limits)


def _r(entry: Input, limits: FileLimits) -> _Table:
    """Read a data frame of an .rds, .rda or .RData file."""
    import rdata

    made = 0

    def within_limits(construct: Callable[[Any], Any], state: Any) -> Any:
        """Make a sequence, which R writes as its length alone, unless it passes a limit."""
        nonlocal made
        length = int(state.value[0])
        made += length
        limits.hold_table(length, 1, entry.name)
        limits.hold_table(1, made, entry.name)
        return construct(state)

    constructors = dict(rdata.parser.DEFAULT_ALTREP_MAP)
    for name in (b"compact_intseq", b"compact_realseq"):
        constructors[name] = partial(within_limits, constructors[name])
    parsed = rdata.parser.parse_data(
        entry.data,
        altrep_constructor_dict=constructors,
        extension=".rda" if entry.data.startswith(b"RD") else ".rds",
    )
    with warnings.catch_warnings():
        # Classes that it does not know, such as nlme's, lie around a data frame or beside.
        warnings.simplefilter("ignore", UserWarning)
        found = rdata.conversion.convert(parsed)
    objects = found if isinstance(found, dict) else {"": found}
    frames = {str(name): value for name, value in objects.items() if hasattr(value, "columns")}
    if not frames:
        message = "there is no data frame in this R file."
        raise NoDataError(message, file=entry.name, hint=_MAKE_FRAME)
    frame = frames[_chosen(list(frames), entry)]
    limits.hold_table(len(frame), len(frame.columns), entry.name)
    return _side_by_side({str(name): frame[name] for name in frame}, entry, limits)


#: How files begin, and what reads them.
_READERS: dict[bytes, _Reader] = {
    b"PAR1": _parquet,
    b"SQLite format 3": _database,
    b"MATLAB 5": _matlab,
    b"MATLAB 7": _matlab,
    b"RDX2\n": _r,
    b"RDX3\n": _r,
    b"X\n\0\0\0": _r,
}
