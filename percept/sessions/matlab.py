"""Columns of a MATLAB file, as a program: the file on standard input, JSON on standard output.

`python -P matlab.py CELLS PART` prints the columns of a part, the names of several
parts, or the number of cells of an array that has more than CELLS.
"""

from __future__ import annotations

import io
import json
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["plain"]

#: Bytes of memory for a cell that is read: a MATLAB array of one value has a header of its own.
_BYTES_OF_CELL = 512
#: Bytes of memory for Python and SciPy themselves.
_BYTES_OF_PROGRAM = 4 << 30
#: Arrays by name; columns of a struct of version 7.3, by name.
_Variables = dict[str, Any]
_OBJECT = (
    "a table or string of MATLAB is an object that only MATLAB reads; in MATLAB:"
    " S = table2struct(T, 'ToScalar', true); save(name, '-struct', 'S');"
    " first turn strings into texts: T.name = cellstr(T.name)"
)


class _TooManyCellsError(Exception):
    """A file has more cells than it may; the argument is how many at least."""

    @property
    def cells(self) -> int:
        return int(self.args[0])


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


def _found(most_cells: int, part: str) -> dict[str, Any]:
    """Read standard input."""
    data = sys.stdin.buffer.read()
    try:
        if data.startswith(b"MATLAB 7.3"):
            variables = _of_hdf5(data, most_cells)
        else:
            variables = _of_earlier(data, most_cells)
    except _TooManyCellsError as error:
        return {"cells": error.cells}
    tables = [name for name, value in variables.items() if not _is_vector(value)]
    if not part and _vectors_are_longer(variables, tables):
        variables = {name: variables[name] for name in variables if name not in tables}
        tables = []
    if part not in variables and (part or len(tables) > 1):
        return {"names": tables or list(variables), "columns": {}}
    if part or tables:
        variables = _columns(variables[part or tables[0]])
    columns = {}
    for name, values in variables.items():
        columns[name] = [plain(item) for item in values.ravel()]
    return {"columns": columns}


def _of_earlier(data: bytes, most_cells: int) -> _Variables:
    """Read the variables of a file up to version 7."""
    from scipy.io import loadmat, matlab, whosmat

    stream: Any = io.BytesIO(data)
    for _, shape, _ in whosmat(stream):
        cells = int(np.prod(shape, dtype=np.float64))
        if cells > most_cells:
            raise _TooManyCellsError(cells)
    stream.seek(0)
    variables: _Variables = {}
    for name, value in loadmat(stream, squeeze_me=True).items():
        if isinstance(value, matlab.MatlabOpaque):
            raise ValueError(_OBJECT)
        if not name.startswith("__"):
            variables[name] = np.atleast_1d(value)
    return variables


def _of_hdf5(data: bytes, most_cells: int) -> _Variables:
    """Read the variables of a file of version 7.3; a struct becomes its columns by name."""
    import h5py

    variables: _Variables = {}
    with h5py.File(io.BytesIO(data), "r") as file:
        reader = _Hdf5(file, most_cells)
        for name in file:
            # What cells refer to.
            if name.startswith("#"):
                continue
            item = reader.member(file, name)
            if isinstance(item, h5py.Group):
                variables[name] = {
                    field: reader.values(reader.member(item, field)) for field in item
                }
            else:
                variables[name] = reader.values(item)
    return variables


@dataclass
class _Hdf5:
    """A file of version 7.3, the most cells that may be read of it, and those read so far."""

    file: Any
    most_cells: int
    cells: int = 0

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
        if "MATLAB_object_decode" in dataset.attrs:
            raise ValueError(_OBJECT)
        if dataset.is_virtual or dataset.external:
            raise ValueError("its values lie in another file")
        if dataset.size is None or dataset.attrs.get("MATLAB_empty"):
            return np.array([])
        self.cells += dataset.size
        if self.cells > self.most_cells:
            raise _TooManyCellsError(self.cells)
        # MATLAB stores the first axis last.
        values = dataset[()].T
        if dataset.attrs.get("MATLAB_class") == b"char":
            texts = ["".join(map(chr, row)).rstrip() for row in np.atleast_2d(values)]
            return np.array(texts, dtype=object)
        if h5py.check_ref_dtype(dataset.dtype) is h5py.Reference:
            cells = [plain(self.values(self.file[link])) for link in values.ravel()]
            return np.array(cells, dtype=object)
        return np.atleast_1d(np.squeeze(values))


def _is_vector(value: Any) -> bool:
    """Whether a variable is one column; a struct or a matrix is a table."""
    return not isinstance(value, dict) and not value.dtype.names and value.ndim != 2


def _vectors_are_longer(variables: _Variables, tables: list[str]) -> bool:
    """Whether two vectors of one length have more rows than every table beside them."""
    lengths = [value.size for name, value in variables.items() if name not in tables]
    repeated = [length for length in lengths if lengths.count(length) > 1]
    rows = [_row_count(variables[name]) for name in tables]
    return bool(repeated and rows) and max(repeated) > max(rows)


def _row_count(table: Any) -> int:
    """Rows of a table: the length of its longest column."""
    return max((column.size for column in _columns(table).values()), default=0)


def _columns(value: Any) -> _Variables:
    """Columns of a struct, of an array of structs, or of a matrix."""
    if isinstance(value, dict):
        return value
    fields = value.dtype.names
    if not fields:
        columns = value.T if value.ndim == 2 else [value]
        return {f"column {number}": column for number, column in enumerate(columns, 1)}
    # An array of structs has a row each, and one of none has no rows.
    if len(value) != 1:
        return {name: value[name] for name in fields}
    return {name: np.atleast_1d(value[name][0]) for name in fields}


def _hold_memory(most_cells: int) -> None:
    """Bound the memory of this process, where the system can."""
    try:
        import resource
    except ImportError:  # Windows
        return
    most = _BYTES_OF_PROGRAM + _BYTES_OF_CELL * most_cells
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))


if __name__ == "__main__":
    _hold_memory(int(sys.argv[1]))
    json.dump(_found(int(sys.argv[1]), sys.argv[2]), sys.stdout, default=str)
