"""What stands around a table or in place of its header: each kind is named, with what to remove."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from percept.errors import UsageError
from percept.sessions.records import shown
from percept.sessions.values import is_missing

#: Physical line and cells of a row.
_Row = tuple[int, list[str]]
#: First rows of a table that are looked at.
MOST_ROWS = 50
_NUMBER = re.compile(r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?")
_COMMENT = ("#", "%", "//")


class LayoutError(UsageError):
    """Text around a table, or a header that is none."""


def refuse_layout(rows: Sequence[tuple[int, Sequence[str]]], file: str) -> None:
    """Refuse text around a table, by its first rows as they stand."""
    stripped = [(line, [cell.strip() for cell in cells]) for line, cells in rows]
    filled = [(line, cells) for line, cells in stripped if any(cells)]
    for check in _CHECKS if filled else ():
        if problem := check(filled[:MOST_ROWS]):
            problem.file = file
            raise problem


def _title(rows: list[_Row]) -> LayoutError | None:
    """Find text above the header: one cell at the left, where rows below have several."""
    line, title = rows[0]
    if not title[0] or (len(_filled(title)) > 1 and not title[0].startswith(_COMMENT)):
        return None
    # Under a delimiter that is none, a row with one in a cell would look like a header.
    tables = [index for index in range(len(rows)) if _is_table(rows[index:])]
    if not tables or tables[0] == 0:
        return None
    header, _ = rows[tables[0]]
    message = f"line {line} is a title or a comment: the header seems to be in line {header}."
    hint = f"Remove the lines above line {header}."
    return LayoutError(message, row=line, value=title[0], hint=hint)


def _is_table(rows: list[_Row]) -> bool:
    """Whether rows have a header of several names, and as many cells below each."""
    widths = {len(cells) for _, cells in rows}
    return len(rows) > 1 and len(widths) == 1 and len(_filled(rows[0][1])) > 1


def _two_headers(rows: list[_Row]) -> LayoutError | None:
    """Find a header with gaps above another one: environments above names of columns."""
    if len(rows) < 3:
        return None
    (line, upper), (below, lower), (_, data) = rows[:3]
    gaps = len(_filled(upper)) < len(_filled(lower)) and len(_filled(upper)) > 1
    if not gaps or _has_number(lower) or not _has_number(data):
        return None
    names = []
    above = ""
    for index, name in enumerate(lower):
        above = (upper[index] if index < len(upper) else "") or above
        names.append(f"{name}_{above}" if above else name)
    message = f"lines {line} and {below} are both headers."
    hint = (
        f"Write one line in their place: {','.join(names)}. Then name the columns in the scene,"
        ' such as k_adj = "adj_{environment}" below [columns].'
    )
    return LayoutError(message, row=line, value=", ".join(_filled(upper)), hint=hint)


def _units(rows: list[_Row]) -> LayoutError | None:
    """Find a row of words below the header, where the rows below it hold numbers."""
    if len(rows) < 3 or _has_number(rows[1][1]) or rows[0][1] == rows[1][1]:
        return None
    (_, header), (line, second), *data = rows
    words = {}
    for name, word, *cells in zip(header, second, *(own for _, own in data), strict=False):
        known = [cell for cell in cells if not is_missing(cell)]
        if not is_missing(word) and known and all(map(_NUMBER.fullmatch, known)):
            words[name] = word
    if not words:
        return None
    name, word = next(iter(words.items()))
    message = f"line {line} is a row of units or a second header: {shown([*words.values()])}."
    rule = f'{name} = {{ name = "{name}", unit = "{word}" }}'
    hint = f"Remove it. Units stand in the scene, below [columns], such as {rule}."
    return LayoutError(message, row=line, column=name, value=word, hint=hint)


def _comment(rows: list[_Row]) -> LayoutError | None:
    """Find a comment among the data."""
    for line, cells in rows[1:]:
        if cells[0].startswith(_COMMENT) and len(_filled(cells)) == 1:
            message = f"line {line} is a comment."
            return LayoutError(message, row=line, value=cells[0], hint="Remove it.")
    return None


def _filled(cells: Sequence[str]) -> list[str]:
    return [cell for cell in cells if cell]


def _has_number(cells: Sequence[str]) -> bool:
    return any(map(_NUMBER.fullmatch, cells))


_CHECKS: tuple[Callable[[list[_Row]], LayoutError | None], ...] = (
    _title,
    _two_headers,
    _units,
    _comment,
)


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
