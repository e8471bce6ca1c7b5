"""Text to numbers: one decimal mark per file, and an error wherever a cell can be read two ways."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from percept.sessions.problems import Problems

Mark = Literal[".", ","]

MISSING = frozenset({"", "nan", "na", "null", "none", "-"})
_SPACE = " \t\xa0"
_POINT = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_COMMA = re.compile(r"[+-]?(?:[0-9]+(?:,[0-9]*)?|,[0-9]+)(?:[eE][+-]?[0-9]+)?")
# "1,286" is 1.286 with a decimal comma and 1286 with a comma between thousands; "0,435" and "12,5" are not.
_TWO_READINGS = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")
_WORDS = {".": "point", ",": "comma"}


@dataclass(frozen=True)
class DecimalMark:
    """The decimal mark of a file."""

    sign: Mark
    evidence: str = ""  # Where cells disagree: how many have this mark, and one of them


def is_missing(cell: str) -> bool:
    """Whether a value cell says there is no value."""
    return cell.strip(_SPACE).lower() in MISSING


def decimal_mark(
    columns: Sequence[tuple[str, Sequence[str]]],
    rows: Sequence[int],
    *,
    file: str,
    declared: Mark | None,
    problems: Problems,
) -> DecimalMark:
    """Find the decimal mark of a file from all the number cells that are used."""
    if declared:
        return DecimalMark(declared)
    commas = _with_mark(",", columns, rows)
    if not commas:
        return DecimalMark(".")
    points = _with_mark(".", columns, rows)
    if points:
        return _settled(",", commas) if _weight(commas) > _weight(points) else _settled(".", points)
    if all(_TWO_READINGS.fullmatch(cell) for _, _, cell in commas):
        for row, name, cell in commas:
            problems.add(
                f"{_readings(cell)}.",
                file=file,
                row=row,
                column=name,
                value=cell,
                hint='Declare [sessions] decimal = "," or decimal = "." if it separates thousands '
                "(and write them without it).",
            )
    return DecimalMark(",")


def _with_mark(
    sign: Mark, columns: Sequence[tuple[str, Sequence[str]]], rows: Sequence[int]
) -> list[tuple[int, str, str]]:
    """Row, column and text of each number that has a mark."""
    pattern = _POINT if sign == "." else _COMMA
    return [
        (row, name, cell.strip(_SPACE))
        for name, cells in columns
        for row, cell in zip(rows, cells, strict=True)
        if sign in cell and pattern.fullmatch(cell.strip(_SPACE))
    ]


def _settled(sign: Mark, cells: Sequence[tuple[int, str, str]]) -> DecimalMark:
    row, name, cell = next((c for c in cells if not _TWO_READINGS.fullmatch(c[2])), cells[0])
    count = f"{len(cells)} cells have" if len(cells) > 1 else "1 cell has"
    return DecimalMark(sign, f"{count} a decimal {_WORDS[sign]}, as row {row} in column {name!r} ({cell!r})")


def _weight(cells: Sequence[tuple[int, str, str]]) -> tuple[int, int]:
    """How much cells say for their mark: how many have one reading, and how many there are."""
    return sum(not _TWO_READINGS.fullmatch(cell) for _, _, cell in cells), len(cells)


def _readings(cell: str) -> str:
    return f"can be read as {cell.replace(',', '.')} or as {re.sub('[.,]', '', cell)}"


def parse_numbers(
    cells: Sequence[str],
    rows: Sequence[int],
    *,
    mark: DecimalMark,
    file: str,
    column: str,
    problems: Problems,
    optional: bool = True,
) -> npt.NDArray[np.float64]:
    """Convert cells to the nearest doubles."""
    out = np.full(len(cells), np.nan)
    pattern = (_POINT if mark.sign == "." else _COMMA).fullmatch
    mend = (
        "Correct the cell, or leave it empty if there was no adjustment." if optional else "Correct the cell."
    )
    for at, cell in enumerate(cells):
        text = cell.strip(_SPACE)
        if pattern(text):
            number = float(text.replace(",", ".") if mark.sign == "," else text)
            out[at] = number
            if math.isinf(number) or (number == 0 and re.search("[1-9]", re.split("[eE]", text)[0])):
                problems.add(
                    "beyond the range of double-precision numbers.",
                    file=file,
                    row=rows[at],
                    column=column,
                    value=cell,
                    hint=mend,
                )
        elif text.lower() not in MISSING:
            message, hint = _diagnosis(text, mark)
            problems.add(message, file=file, row=rows[at], column=column, value=cell, hint=hint or mend)
    return out


def _diagnosis(text: str, mark: DecimalMark) -> tuple[str, str]:
    """Say what is wrong with a cell that is no number, and what to do if that is more than to correct it."""
    other = _COMMA if mark.sign == "." else _POINT
    if other.fullmatch(text):
        sign = "," if mark.sign == "." else "."
        found = _readings(text) if _TWO_READINGS.fullmatch(text) else f"a decimal {_WORDS[sign]}"
        why = mark.evidence or f"the file is read with the decimal mark {mark.sign!r}"
        hint = f"Write it with a decimal {_WORDS[mark.sign]}, and thousands without a separator"
        return f"{found}; {why}.", hint + (
            "." if mark.evidence else ", or set [sessions] decimal to the mark the file has."
        )
    if re.fullmatch(r"[+-]?[0-9]{1,3}([,.' ][0-9]{3})+([.,][0-9]*)?", text):
        return "not a plain number: separators of thousands are not read.", "Write it without them."
    if text.startswith(("[", "{")):
        return (
            "a list or a record, not a number.",
            'Say which value counts, as [columns] k_adj = { name = "…", path = "-1" } (the last of a list).',
        )
    if text.endswith("%"):
        return "a percentage, not a number.", "Write it as a fraction, 0.95 for 95%."
    if text.lower().lstrip("+-") in ("inf", "infinity"):
        return "not a finite number.", ""
    return "not a number.", ""
