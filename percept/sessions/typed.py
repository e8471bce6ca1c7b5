"""Tables of typed values to rows of text: Parquet, Excel, JSON, SQLite, MATLAB and R.

Nothing in the files is run. Each reader gives a header and rows, which are held to the limits; what
a file says of its size is held to them before.
"""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions.grid import Grid, Rows
from percept.sessions.inputs import WORKBOOK, Input, refusing
from percept.sessions.records import NoDataError, clip, shown
from percept.sessions.values import loaded_json

#: Cells by column: an array, a list, or a single value.
_Columns = dict[str, Any]
#: The header, then the rows.
_Rows = Iterator[Sequence[Any]]
_Reader = Callable[[Input], _Rows]
#: Bytes of one cell of a database: more than any mouse track has.
_LONGEST_CELL = 16 << 20
#: Of MATLAB's files: bytes before the first variable.
_HEADER = 128
#: Kinds of data, as tags number them: arrays, packed variables, numbers and texts.
_MATRIX = 14
_COMPRESSED = 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_NUMBERS |= {12: "i8", 13: "u8"}
_TEXTS = {2: "latin-1", 4: "utf-16-le", 16: "utf-8", 17: "utf-16-le", 18: "utf-32-le"}
#: Classes of arrays. Those of numbers follow on 6.
_CELL = 1
_STRUCT = 2
_CHAR = 4
_FIRST_NUMBERS = 6
_LAST_NUMBERS = 15
_OBJECT = 17
#: In an array's flags: its numbers are complex.
_COMPLEX = 0x800
_OBJECT_HINT = (
    "Save it in MATLAB: writetable(T, 'T.csv'), or S = table2struct(T, 'ToScalar', true);"
    " save('T.mat', '-struct', 'S'). First turn strings into texts: T.name = cellstr(T.name)."
)
_MAKE_FRAME = 'In R: write.csv(as.data.frame(OBJECT), "data.csv"), then read data.csv.'


def typed_grid(entry: Input) -> Grid | None:
    """Read a table and write its values as text; None for plain text.

    Raises
    ------
    UsageError
        The file is broken, lacks the part, passes a limit, or needs a package that is missing.
    """
    for signature, reader in _READERS.items():
        if re.match(signature, entry.data):
            return Grid(texts_of(reader(entry), entry), entry.name)
    return None


def texts_of(rows: _Rows, entry: Input) -> Rows:
    """Write a header and rows of values as text, within the limits.

    A file may hold one long text many times.
    """
    size = 0
    with refusing(entry.name):
        for number, row in enumerate(rows, 1):
            entry.hold_table(number, len(row))
            texts = [_text(value) for value in row]
            joined = "".join(texts)
            try:
                joined.encode()
            except UnicodeEncodeError:
                message = "half of a character (a lone surrogate)."
                hint = "Write the text again."
                raise UsageError(message, row=number, value=clip(joined), hint=hint) from None
            size += len(joined)
            entry.limits.hold("size", size, entry.name)
            yield number, texts


def _text(value: Any) -> str:
    """Write a typed cell as text; `repr` of a float reads back as the same double."""
    if isinstance(value, float):
        return "" if value != value else repr(float(value))
    return "" if value is None or value is pd.NA or value is pd.NaT else str(value)


def _chosen(names: Sequence[str], entry: Input, remedy: str = "") -> str:
    """Choose the part that is named, or the only one; a hint shows the first, then a remedy."""
    wanted = [name for name in names if entry.part in (None, name)]
    if len(wanted) == 1:
        return wanted[0]
    if not names:
        raise NoDataError("the file holds no table.", hint="Leave it out.")
    what = "several tables" if entry.part is None else "no such table"
    place = entry.name.partition("::")[0]
    hint = f"Name one behind two colons: {place}::{names[0]}. {remedy}".strip()
    raise UsageError(f"the file holds {what}; there are {shown(names)}.", hint=hint)


def _side_by_side(columns: _Columns, entry: Input) -> _Rows:
    """Put columns side by side; columns of another length than most are no part of the table."""
    lists = {name: [cells] if np.ndim(cells) == 0 else cells for name, cells in columns.items()}
    lengths = Counter(map(len, lists.values()))
    length = lengths.most_common(1)[0][0]
    table = {name: cells for name, cells in lists.items() if len(cells) == length}
    entry.hold_table(length, len(table))
    yield list(table)
    yield from zip(*(map(_plain, cells) for cells in table.values()), strict=True)


def _plain(item: Any) -> Any:
    """Take a single value out of NumPy's arrays; an empty one is a blank cell."""
    if isinstance(item, list | np.ndarray):
        values = np.ravel(np.array(item, dtype=object)).tolist()
        item = values[0] if len(values) == 1 else str(values) if values else ""
    # MATLAB's and R's numbers are doubles: 3 is no 3.0.
    return int(item) if isinstance(item, float) and item.is_integer() else item


