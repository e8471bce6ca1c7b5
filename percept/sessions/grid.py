"""A table of texts with one header: what stands around it is read past, other forms refused."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, islice, pairwise

from percept.errors import UsageError, did_you_mean
from percept.sessions.records import NoDataError, Notice, clip, shown
from percept.sessions.values import is_missing

#: Physical line and cells of each row.
Rows = Iterator[tuple[int, list[str]]]
#: The same of one row, its cells stripped.
_Row = tuple[int, list[str]]
#: First rows of a table among which its header stands.
MOST_ROWS = 50
#: Rows that tell whether a table is one, and what its columns hold.
_SAMPLE = 2_000
#: A header of more cells is no session table's; the bound keeps hostile lines cheap.
_MOST_CELLS = 20_000
_NUMBER = re.compile(r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?")
#: What begins a comment.
_COMMENT = ("#", "%", "//")


class LayoutError(UsageError):
    """A header that is none, or columns that nothing separates."""


class Grid:
    """A table of texts: its header, and its rows one after the other.

    Parameters
    ----------
    rows : iterator
        Line and cells of each row, with what stands above the header.
    file : str
        The file's name for messages.
    delimiter : str
        What stands between the cells in the file.
    fewest : int
        Cells that a header has at least.
    has_notes : bool
        Whether cells right of the header's last name are notes.

    Raises
    ------
    UsageError
        No header, two of them, no row below, or one of another width.
    """

    def __init__(
        self,
        rows: Rows,
        file: str,
        delimiter: str = ",",
        *,
        fewest: int = 1,
        has_notes: bool = False,
    ) -> None:
        self.file = file
        self.delimiter = delimiter
        self.notices: list[Notice] = []
        self.dropped = Counter[str]()  # Rows that are no data, by reason
        self.skipped = 0  # Rows above the header that are not blank
        self.units: dict[str, str] = {}  # By column, of the row below the header
        self.units_row = 0  # Its physical line
        first = list(islice(rows, MOST_ROWS))
        self.header_row, names, below = self._find_header(first)
        if has_notes:
            names = names[: 1 + max(at for at, name in enumerate(names) if name.strip())]
            rows = ((line, cells[: len(names)]) for line, cells in chain(below, rows))
        else:
            rows = chain(below, rows)
        if not fewest <= len(names) <= _MOST_CELLS:
            hint = "Correct the header, or declare [sessions] delimiter."
            message = f"a header of {len(names)} cells."
            raise UsageError(message, file=file, row=self.header_row, hint=hint)
        # A delimiter may end the header; a column without a name is called by its position.
        named = names if names[-1].strip() else names[:-1]
        self.header = [name.strip() or f"column {number}" for number, name in enumerate(named, 1)]
        self._rows = self._data(names, rows)
        self.sample = list(islice(self._rows, _SAMPLE))
        if not self.sample:
            message = "there are no data below the header."
            hint = "Leave the file out."
            raise NoDataError(message, file=file, row=self.header_row, hint=hint)

    def position(self, name: str) -> int:
        """Return where the one column of a name stands."""
        if self.header.count(name) == 1:
            return self.header.index(name)
        message = f"there is no column {name!r}."
        if name in self.header:
            message = f"two columns have the name {name!r}."
        raise self.error(message, name, self.columns_like(name))

    def columns_like(self, name: str) -> str:
        """List the columns, and ask whether the one is meant that is most like a name."""
        return f"The columns are {shown(self.header)}.{did_you_mean(name, self.header)}"

    def error(
        self,
        message: str,
        column: str,
        hint: str,
        kind: type[UsageError] = UsageError,
    ) -> UsageError:
        """Return an error about a column of the header."""
        return kind(message, file=self.file, row=self.header_row, column=column, hint=hint)

    def rows(self) -> Rows:
        """Give the rows of data, once."""
        return chain(self.sample, self._rows)

    def _find_header(self, first: Sequence[_Row]) -> tuple[int, list[str], Sequence[_Row]]:
        """Find the header and the units among the first rows; give its line, it and the rest."""
        stripped = [(line, [cell.strip() for cell in cells]) for line, cells in first]
        filled = [row for row in stripped if any(row[1])]
        kept = [row for row in filled if not _is_comment(row[1])]
        if not kept:
            hint = "Leave it out, or export it again."
            raise NoDataError("the file has no header.", file=self.file, hint=hint)
        start = _header_below_title([cells for _, cells in kept])
        table = kept[start:]
        self.skipped = filled.index(table[0])
        if self.skipped:
            self._name_title(filled[0], table[0], is_title=start > 0)
        _refuse_two_headers(table, self.file)
        self.units = _units([cells for _, cells in table])
        last = table[0]
        if self.units:
            last = table[1]
            self.units_row = last[0]
        at = stripped.index(table[0])
        return table[0][0], first[at][1], first[stripped.index(last) + 1 :]

    def _name_title(self, above: _Row, header: _Row, *, is_title: bool) -> None:
        """Say what stands above the header, which has no numbers below a title."""
        row, cells = above
        what = ", ".join(_filled(cells))
        line, names = header
        if is_title and any(map(_NUMBER.fullmatch, names)):
            message = f"line {row} is a title, and line {line} below it has numbers: no header."
            hint = "Write the names of the columns in a line above the data."
            raise UsageError(message, file=self.file, row=row, value=what, hint=hint)
        text = f"the header is in line {line}; what stands above it is skipped: {shown([what])}"
        self.notices.append(Notice(text, self.file, row))

    def _data(self, names: list[str], rows: Rows) -> Rows:
        """Leave out what is no data, and hold the rest to one width."""
        columns = len(self.header)
        width = 0
        for line, cells in rows:
            text = "".join(cells)
            if cells == names:
                self.dropped["repeated header"] += 1
            elif not text or text.isspace():
                self.dropped["blank line"] += 1
            elif text.strip() == "END OF FILE":
                self.dropped["end-of-file mark"] += 1
            elif text.startswith(_COMMENT) and _is_comment(cells):
                if not self.dropped["comment"]:
                    text = f"comments are skipped, here the first: {shown([cells[0]])}"
                    self.notices.append(Notice(text, self.file, line))
                self.dropped["comment"] += 1
            else:
                width = width or len(cells)
                # A writer may end every line with a delimiter, and the header or not.
                fits = columns <= width <= columns + 1 and len(cells) == width
                if not fits or (width > columns and cells[-1]):
                    raise self._ragged(names, line, cells, width)
                yield line, cells

    def _ragged(
        self,
        names: list[str],
        line: int,
        cells: list[str],
        width: int,
    ) -> UsageError:
        """Say that a row has not as many cells as the first, or fits no header."""
        message = f"{len(cells)} cells where the header has {len(names)}"
        message += f" and the lines above have {width}." if len(cells) != width else "."
        hint = "Fix this line or its quotes."
        if len(cells) == len(names) + 1:
            hint += " Decimal commas need quotes; R's write.table needs col.names = NA."
        value = clip(self.delimiter.join(cells))
        return UsageError(message, file=self.file, row=line, value=value, hint=hint)


def _is_comment(cells: Sequence[str]) -> bool:
    """Whether a row is a comment: one cell at its left that begins as comments do."""
    return cells[0].startswith(_COMMENT) and len(_filled(cells)) == 1


def _filled(cells: Sequence[str]) -> list[str]:
    return [cell for cell in cells if cell]


def _header_below_title(table: list[list[str]]) -> int:
    """Find the header below a title: the first of several names with as many cells in each row."""
    title = table[0]
    if not title[0] or (len(_filled(title)) > 1 and not title[0].startswith(_COMMENT)):
        return 0
    for start, (header, below) in enumerate(pairwise(table)):
        names = len(_filled(header))
        if names > 1 and names >= len(_filled(below)) and len({*map(len, table[start:])}) == 1:
            return start
    return 0


def _refuse_two_headers(table: Sequence[_Row], file: str) -> None:
    """Refuse a header with gaps above another one: environments above names of columns."""
    if len(table) < 3:
        return
    (row, upper), (below, lower), (_, data) = table[:3]
    gaps = 1 < len(_filled(upper)) < len(_filled(lower))
    if not gaps or any(map(_NUMBER.fullmatch, lower)) or not any(map(_NUMBER.fullmatch, data)):
        return
    names = []
    above = ""
    for index, name in enumerate(lower):
        above = (upper[index] if index < len(upper) else "") or above
        names.append(f"{name}_{above}" if above else name)
    message = f"lines {row} and {below} are both headers."
    hint = (
        f"Write one line in their place: {','.join(names)}. Then name the columns in the scene,"
        ' such as k_adj = "adj_{environment}" below [columns].'
    )
    raise LayoutError(message, file=file, row=row, value=", ".join(_filled(upper)), hint=hint)


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


def refuse_headless(grid: Grid) -> None:
    """Refuse a header that looks like a row of data, by the rows below it."""
    names = [name for name in grid.header if _NUMBER.fullmatch(name)]
    numbers = 0
    again = 0
    rows = [cells for _, cells in grid.sample]
    for name, *column in zip(grid.header, *rows, strict=False):
        if name in names:
            numbers += any(map(_NUMBER.fullmatch, column))
        else:
            again += name in column
    if numbers and (again or len(names) == len(grid.header)):
        message = f"the first row looks like data: {shown(grid.header)}."
        hint = (
            "Write the names of the columns in a line above it, such as"
            " subject,environment,trial,k_ref,k_adj."
        )
        raise LayoutError(message, file=grid.file, row=grid.header_row, hint=hint)
