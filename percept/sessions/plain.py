"""Whether a text and its numbers are as plain as pandas' fast parser takes them to be."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from percept.sessions.values import LARGEST, LEAST


def is_rectangular(body: bytes, delimiter: str, width: int) -> bool:
    """Whether every line has the same number of cells."""
    characters = np.frombuffer(body, dtype=np.uint8)
    ends_line = characters == ord("\n")
    ends_cell = ends_line | (characters == ord(delimiter))
    ends = ends_line[ends_cell]
    lines = int(ends.sum())
    return lines * width == len(ends) and bool(ends[width - 1 :: width].all())


def are_plain(numbers: npt.NDArray[np.float64], *, exponents: bool) -> bool:
    """Whether numbers are in range, and no line is without any."""
    if np.isnan(numbers).all(axis=1).any():
        return False
    sizes = np.abs(numbers)
    # A blank cell is NaN: no comparison holds for it.
    if (sizes > LARGEST).any() or ((sizes > 0) & (sizes < LEAST)).any():
        return False
    # A zero may have been a number below the least double.
    return not (exponents and (numbers == 0).any())