def _parquet(entry: Input) -> _Rows:
    """Read a Parquet file, whose footer states its size."""
    from pyarrow import parquet

    file = parquet.ParquetFile(io.BytesIO(entry.data))
    entry.hold_table(file.metadata.num_rows, file.metadata.num_columns)
    yield file.schema_arrow.names
    for batch in file.iter_batches():
        yield from zip(*(column.to_pylist() for column in batch.columns), strict=True)


def sheets(entry: Input) -> list[Input]:
    """Give each sheet of a workbook that has a cell with a value as an input of its own."""
    found = []
    with refusing(entry.name):
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


def _sheet(entry: Input) -> _Rows:
    """Read a sheet; a blank cell ends each row, as a delimiter may in texts."""
    book = _workbook(entry)
    names = book.sheetnames
    if entry.part is None:
        names = [sheet.part for sheet in sheets(entry)] or names[:1]
    name = _chosen(names, entry, 'Or read all that are alike: [sessions] sheet = "*".')
    pages = [book[name], _workbook(entry, values=False)[name]]
    for page in pages:
        # The size that a sheet states may be wrong.
        page.reset_dimensions()
    rows = []
    width = 0
    for cells in zip(*(page.iter_rows() for page in pages), strict=True):
        values = list(map(_sheet_value, *cells))
        while values and values[-1] == "":
            values.pop()
        rows.append(values)
        width = max(width, len(values))
        entry.hold_table(len(rows), width)
    yield from (values + [""] * (width + 1 - len(values)) for values in rows)


def _sheet_value(cell: Any, written: Any) -> Any:
    """Value of a cell, or its formula if no program has worked that out; errors are blank.

    Whole numbers are written without a point.
    """
    value = cell.value
    if value is None and written.data_type == "f":
        return written.value
    return "" if value is None or cell.data_type == "e" else _plain(value)


def _json(entry: Input) -> _Rows:
    """Read records: a list of objects, one behind each key, columns as lists, or JSON Lines."""
    text = entry.data.decode("utf-8-sig")
    try:
        values = loaded_json(text)
    except ValueError:
        values = [loaded_json(line) for line in text.splitlines() if line.strip()]
    if isinstance(values, dict):
        lists = {key: value for key, value in values.items() if isinstance(value, list)}
        if any(value and not isinstance(value[0], dict) for value in lists.values()):
            yield from _side_by_side(lists, entry)
            return
        if lists:
            values = lists[_chosen(list(lists), entry)]
    records = list(_flat([values]))
    if not all(isinstance(record, dict) for record in records):
        raise UsageError("this JSON is not a list of records.", hint="Export the table as CSV.")
    keys = list(dict.fromkeys(key for record in records for key in record))
    yield keys
    yield from ([_json_cell(record.get(key)) for key in keys] for record in records)


def _flat(values: Sequence[Any]) -> Iterator[Any]:
    """Give the records of lists in lists: a file may hold a list for each subject."""
    for value in values:
        if isinstance(value, list):
            yield from _flat(value)
        else:
            yield value


def _json_cell(value: Any) -> Any:
    """Write what is nested, true or false as JSON does."""
    return json.dumps(value, ensure_ascii=False) if isinstance(value, dict | list | bool) else value


def _database(entry: Input) -> _Rows:
    """Read a table of an SQLite database; its views and triggers are not used."""
    import sqlite3

    with closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(entry.data)
        # A generated column is worked out here: it takes no room in the file.
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_CELL)
        connection.execute("PRAGMA trusted_schema = OFF")
        listing = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        names = [name for (name,) in connection.execute(listing)]
        table = _chosen(names, entry).replace('"', '""')
        cursor = connection.execute(f'SELECT * FROM "{table}"')
        yield [column[0] for column in cursor.description]
        yield from cursor


def _matlab(entry: Input) -> _Rows:
    """Read a struct of columns, an array of structs, a matrix, or vectors of one length."""
    found: dict[str, _Columns] = {}
    alone: _Columns = {}
    for name, value in _variables(entry):
        if isinstance(value, list) and any(isinstance(item, dict) for item in value):
            value = dict(pd.DataFrame(value, dtype=object))
        elif np.ndim(value) == 2:
            value = {f"column {number}": cells for number, cells in enumerate(value.T, 1)}
        if isinstance(value, dict):
            found[name] = value
        else:
            alone[name] = value
    if entry.part is None:
        # Structs of single values say something about the table.
        tables = {
            name: columns
            for name, columns in found.items()
            if max(map(np.size, columns.values()), default=0) > 1
        }
        if found and not tables and not alone:
            message = f"{shown(list(found))} hold no columns of one length, and no rows."
            hint = "Save the table alone. In MATLAB: T = study.trials; save('T.mat', 'T', '-v7')."
            raise NoDataError(message, hint=hint)
        found = tables or ({"": alone} if alone else {})
    yield from _side_by_side(found[_chosen(list(found), entry)], entry)


