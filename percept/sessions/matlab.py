"""Columns of a MATLAB file, as a program: the file on standard input, JSON on standard output.

`python -P matlab.py CELLS PART` prints the columns of a part, the names of several
parts, or the number of cells of an array that has more than CELLS.
"""

from __future__ import annotations

import io
import json
import sys
from typing import Any

import numpy as np

__all__ = ["plain"]

#: Bytes of memory for a cell that is read: a MATLAB array of one value has a header of its own.
_BYTES_OF_CELL = 512
#: Bytes of memory for Python and SciPy themselves.
_BYTES_OF_PROGRAM = 4 << 30


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
    from scipy.io import loadmat, whosmat

    stream: Any = io.BytesIO(sys.stdin.buffer.read())
    for _, shape, _ in whosmat(stream):
        cells = int(np.prod(shape, dtype=np.float64))
        if cells > most_cells:
            return {"cells": cells}
    stream.seek(0)
    arrays = {}
    for name, value in loadmat(stream, squeeze_me=True).items():
        if not name.startswith("__"):
            arrays[name] = np.atleast_1d(value)
    tables = [name for name, value in arrays.items() if value.dtype.names]
    tables = tables or [name for name, value in arrays.items() if value.ndim == 2]
    if part not in arrays and (part or len(tables) > 1):
        return {"names": tables or list(arrays), "columns": {}}
    if part or tables:
        arrays = _columns(arrays[part or tables[0]])
    columns = {}
    for name, values in arrays.items():
        columns[name] = [plain(item) for item in values.ravel()]
    return {"columns": columns}


def _columns(value: Any) -> dict[str, Any]:
    """Columns of a struct, of an array of structs, or of a matrix."""
    fields = value.dtype.names
    if not fields:
        columns = value.T if value.ndim == 2 else [value]
        return {f"column {number}": column for number, column in enumerate(columns, 1)}
    if len(value) > 1:
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
