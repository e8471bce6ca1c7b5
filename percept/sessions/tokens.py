"""Text to records of cells, by one delimiter and one quoting convention, remembering physical lines."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

Quoting = Literal["plain", "doubled", "backslash", "wrapped"]

# A line of more cells than this is no session table; the bound keeps hostile lines cheap.
CELLS = 20_000

_LINE = re.compile(r"\r\n|\n|\r")
_LONE = re.compile(r"\r(?!\n)")
_MIXED = "a carriage return stands alone in a file whose lines end otherwise"


@dataclass(frozen=True)
class Records:
    """Records of a file."""

    cells: list[list[str]]  # The cells of each record
    rows: list[int]  # Physical line on which each record starts


class SplitError(ValueError):
    """The text does not follow the convention; `row` is the physical line where it breaks."""

    def __init__(self, message: str, row: int) -> None:
        super().__init__(message)
        self.message = message
        self.row = row


def tokenise(text: str, *, delimiter: str, quoting: Quoting, first_row: int = 1) -> Records:
    r"""Split text into records."""
    if quoting == "plain":
        return _plain(text, delimiter, first_row)
    if quoting == "wrapped":
        return _wrapped(text, delimiter, first_row)
    return _quoted(text, delimiter, quoting, first_row)


def _plain(text: str, delimiter: str, first_row: int) -> Records:
    lines = _LINE.split(text) if "\r" in text else text.split("\n")
    if "\r" in text and "\n" in text and text.count("\r") != text.count("\r\n"):
        raise SplitError(_MIXED, first_row + len(_LINE.findall(text[: _LONE.search(text).start()])))  # type: ignore[union-attr]
    if lines and not lines[-1]:
        lines.pop()
    for at, line in enumerate(lines):
        if line.count(delimiter) >= CELLS:
            raise SplitError(f"more than {CELLS} cells in a line", first_row + at)
    return Records([line.split(delimiter) for line in lines], list(range(first_row, first_row + len(lines))))


def _wrapped(text: str, delimiter: str, first_row: int) -> Records:
    plain = _plain(text, delimiter, first_row)
    return Records(
        [_join(pieces, delimiter) if '"' in "".join(pieces) else pieces for pieces in plain.cells], plain.rows
    )


def _join(pieces: list[str], delimiter: str) -> list[str]:
    """Put a line's pieces together again where quotes wrap a cell that holds the delimiter."""
    closing = [len(pieces)] * (len(pieces) + 1)
    for at in range(len(pieces) - 1, -1, -1):
        closing[at] = at if pieces[at].endswith('"') else closing[at + 1]
    cells: list[str] = []
    at = 0
    while at < len(pieces):
        # A cell quoted at both ends without a delimiter inside was not quoted by the writer: it stays.
        whole = len(pieces[at]) > 1 and pieces[at].endswith('"')
        last = closing[at + 1] if pieces[at].startswith('"') and not whole else len(pieces)
        if last == len(pieces):
            cells.append(pieces[at])
            at += 1
        else:
            cells.append(delimiter.join(pieces[at : last + 1])[1:-1])
            at = last + 1
    return cells


def _quoted(text: str, delimiter: str, quoting: Quoting, first_row: int) -> Records:
    match = _cell_pattern(delimiter, quoting).match
    escaped = '""' if quoting == "doubled" else '\\"'
    cells: list[list[str]] = []
    rows: list[int] = []
    record: list[str] = []
    ends: set[str] = set()
    position, end, row, start = 0, len(text), first_row, first_row
    while position < end or record:
        found = match(text, position)
        if found is None:
            raise SplitError("a quoted cell is not closed, or text follows its closing quote", row)
        inside, bare, stop = found.groups()
        if inside is None:
            record.append(bare)
        else:
            record.append(inside.replace(escaped, '"'))
            row += len(_LINE.findall(inside)) if "\n" in inside or "\r" in inside else 0
        if len(record) > CELLS:
            raise SplitError(f"more than {CELLS} cells in a line", start)
        position = found.end()
        if stop != delimiter:
            ends.add(stop)
            if "\r" in ends and len(ends - {""}) > 1:
                raise SplitError(_MIXED, row)
            cells.append(record)
            rows.append(start)
            record = []
            row += 1
            start = row
    return Records(cells, rows)


@lru_cache
def _cell_pattern(delimiter: str, quoting: Quoting) -> re.Pattern[str]:
    """Match one cell and what ends it. Possessive repeats: no backtracking, so time stays linear."""
    d = re.escape(delimiter)
    quoted = r'(?:[^"]++|"")*+' if quoting == "doubled" else r'(?:[^"\\]++|\\"|\\(?!"))*+'
    return re.compile(rf'(?:"({quoted})"|([^"{d}\r\n]*+))({d}|\r\n|\n|\r|\Z)')