def _variables(entry: Input) -> Iterator[tuple[str, Any]]:
    """Give each variable's name and value; only what the bytes hold is made, whatever they state.

    A struct is a dict, an array of structs or a cell array a list, a text a str, and numbers are an
    array of one or two axes.
    """
    size = 0
    for kind, element in _elements(memoryview(entry.data)[_HEADER:]):
        if kind == _COMPRESSED:
            content = zlib.decompressobj().decompress(element, entry.limits.size + 1 - size)
            size += len(content)
            entry.limits.hold("size", size, entry.name)
            kind, element = next(_elements(memoryview(content)))
        if kind == _MATRIX and element:
            yield _array(element)


def _elements(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Give each element's kind and bytes; all but packed ones fill eight bytes."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        start = at + 8
        at = start + size + (0 if kind == _COMPRESSED else -size % 8)
        if kind >> 16:
            # A value of up to four bytes stands in the tag itself.
            kind, size = kind & 0xFFFF, kind >> 16
            at = start
            start -= 4
        if start + size > len(data):
            raise ValueError("a value is cut short")
        yield kind, data[start : start + size]


def _array(data: memoryview) -> tuple[str, Any]:
    """Read one array: its name and value."""
    (_, flags), (_, second), *rest = _elements(data)
    (flag,) = struct.unpack_from("<I", flags)
    kind = flag & 0xFF
    if kind == _OBJECT:
        name = bytes(second).decode() or "it"
        message = f"{name} is a {bytes(rest[1][1]).decode()} of MATLAB, an object that only MATLAB"
        raise UsageError(f"{message} reads.", hint=_OBJECT_HINT)
    shape = tuple(np.frombuffer(second, "<i4"))
    name = bytes(rest[0][1]).decode()
    values = rest[1:]
    if kind == _CELL:
        return name, [_array(element)[1] for _, element in values]
    if kind == _STRUCT:
        return name, _structs(values)
    if kind == _CHAR:
        ((encoding, letters),) = values
        text = bytes(letters).decode(_TEXTS[encoding])
        rows = np.array(list(text), dtype=str).reshape(shape, order="F")
        texts = ["".join(row).rstrip() for row in rows]
        return name, texts[0] if len(texts) == 1 else texts
    if not _FIRST_NUMBERS <= kind <= _LAST_NUMBERS or flag & _COMPLEX:
        # A function, a sparse array or complex numbers are no column.
        return name, ""
    element, packed = values[0]
    numbers = np.frombuffer(packed, f"<{_NUMBERS[element]}").reshape(shape, order="F")
    return name, numbers.ravel() if 1 in shape else numbers


def _structs(values: Sequence[tuple[int, memoryview]]) -> Any:
    """Read the fields of a struct, or of an array of structs."""
    (_, length), (_, packed), *fields = values
    (each,) = struct.unpack_from("<i", length)
    texts = [bytes(packed[at : at + each]) for at in range(0, len(packed), each)]
    names = [text.split(b"\0")[0].decode() for text in texts]
    cells = [_array(element)[1] for _, element in fields]
    width = len(names)
    structs = [
        dict(zip(names, cells[at : at + width], strict=True)) for at in range(0, len(cells), width)
    ]
    return structs[0] if len(structs) == 1 else structs or {name: [] for name in names}


def _r(entry: Input) -> _Rows:
    """Read a data frame of an .rds, .rda or .RData file."""
    import rdata

    made = 0

    def within_limits(construct: Callable[[Any], Any], state: Any) -> Any:
        """Make a sequence, which R writes as its length alone, unless it passes a limit."""
        nonlocal made
        made += int(state.value[0])
        entry.hold_table(made, 1)
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
        raise NoDataError("there is no data frame in this R file.", hint=_MAKE_FRAME)
    frame = frames[_chosen(list(frames), entry)]
    yield from _side_by_side({str(name): frame[name] for name in frame}, entry)


#: How files begin, and what reads them; of JSON those that hold records or lists.
_READERS: dict[bytes, _Reader] = {
    rb"PAR1": _parquet,
    rb"SQLite format 3": _database,
    rb"MATLAB 5": _matlab,
    rb"RDX[23]\n|X\n\0\0\0": _r,
    WORKBOOK: _sheet,
    rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*[\"}]|\[\s*[\[{])": _json,
}
