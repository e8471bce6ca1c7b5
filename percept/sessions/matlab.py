"""Variables of a MATLAB file, and the one among them that is the table."""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from percept.errors import UsageError
from percept.sessions.options import FileLimits

#: Bytes before the first variable of versions 5 and 7.
_HEADER = 128
#: Kinds of data that MATLAB writes, as its tags number them. SciPy crashes on some others.
_INT32 = 5
_MATRIX = 14
_COMPRESSED = 15
_KINDS = frozenset([*range(1, 8), 9, 12, 13, _MATRIX, 16, 17, 18])
#: Classes of arrays. Those of texts and numbers have one value behind the name, or two.
_CELL = 1
_STRUCT = 2
_OLD_OBJECT = 3
_VALUES = frozenset([4, *range(6, 16)])
_OBJECT = 17
#: In an array's flags: its numbers are complex.
_COMPLEX = 0x800
#: Structs inside structs; SciPy reads them by recursion.
_DEEPEST = 20
#: A vector, a matrix, a struct as its fields, or an array of structs as a list of these.
_Variables = dict[str, Any]


def plain(item: Any) -> Any:
    """Take a single value out of NumPy's arrays; an empty one is a blank cell."""
    if isinstance(item, np.ndarray) and item.size == 0:
        return ""
    if isinstance(item, np.ndarray | np.generic):
        item = item.item() if item.size == 1 else str(item)
    # MATLAB's and R's numbers are doubles: 3 is no 3.0.
    if isinstance(item, float) and item.is_integer():
        return int(item)
    return item


def variables(data: bytes, file: str, limits: FileLimits) -> _Variables:
    """Read all variables of a file, after what they take has been held to the limits."""
    if data.startswith(b"MATLAB 7.3"):
        return _of_hdf5(data, file, limits)
    return _of_earlier(data, file, limits)


def tables(found: _Variables, file: str, limits: FileLimits) -> list[str]:
    """Name the variables that are tables; none where vectors of one length have more rows."""
    names = [name for name, value in found.items() if not _is_vector(value)]
    lengths = [value.size for name, value in found.items() if name not in names]
    repeated = [length for length in lengths if lengths.count(length) > 1]
    rows = [max(map(len, columns(found[name], file, limits).values()), default=0) for name in names]
    return [] if repeated and rows and max(repeated) > max(rows) else names


def vectors(found: _Variables) -> dict[str, Sequence[Any]]:
    """Give the variables that are one column each."""
    return {
        name: [plain(item) for item in value.ravel()]
        for name, value in found.items()
        if _is_vector(value)
    }


def columns(value: Any, file: str, limits: FileLimits) -> dict[str, Sequence[Any]]:
    """Columns of a struct, of an array of structs, or of a matrix."""
    if isinstance(value, list):
        return _below_one_another(value, file, limits)
    if not isinstance(value, dict):
        stood = value.T if value.ndim == 2 else [value]
        value = {f"column {number}": column for number, column in enumerate(stood, 1)}
    return {name: [plain(item) for item in _cells(column)] for name, column in value.items()}


def _below_one_another(
    structs: Sequence[_Variables], file: str, limits: FileLimits
) -> dict[str, Sequence[Any]]:
    """Columns of an array of structs; where a struct holds vectors, its single values repeat."""
    table: dict[str, list[Any]] = {name: [] for name in structs[0]}
    total = 0
    for number, struct_ in enumerate(structs, 1):
        fields = {name: list(map(plain, _cells(struct_[name]))) or [""] for name in table}
        lengths = {len(cells) for cells in fields.values()} - {1}
        if len(lengths) > 1:
            shapes = ", ".join(f"{name} {len(cells)}" for name, cells in fields.items())
            message = f"the vectors of struct {number} have different lengths: {shapes}"
            raise ValueError(message)
        rows = max(lengths, default=1)
        total += rows
        limits.hold_table(total, len(table), file)
        for name, cells in fields.items():
            table[name] += cells if len(cells) == rows else cells * rows
    return dict(table)


