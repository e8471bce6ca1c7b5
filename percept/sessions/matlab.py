"""Variables of a MATLAB file of version 5 to 7, and the one among them that is the table.

Only what the bytes of a file hold is made, whatever it says of its size.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions.options import FileLimits

#: Bytes before the first variable.
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
#: Cells by column: an array, a list, or a single value.
Columns = dict[str, Any]
#: In an array's flags: its numbers are complex.
_COMPLEX = 0x800


def tables(data: bytes, file: str, limits: FileLimits) -> tuple[dict[str, Columns], Columns]:
    """Read a file: its tables by name, as columns, and the columns that stand alone.

    A struct is a table, and so are an array of structs and a matrix.

    Raises
    ------
    UsageError
        The file passes a limit, holds an object of MATLAB's own, or is of version 7.3.
    """
    found: dict[str, Columns] = {}
    alone = {}
    for name, value in _variables(data, file, limits):
        if isinstance(value, dict):
            found[name] = value
        elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
            found[name] = _below_one_another(value, file, limits)
        elif np.ndim(value) == 2:
            found[name] = {f"column {number}": cells for number, cells in enumerate(value.T, 1)}
        else:
            alone[name] = value
    return found, alone


def _below_one_another(structs: Sequence[Any], file: str, limits: FileLimits) -> Columns:
    """Columns of an array of structs; where a struct holds vectors, its single values repeat."""
    frame = pd.DataFrame(structs, dtype=object)
    sizes = frame.map(np.size)
    limits.hold_table(int(sizes.max(axis=1).sum()), len(frame.columns), file)
    vectors = [name for name in frame if (sizes[name] != 1).any()]
    if vectors:
        frame = frame.explode(vectors)
    return {str(name): column for name, column in frame.items()}


def _variables(data: bytes, file: str, limits: FileLimits) -> Iterator[tuple[str, Any]]:
    """Give each variable's name and value.

    A struct is a dict, an array of structs or a cell array a list, a text a str, and numbers are an
    array of one or two axes.
    """
    if data.startswith(b"MATLAB 7.3"):
        message = "a MATLAB file of version 7.3, which percept does not read."
        hint = "Save it in MATLAB as save('T.mat', '-v7'), or by writetable(T, 'T.csv')."
        raise UsageError(message, hint=hint)
    content = bytearray()
    for kind, packed in _elements(memoryview(data)[_HEADER:], padded=False):
        if kind == _COMPRESSED:
            room = limits.size + 1 - len(content)
            content += zlib.decompressobj().decompress(packed, room)
        else:
            content += struct.pack("<II", kind, len(packed)) + packed
        limits.hold_size(len(content), file)
    for kind, element in _elements(memoryview(content)):
        if kind == _MATRIX and element:
            yield _array(element)


def _elements(data: memoryview, *, padded: bool = True) -> Iterator[tuple[int, memoryview]]:
    """Give each element's kind and bytes."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        start = at + 8
        at = start + size + (-size % 8 if padded else 0)
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
        raise _object(bytes(second).decode(), bytes(rest[1][1]).decode())
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


def _object(name: str, kind: str) -> UsageError:
    """Say how an object of MATLAB's own is saved."""
    return UsageError(
        f"{name or 'it'} is a {kind} of MATLAB, an object that only MATLAB reads.",
        hint="Save it in MATLAB: writetable(T, 'T.csv'), or S = table2struct(T, 'ToScalar',"
        " true); save('T.mat', '-struct', 'S'). First turn strings into texts: T.name ="
        " cellstr(T.name).",
    )
