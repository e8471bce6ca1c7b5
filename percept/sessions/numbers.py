"""Text to numbers: one decimal mark per file, and an error wherever a cell can be read two ways."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from percept.sessions.problems import Problems

__all__ = ["MISSING", "Mark", "decimal_mark", "is_missing", "parse_numbers"]

Mark = Literal[".", ","]

MISSING = frozenset({"", "nan", "na", "null", "none", "-"})
_SPACE = " \t\xa0"
_POINT = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_COMMA = re.compile(r"[+-]?(?:[0-9]+(?:,[0-9]*)?|,[0-9]+)(?:[eE][+-]?[0-9]+)?")
# "1,286" is 1.286 with a decimal comma and 1286 with a comma between thousands; "0,435" and "12,5" are not.
_TWO_READINGS = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
_ASK = 'Declare [sessions] decimal = "," or decimal = "."'


def is_missing(cell: str) -> bool:
    """Whether a value cell says there is no value."""
    return cell.strip(_SPACE).lower() in MISSING


def decimal_mark(
    columns: Iterable[tuple[str, Sequence[str]]],
    rows: Sequence[int],
    *,
    file: str,
    declared: Mark | None,
    problems: Problems,
) -> Mark:
    """Find the decimal mark of a file from all the number cells that are used.

    Parameters
    ----------
    columns : iterable of (str, sequence of str)
        Names and cells of the number columns.
    rows : sequence of int
        Physical row of each cell.
    file : str
        For messages.
    declared : {".", ","} or None
        The mark the scene declares; it is taken as it is.
    problems : Problems
        Receives the cells that can be read two ways, and files that mix both marks.

    Returns
    -------
    {".", ","}
    """
    if declared:
        return declared
    commas = [
        (row, name, cell.strip(_SPACE))
        for name, cells in columns
        for row, cell in zip(rows, cells, strict=True)
        if "," in cell and _COMMA.fullmatch(cell.strip(_SPACE))
    ]
    if not commas:
        return "."
    for name, cells in columns:
        for row, cell in zip(rows, cells, strict=True):
            if "." in cell and _POINT.fullmatch(cell.strip(_SPACE)):
                other = commas[0]
                problems.add(
                    f"a decimal point, where row {other[0]} has a comma ({other[2]!r}).",
                    file=file,
                    row=row,
                    column=name,
                    value=cell,
                    hint="A file has one decimal mark; write its numbers in one way.",
                )
                return ","
    if all(_TWO_READINGS.fullmatch(cell) for _, _, cell in commas):
        for row, name, cell in commas:
            digits = cell.replace(",", "")
            problems.add(
                f"can be read as {cell.replace(',', '.')} or as {digits}.",
                file=file,
                row=row,
                column=name,
                value=cell,
                hint=f"{_ASK} if it separates thousands (and write them without it).",
            )
    return ","


def parse_numbers(
    cells: Sequence[str],
    rows: Sequence[int],
    *,
    mark: Mark,
    file: str,
    column: str,
    problems: Problems,
) -> npt.NDArray[np.float64]:
    """Convert cells to the nearest doubles.

    Parameters
    ----------
    cells : sequence of str, shape (n,)
        Decimal numbers, with or without an exponent; a cell that says "missing" gives NaN.
    rows : sequence of int, shape (n,)
        Physical rows, for messages.
    mark : {".", ","}
        Decimal mark.
    file, column : str
        For messages.
    problems : Problems
        Receives every cell that is neither a number nor missing, or that a double cannot hold.

    Returns
    -------
    ndarray, shape (n,)
        NaN where missing (and where a problem was found).
    """
    out = np.full(len(cells), np.nan)
    pattern = (_POINT if mark == "." else _COMMA).fullmatch
    for at, cell in enumerate(cells):
        text = cell.strip(_SPACE)
        if pattern(text):
            number = float(text.replace(",", ".") if mark == "," else text)
            out[at] = number
            if math.isinf(number) or (number == 0 and re.search("[1-9]", re.split("[eE]", text)[0])):
                problems.add(
                    "beyond the range of double-precision numbers.",
                    file=file,
                    row=rows[at],
                    column=column,
                    value=cell,
                    hint="Correct the cell, or leave it empty.",
                )
        elif text.lower() not in MISSING:
            message, hint = _diagnosis(text, mark)
            problems.add(message, file=file, row=rows[at], column=column, value=cell, hint=hint)
    return out


def _diagnosis(text: str, mark: Mark) -> tuple[str, str]:
    """Say what is wrong with a cell that is no number, and what to do."""
    other = _COMMA if mark == "." else _POINT
    if re.fullmatch(r"[+-]?[0-9]{1,3}([,.' ][0-9]{3})+([.,][0-9]*)?", text):
        return "not a plain number: separators of thousands are not read.", "Write it without them."
    if other.fullmatch(text):
        return f"not a number with the decimal mark {mark!r}.", f"{_ASK} as the file has it."
    if text.startswith(("[", "{")):
        return (
            "a list or a record, not a number.",
            'Say which value counts, as [columns] k_adj = { name = "…", path = "-1" } (the last of a list).',
        )
    if text.lower().lstrip("+-") in ("inf", "infinity"):
        return "not a finite number.", "Leave the cell empty if there was no adjustment."
    return "not a number.", "Correct the cell, or leave it empty if there was no adjustment."
