"""What stands around a table: titles, comments and units are read past; other forms are refused."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from percept.errors import UsageError
from percept.sessions.records import Notice, shown
from percept.sessions.values import is_missing

#: Physical line and cells of a row.
Row = tuple[int, list[str]]
#: First rows of a table that are looked at.
MOST_ROWS = 50
_NUMBER = re.compile(r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?")
#: What begins a comment.
COMMENT = ("#", "%", "//")


class LayoutError(UsageError):
    """A header that is none, or columns that nothing separates."""


@dataclass(frozen=True)
class Layout:
    """Where the header stands among the first rows of a file, and what the row below it says."""

    header: int = 0  # Position among the rows
    data: int = 1  # The same of the first row that may be data
    skipped: int = 0  # Rows above the header that are not blank
    notices: tuple[Notice, ...] = ()
    units: dict[str, str] = field(default_factory=dict)  # By column, of the row below the header
    units_row: int = 0  # Its physical line


def is_comment(cells: Sequence[str]) -> bool:
    """Whether a row is a comment: one cell at its left that begins as comments do."""
    return cells[0].startswith(COMMENT) and len(_filled(cells)) == 1


def layout_of(rows: Sequence[Row], file: str) -> Layout:
    """Find the header among the first rows of a file.

    Raises
    ------
    UsageError
        A title stands above no header, or there are two headers.
    """
    filled = [(at, line, [cell.strip() for cell in cells]) for at, (line, cells) in enumerate(rows)]
    filled = [row for row in filled if any(row[2])]
    kept = [row for row in filled if not is_comment(row[2])]
    if not kept:
        return Layout()
    table = [cells for _, _, cells in kept]
    start = _header_below_title(table)
    at, line, header = kept[start]
    above = filled[: filled.index(kept[start])]
    notices: tuple[Notice, ...] = ()
    if above:
        _, first, cells = above[0]
        what = ", ".join(_filled(cells))
        if start and any(map(_NUMBER.fullmatch, header)):
            message = f"line {first} is a title, and line {line} below it has numbers: no header."
            hint = "Write the names of the columns in a line above the data."
            raise UsageError(message, file=file, row=first, value=what, hint=hint)
        text = f"the header is in line {line}; what stands above it is skipped: {shown([what])}"
        notices = (Notice(text, file, first),)
    lines = [line for _, line, _ in kept[start:]]
    _refuse_two_headers(table[start:], lines, file)
    units = _units(table[start:])
    if not units:
        return Layout(at, at + 1, len(above), notices)
    data = kept[start + 1][0] + 1
    return Layout(at, data, len(above), notices, units, lines[1])


def _header_below_title(table: list[list[str]]) -> int:
    """Find the header below a title: the first of several names with as many cells in each row."""
    title = table[0]
    if not title[0] or (len(_filled(title)) > 1 and not title[0].startswith(COMMENT)):
        return 0
    for start, (header, below) in enumerate(pairwise(table)):
        names = len(_filled(header))
        if names > 1 and names >= len(_filled(below)) and len({*map(len, table[start:])}) == 1:
            return start
    return 0


def _refuse_two_headers(table: list[list[str]], lines: list[int], file: str) -> None:
    """Refuse a header with gaps above another one: environments above names of columns."""
    if len(table) < 3:
        return
    upper, lower, data = table[:3]
    gaps = 1 < len(_filled(upper)) < len(_filled(lower))
    if not gaps or any(map(_NUMBER.fullmatch, lower)) or not any(map(_NUMBER.fullmatch, data)):
        return
    names = []
    above = ""
    for index, name in enumerate(lower):
        above = (upper[index] if index < len(upper) else "") or above
        names.append(f"{name}_{above}" if above else name)
    message = f"lines {lines[0]} and {lines[1]} are both headers."
    hint = (
        f"Write one line in their place: {','.join(names)}. Then name the columns in the scene,"
        ' such as k_adj = "adj_{environment}" below [columns].'
    )
    value = ", ".join(_filled(upper))
    raise LayoutError(message, file=file, row=lines[0], value=value, hint=hint)


def _units(table: list[list[str]]) -> dict[str, str]:
    """Read the row below the header if it holds words where the rows below it hold numbers."""
    if len(table) < 3 or any(map(_NUMBER.fullmatch, table[1])) or table[0] == table[1]:
        return {}
    header, words, *data = table
    units = {}
    for name, word, *cells in zip(header, words, *data, strict=False):
        known = [cell for cell in cells if not is_missing(cell)]
        if not is_missing(word) and known and all(map(_NUMBER.fullmatch, known)):
            units[name] = word.strip("()[]")
    return units


def _filled(cells: Sequence[str]) -> list[str]:
    return [cell for cell in cells if cell]


def refuse_aligned(text: str, file: str, row: int) -> None:
    """Refuse columns that runs of spaces align."""
    lines = [line for line in text.splitlines()[:MOST_ROWS] if line.strip()]
    widths = {len(line.split()) for line in lines}
    if len(widths) == 1 and widths != {1} and any("  " in line.strip() for line in lines):
        message = "runs of spaces align the columns, which percept does not read."
        hint = (
            "Save the table as CSV: writetable(T, 'trials.csv') in MATLAB, write.csv in R; or"
            " replace each run of spaces by one comma."
        )
        raise LayoutError(message, file=file, row=row, hint=hint)


def refuse_headless(header: Sequence[str], rows: Sequence[Sequence[str]], file: str) -> None:
    """Refuse a header that looks like a row of data, by the rows below it."""
    names = [name for name in header if _NUMBER.fullmatch(name)]
    numbers = 0
    again = 0
    for name, *column in zip(header, *rows, strict=False):
        if name in names:
            numbers += any(map(_NUMBER.fullmatch, column))
        else:
            again += name in column
    if numbers and (again or len(names) == len(header)):
        message = f"the first row looks like data: {shown(list(header))}."
        hint = (
            "Write the names of the columns in a line above it, such as"
            " subject,environment,trial,k_ref,k_adj."
        )
        raise LayoutError(message, file=file, row=1, hint=hint)
