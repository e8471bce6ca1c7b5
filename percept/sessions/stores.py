"""Tables inside JSON, SQLite, MATLAB and R files, as a header and rows of values.

Nothing in them is run. Each reader holds what a file says of its size to limits before it makes
the rows.
"""

from __future__ import annotations

import json
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from typing import Any

from percept.errors import UsageError
from percept.sessions import matlab
from percept.sessions.options import FileLimits
from percept.sessions.records import NoDataError, shown
from percept.sessions.values import unique_keys

#: Bytes of one cell of a database: more than any mouse track has.
_LONGEST_CELL = 16 << 20
_NOT_A_TABLE = "Export the table as CSV."
_MAKE_FRAME = 'In R: write.csv(as.data.frame(OBJECT), "data.csv"), then read data.csv.'
Rows = list[Sequence[Any]]
Columns = Mapping[str, Sequence[object]]
Construct = Callable[[Any], Any]


def chosen(names: Sequence[str], part: str | None, file: str, also: str = "") -> str:
    """Choose the part of a file that is named, or its only one."""
    wanted = list(names) if part is None else [name for name in names if name == part]
    if len(wanted) == 1:
        return wanted[0]
    if not names:
        raise NoDataError("the file holds no table.", file=file, hint="Leave it out.")
    what = "several tables" if part is None else "no such table"
    message = f"the file holds {what}; there are {shown(names)}."
    hint = f"Name one behind two colons: {file.partition('::')[0]}::{names[0]}."
    raise UsageError(message, file=file, hint=f"{hint} {also}".strip())


def json_rows(data: bytes, file: str, part: str | None, limits: FileLimits) -> Rows:
    """Read records: a list of objects, one behind each key, columns as lists, or JSON Lines."""
    text = data.decode("utf-8-sig")
    try:
        values = [_loaded(text)]
    except ValueError:
        values = [_loaded(line) for line in text.splitlines() if line.strip()]
    if len(values) == 1 and isinstance(values[0], dict):
        lists = {key: value for key, value in values[0].items() if isinstance(value, list)}
        if any(value and not isinstance(value[0], dict) for value in lists.values()):
            return _rows_of_columns(lists, file, limits)
        if lists:
            key = chosen(list(lists), part, file)
            values = [lists[key]]
    records = list(_records(values))
    if not all(isinstance(record, dict) for record in records):
        message = "this JSON is not a list of records."
        raise UsageError(message, file=file, hint=_NOT_A_TABLE)
    keys: dict[str, None] = {}
    for record in records:
        keys.update(dict.fromkeys(record))
    limits.hold_table(len(records), len(keys), file)
    rows: Rows = [list(keys)]
    for record in records:
        rows.append([_json_cell(record.get(key)) for key in keys])
    return rows


def _records(values: Sequence[Any]) -> Iterator[Any]:
    """Give the records of lists in lists: a file may hold a list for each subject."""
    for value in values:
        if isinstance(value, list):
            yield from _records(value)
        else:
            yield value


def _loaded(text: str) -> Any:
    """Read JSON; numbers stay as they are written."""
    return json.loads(
        text,
        parse_float=str,
        parse_int=str,
        parse_constant=str,
        object_pairs_hook=unique_keys,
    )


def _json_cell(value: Any) -> str:
    """Write a value of a record as the text of a cell; what is nested stays JSON."""
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _rows_of_columns(columns: Columns, file: str, limits: FileLimits) -> Rows:
    """Put columns side by side; columns of another length than most are no part of the table."""
    lengths = Counter(len(column) for column in columns.values())
    if not lengths:
        return []
    length = lengths.most_common(1)[0][0]
    table = {name: column for name, column in columns.items() if len(column) == length}
    limits.hold_table(length, len(table), file)
    return [list(table), *zip(*table.values(), strict=True)]


def database_rows(data: bytes, file: str, part: str | None, limits: FileLimits) -> Rows:
    """Read a table of an SQLite database; its views and triggers are not used."""
    import sqlite3

    with closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(data)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_CELL)
        connection.execute("PRAGMA trusted_schema = OFF")
        listing = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        names = [name for (name,) in connection.execute(listing)]
        table = chosen(names, part, file).replace('"', '""')
        cursor = connection.execute(f'SELECT * FROM "{table}"')
        header = [column[0] for column in cursor.description]
        rows: Rows = [header]
        size = 0
        for row in cursor:
            limits.hold_table(len(rows), len(header), file)
            # A generated column is worked out here: it takes no room in the file.
            size += sum(len(value) for value in row if isinstance(value, str | bytes))
            limits.hold_size(size, file)
            rows.append(row)
    return rows


def matlab_rows(data: bytes, file: str, part: str | None, limits: FileLimits) -> Rows:
    """Read a struct of columns, an array of structs, a matrix, or vectors of one length."""
    found = matlab.variables(data, file, limits)
    tables = matlab.tables(found)
    if part is None and not tables:
        table = matlab.vectors(found)
    else:
        table = matlab.columns(found[chosen(tables if part is None else list(found), part, file)])
    return _rows_of_columns(table, file, limits)


def r_rows(data: bytes, file: str, part: str | None, limits: FileLimits) -> Rows:
    """Read a data frame of an .rds, .rda or .RData file."""
    import rdata

    constructors = dict(rdata.parser.DEFAULT_ALTREP_MAP)
    lengths: list[int] = []
    for name in (b"compact_intseq", b"compact_realseq"):
        constructors[name] = _bounded(constructors[name], lengths, file, limits)
    extension = ".rda" if data.startswith(b"RD") else ".rds"
    parsed = rdata.parser.parse_data(
        data, altrep_constructor_dict=constructors, extension=extension
    )
    with warnings.catch_warnings():
        # Classes that it does not know, such as nlme's, lie around a data frame or beside.
        warnings.simplefilter("ignore", UserWarning)
        frame = rdata.conversion.convert(parsed)
    if isinstance(frame, dict):
        frames = [name for name, value in frame.items() if hasattr(value, "columns")]
        if not frames:
            message = (
                f"this R file holds {shown([str(name) for name in frame])}, and no data frame."
            )
            raise NoDataError(message, file=file, hint=_MAKE_FRAME)
        frame = frame[chosen(frames, part, file)]
    if not hasattr(frame, "columns"):
        raise UsageError("this R object is no data frame.", file=file, hint=_MAKE_FRAME)
    limits.hold_table(len(frame), len(frame.columns), file)
    columns = {}
    for name in frame:
        columns[str(name)] = [matlab.plain(item) for item in frame[name]]
    return _rows_of_columns(columns, file, limits)


def _bounded(construct: Construct, lengths: list[int], file: str, limits: FileLimits) -> Construct:
    """Hold sequences, which R writes as their lengths alone, to the limits before they are made."""

    def construct_within_limits(state: Any) -> Any:
        length = int(state.value[0])
        lengths.append(length)
        limits.hold_table(length, 1, file)
        limits.hold_table(1, sum(lengths), file)
        return construct(state)

    return construct_within_limits