def _cells(column: Any) -> Any:
    """Give the cells of a column; one that is a struct is a single cell."""
    return column if isinstance(column, list) else np.atleast_1d(column).ravel()


def _is_vector(value: Any) -> bool:
    """Whether a variable is one column; a struct or a matrix is a table."""
    return isinstance(value, np.ndarray) and value.ndim != 2


def _object(name: str, kind: str, file: str) -> UsageError:
    """Say how an object of MATLAB's own is saved."""
    return UsageError(
        f"{name or 'it'} is a {kind} of MATLAB, an object that only MATLAB reads.",
        file=file,
        hint="Save it in MATLAB: writetable(T, 'T.csv'), or S = table2struct(T, 'ToScalar', true);"
        " save('T.mat', '-struct', 'S'). First turn strings into texts: T.name = cellstr(T.name).",
    )


def _of_earlier(data: bytes, file: str, limits: FileLimits) -> _Variables:
    """Read the variables of a file up to version 7."""
    from scipy.io import loadmat

    order = "<" if data[_HEADER - 2 : _HEADER] == b"IM" else ">"
    content = _inflated(data, order, file, limits)
    _Elements(order, file, limits).hold(memoryview(content))
    stream: Any = io.BytesIO(data[:_HEADER] + content)
    found: _Variables = {}
    for name, value in loadmat(stream, simplify_cells=True).items():
        if not name.startswith("__"):
            found |= _apart(name, value)
    return found


def _apart(name: str, value: Any) -> _Variables:
    """Give the structs inside a struct as variables of their own, such as "study.trials"."""
    if not isinstance(value, dict | list):
        return {name: np.atleast_1d(value)}
    inner = {}
    if isinstance(value, dict):
        inner = {f"{name}.{key}": own for key, own in value.items() if _is_struct(own)}
    if not inner:
        return {name: value}
    found: _Variables = {}
    for own_name, own in inner.items():
        found |= _apart(own_name, own)
    return found


def _is_struct(value: Any) -> bool:
    """Whether a value is a struct, or an array of them."""
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _inflated(data: bytes, order: str, file: str, limits: FileLimits) -> bytes:
    """Unpack the variables behind the header, and no more of them than the limit."""
    content = bytearray()
    at = _HEADER
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        end = at + 8 + size
        if kind == _COMPRESSED:
            unpacker = zlib.decompressobj()
            content += unpacker.decompress(data[at + 8 : end], limits.size + 1 - len(content))
        else:
            content += data[at:end]
        limits.hold_size(len(content), file)
        at = end
    return bytes(content)


