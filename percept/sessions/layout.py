"""What stands around a table or in place of its header: each kind is named, with what to remove.

Each check looks at the first rows of a file as they stand, and gives what is wrong with them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from percept.errors import UsageError
from percept.sessions.records import Place, shown
from percept.sessions.values import is_missing

#: Rows that are looked at.
_MOST_ROWS = 50
_NUMBER = re.compile(r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?")
_COMMENT = ("#", "%", "//")


class LayoutError(UsageError):
    """Text around a table, or a header that is none."""


@dataclass(frozen=True)
class FirstRows:
    """The first rows of a file, each with its physical line; blank rows are left out."""

    file: str
    lines: list[int]
    cells: list[list[str]]

    @classmethod
    def of(cls, file: str, rows: Sequence[Sequence[str]], lines: Sequence[int]) -> FirstRows:
        """Take the first rows that have a cell."""
        filled = ((line, row) for line, row in zip(lines, rows, strict=True) if any(_filled(row)))
        kept = [(line, [cell.strip() for cell in row]) for line, row in islice(filled, _MOST_ROWS)]
        return cls(file, [line for line, _ in kept], [row for _, row in kept])

    def place(self, index: int) -> Place:
        """Where a row stands."""
        return Place(file=self.file, row=self.lines[index])


def _filled(row: Sequence[str]) -> list[str]:
    return [cell for cell in row if cell.strip()]


def _title(rows: FirstRows) -> Iterator[LayoutError]:
    """Find text above the header: one cell at the left, where rows below have several."""
    title = rows.cells[0]
    if not title[0] or (len(_filled(title)) > 1 and not title[0].startswith(_COMMENT)):
        return
    # Under a delimiter that is none, a row with one in a cell would look like a header.
    table = [i for i, row in enumerate(rows.cells) if _is_table([row, *rows.cells[i + 1 :]])]
    header = next(iter(table), 0)
    if header == 0:
        return
    line = rows.lines[header]
    message = (
        f"line {rows.lines[0]} is a title or a comment: the header seems to be in line {line}."
    )
    hint = f"Remove the lines above line {line}."
    yield LayoutError(message, value=rows.cells[0][0], hint=hint, **rows.place(0))


def _is_table(rows: Sequence[Sequence[str]]) -> bool:
    """Whether rows have a header of several names, and as many cells below each."""
    widths = {len(row) for row in rows}
    return len(rows) > 1 and len(widths) == 1 and len(_filled(rows[0])) > 1


def _two_headers(rows: FirstRows) -> Iterator[LayoutError]:
    """Find a header with gaps above another one: environments above names of columns."""
    if len(rows.cells) < 3:
        return
    upper, lower, data = rows.cells[:3]
    gaps = len(_filled(upper)) < len(_filled(lower)) and len(_filled(upper)) > 1
    if not gaps or _numbers(lower) or not _numbers(data):
        return
    names = []
    above = ""
    for index, name in enumerate(lower):
        above = (upper[index] if index < len(upper) else "") or above
        names.append(f"{name}_{above}" if above else name)
    message = f"lines {rows.lines[0]} and {rows.lines[1]} are both headers."
    hint = (
        f"Write one line in their place: {','.join(names)}. Then name the columns in the scene,"
        ' such as k_adj = "adj_{environment}" below [columns].'
    )
    yield LayoutError(message, value=", ".join(_filled(upper)), hint=hint, **rows.place(0))


def _units(rows: FirstRows) -> Iterator[LayoutError]:
    """Find a row of words below the header, where the rows below it hold numbers."""
    if len(rows.cells) < 3 or _numbers(rows.cells[1]):
        return
    header, second, *data = rows.cells
    words = {}
    for name, word, *cells in zip(header, second, *data, strict=False):
        known = [cell for cell in cells if not is_missing(cell)]
        if not is_missing(word) and known and all(map(_NUMBER.fullmatch, known)):
            words[name] = word
    if not words or second == header:
        return
    name, word = next(iter(words.items()))
    message = (
        f"line {rows.lines[1]} is a row of units or a second header: {shown([*words.values()])}."
    )
    rule = f'{name} = {{ name = "{name}", unit = "{word}" }}'
    hint = f"Remove it. Units stand in the scene, below [columns], such as {rule}."
    yield LayoutError(message, column=name, value=word, hint=hint, **rows.place(1))


def _comments(rows: FirstRows) -> Iterator[LayoutError]:
    """Find a comment among the data."""
    for index, row in enumerate(rows.cells):
        if index and row[0].startswith(_COMMENT) and len(_filled(row)) == 1:
            message = f"line {rows.lines[index]} is a comment."
            yield LayoutError(message, value=row[0], hint="Remove it.", **rows.place(index))


def _numbers(row: Sequence[str]) -> list[str]:
    return [cell for cell in row if _NUMBER.fullmatch(cell)]


#: From the first rows of a file to what is wrong with them.
_CHECKS: tuple[Callable[[FirstRows], Iterator[LayoutError]], ...] = (
    _title,
    _two_headers,
    _units,
    _comments,
)


def refuse_layout(rows: FirstRows) -> None:
    """Refuse text around a table, by the first check that finds some."""
    for check in _CHECKS if rows.cells else ():
        for problem in check(rows):
            raise problem


def refuse_aligned(text: str, file: str, row: int) -> None:
    """Refuse columns that runs of spaces align."""
    lines = [line for line in text.splitlines()[:_MOST_ROWS] if line.strip()]
    widths = {len(line.split()) for line in lines}
    if len(widths) == 1 and widths != {1} and any("  " in line.strip() for line in lines):
        message = "runs of spaces align the columns, which percept does not read."
        hint = (
            "Save the table as CSV: writetable(T, 'trials.csv') in MATLAB, write.csv in R; or"
            " replace each run of spaces by one comma."
        )
        raise LayoutError(message, file=file, row=row, hint=hint)


def refuse_headless(header: Sequence[str], cells: Sequence[Sequence[str]], file: str) -> None:
    """Refuse a header that looks like a row of data.

    Parameters
    ----------
    header : sequence of str
        Names of the columns.
    cells : sequence of sequences of str
        By column.
    file : str
        The file's name for messages.
    """
    names = [name for name in header if _NUMBER.fullmatch(name)]
    numbers = 0
    again = 0
    for name, column in zip(header, cells, strict=True):
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