@dataclass
class _Elements:
    """Data of versions 5 and 7, held to the limits by what each says of its size."""

    order: str  # "<" or ">", of bytes
    file: str
    limits: FileLimits
    cells: int = 0  # Of all arrays so far, in structs and cells too

    def hold(self, data: memoryview, depth: int = 0) -> None:
        """Refuse arrays of more cells than the limit, objects, and what MATLAB does not write."""
        if depth > _DEEPEST:
            raise ValueError("structs inside structs go too deep")
        for kind, value in self._elements(data):
            if kind == _MATRIX and value:
                self._hold_array(value, depth)

    def _hold_array(self, data: memoryview, depth: int) -> None:
        """Hold one array, and those in it."""
        (_, flags), (of_shape, second), *rest = self._elements(data)
        (flag,) = struct.unpack_from(f"{self.order}I", flags)
        kind = flag & 0xFF
        if kind == _OBJECT:
            raise _object(bytes(second).decode(), bytes(rest[1][1]).decode(), self.file)
        shape: list[int] = np.frombuffer(second, f"{self.order}i4").tolist()
        if of_shape != _INT32 or len(shape) < 2 or min(shape) < 0:
            raise ValueError("an array has no shape")
        cells = math.prod(shape)
        if kind in (_STRUCT, _OLD_OBJECT):
            # Behind the name, and an object's class, stand the fields' names, all of one length.
            (_, length), (_, names) = rest[kind - 1 : kind + 1]
            (each,) = struct.unpack_from(f"{self.order}i", length)
            cells *= max(1, len(names) // each)
        self.cells += cells
        self.limits.hold_table(1, self.cells, self.file)
        # SciPy crashes where these are fewer.
        arrays = sum(part == _MATRIX for part, _ in rest)
        values = len(rest) - 1 - arrays
        if kind in _VALUES:
            is_whole = not arrays and values == (2 if flag & _COMPLEX else 1)
        else:
            is_whole = kind in (_CELL, _STRUCT, _OLD_OBJECT) and arrays == cells
        if not is_whole:
            raise ValueError("an array has other values than it says, or is sparse")
        self.hold(data, depth + 1)

    def _elements(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        """Give each element's kind and bytes."""
        at = 0
        while at < len(data):
            kind, size = struct.unpack_from(f"{self.order}II", data, at)
            start = at + 8
            at = start + size + -size % 8
            if kind >> 16:
                # A value of up to four bytes stands in the tag itself.
                size = kind >> 16
                kind &= 0xFFFF
                start -= 4
                at = start + 4
            if kind not in _KINDS or start + size > len(data):
                raise ValueError("a value is cut short, or of a kind that MATLAB does not write")
            yield kind, data[start : start + size]


def _of_hdf5(data: bytes, file: str, limits: FileLimits) -> _Variables:
    """Read the variables of a file of version 7.3."""
    import h5py

    found: _Variables = {}
    with h5py.File(io.BytesIO(data), "r") as opened:
        reader = _Hdf5(opened, file, limits)
        for name in opened:
            # What cells refer to.
            if name.startswith("#"):
                continue
            item = reader.member(opened, name)
            if isinstance(item, h5py.Group):
                found[name] = {field: reader.values(reader.member(item, field)) for field in item}
            else:
                found[name] = reader.values(item)
    return found


@dataclass
class _Hdf5:
    """A file of version 7.3, and what was read of it."""

    opened: Any
    file: str
    limits: FileLimits
    cells: int = 0
    size: int = 0  # Bytes

    def member(self, group: Any, name: str) -> Any:
        """Give a member of a group; a link could lead into another file."""
        import h5py

        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise ValueError(f"{name} is a link")
        return group[name]

    def values(self, dataset: Any) -> Any:
        """Read an array as `loadmat` gives it: texts whole, without axes of length one."""
        import h5py

        if not isinstance(dataset, h5py.Dataset):
            raise ValueError("a struct inside a struct is no column")
        kind = dataset.attrs.get("MATLAB_class", b"")
        if "MATLAB_object_decode" in dataset.attrs:
            name = dataset.name.rpartition("/")[2]
            raise _object(name, bytes(kind).decode() or "table", self.file)
        if dataset.is_virtual or dataset.external:
            raise ValueError("its values lie in another file")
        if dataset.size is None or dataset.attrs.get("MATLAB_empty"):
            return np.array([])
        is_link = h5py.check_ref_dtype(dataset.dtype) is h5py.Reference
        # Values of any length, which MATLAB does not write, may be one long value many times.
        if dataset.dtype.kind == "O" and not is_link:
            raise ValueError("its values are of no length that it says")
        self._hold(dataset)
        # MATLAB stores the first axis last.
        values = dataset[()].T
        if kind == b"char":
            texts = ["".join(map(chr, row)).rstrip() for row in np.atleast_2d(values)]
            return np.array(texts, dtype=object)
        if is_link:
            cells = [plain(self.values(self.opened[link])) for link in values.ravel()]
            return np.array(cells, dtype=object)
        return np.atleast_1d(np.squeeze(values))

    def _hold(self, dataset: Any) -> None:
        """Hold an array, and the chunks that it is unpacked in, to the limits."""
        self.cells += dataset.size
        self.limits.hold_table(1, self.cells, self.file)
        unpacked = max(dataset.size, math.prod(dataset.chunks or (0,)))
        self.size += unpacked * dataset.dtype.itemsize
        self.limits.hold_size(self.size, self.file)
