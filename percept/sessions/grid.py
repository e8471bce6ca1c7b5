"""Texts to a table with one header: its dialect is found, and other forms are refused.

A dialect is a delimiter and a way of quoting: the one that gives every line the same number of
cells. Those that a text may have are tried on its first records. One fits if the first line that is
not blank has several cells, and all records below have as many as the first of them; it may have
one more cell than the header where that is empty. What stands around the table is read past.
Nothing is guessed: if no dialect or several fit, that is an error.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, islice, pairwise
from typing import Literal

from percept.errors import UsageError, did_you_mean
from percept.sessions.records import NoDataError, Notice, clip, shown
from percept.sessions.values import is_missing

#: Physical line and cells of each row.
Rows = Iterator[tuple[int, list[str]]]
#: The same of one row, its cells stripped.
_Row = tuple[int, list[str]]
Quoting = Literal["doubled", "backslash", "wrapped"]

#: First rows of a table among which its header stands.
_MOST_ROWS = 50
#: Rows that tell whether a table is one, and what its columns hold.
_SAMPLE = 2_000
#: A header of more cells is no session table's; the bound keeps hostile lines cheap.
_MOST_CELLS = 20_000
NUMBER = re.compile(r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?")
#: What begins a comment.
_COMMENT = ("#", "%", "//")
_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "space"}
_SEP_LINE = re.compile(r'"?sep=(.)"?[ ]*(?:\r\n|\n|\r)', re.IGNORECASE)
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_BYTE_ORDER_MARK = "\ufeff"
#: Characters at the beginning of a text that tell its dialect, and of a cell with a mouse track.
_BEGINNING = 1 << 19
_LONGEST_CELL = 1 << 24
_QUOTES_HINT = "Write the table again as CSV with quotes doubled."
_RAGGED_HINT = (
    "Fix this line or its quotes. Decimal commas need quotes; R's write.table needs col.names = NA."
)
# csv's own limit of 128 kB is below what mouse tracks take.
csv.field_size_limit(max(csv.field_size_limit(), _LONGEST_CELL))


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
    ) -> None:
        self.file = file
        self.delimiter = delimiter
        self.notices: list[Notice] = []
        self.dropped = Counter[str]()  # Rows that are no data, by reason
        self.skipped = 0  # Rows above the header that are not blank
        self.units: dict[str, str] = {}  # By column, of the row below the header
        self.units_row = 0  # Its physical line
        first = list(islice(rows, _MOST_ROWS))
        self.header_row, names, below = self._find_header(first)
        if not fewest <= len(names) <= _MOST_CELLS:
            hint = "Correct the header, or declare [sessions] delimiter."
            message = f"a header of {len(names)} cells."
            raise UsageError(message, file=file, row=self.header_row, hint=hint)
        # A delimiter may end the header; a column without a name is called by its position.
        named = names if names[-1].strip() else names[:-1]
        self.header = [name.strip() or f"column {number}" for number, name in enumerate(named, 1)]
        self._rows = self._data(names, chain(below, rows))
        self.sample = list(islice(self._rows, _SAMPLE))
        if not self.sample:
            message = "there are no data below the header."
            hint = "Leave the file out."
            raise NoDataError(message, file=file, row=self.header_row, hint=hint)

    def notice(self, text: str, row: int | None = None) -> None:
        """Say something about the file, or one of its rows."""
        self.notices.append(Notice(text, self.file, row))

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
            (row, above), (line, names) = filled[0], table[0]
            what = ", ".join(_filled(above))
            if start and any(map(NUMBER.fullmatch, names)):
                message = f"line {row} is a title, and line {line} below it has numbers: no header."
                hint = "Write the names of the columns in a line above the data."
                raise UsageError(message, file=self.file, row=row, value=what, hint=hint)
            text = f"the header is in line {line}; what stands above it is skipped: {shown([what])}"
            self.notice(text, row)
        _refuse_two_headers(table, self.file)
        self.units = _units([cells for _, cells in table])
        last = table[0]
        if self.units:
            last = table[1]
            self.units_row = last[0]
        at = stripped.index(table[0])
        return table[0][0], first[at][1], first[stripped.index(last) + 1 :]

    def _data(self, names: list[str], rows: Rows) -> Rows:
        """Leave out what is no data, and hold the rest to one width."""
        columns = len(self.header)
        width = 0
        for line, cells in rows:
            text = "".join(cells).strip()
            if cells == names:
                self.dropped["repeated header"] += 1
            elif not text:
                self.dropped["blank line"] += 1
            elif text == "END OF FILE":
                self.dropped["end-of-file mark"] += 1
            elif text.startswith(_COMMENT) and _is_comment(cells):
                if not self.dropped["comment"]:
                    text = f"comments are skipped, here the first: {shown([cells[0]])}"
                    self.notice(text, line)
                self.dropped["comment"] += 1
            else:
                width = width or len(cells)
                # A writer may end every line with a delimiter, and the header or not.
                fits = columns <= width <= columns + 1 and len(cells) == width
                if not fits or (width > columns and cells[-1]):
                    message = f"{len(cells)} cells where the header has {len(names)}"
                    message += f" and the lines above have {width}." if len(cells) != width else "."
                    value = clip(self.delimiter.join(cells))
                    raise UsageError(
                        message, file=self.file, row=line, value=value, hint=_RAGGED_HINT
                    )
                yield line, cells


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
    if not gaps or any(map(NUMBER.fullmatch, lower)) or not any(map(NUMBER.fullmatch, data)):
        return
    names = []
    above = ""
    for outer, name in zip(upper, lower, strict=False):
        above = outer or above
        names.append(f"{name}_{above}" if above else name)
    if not lower[-1]:
        names.pop()
    message = f"lines {row} and {below} are both headers."
    hint = (
        f"Write one line in their place: {','.join(names)}. Then name the columns in the scene,"
        ' such as k_adj = "adj_{environment}" below [columns].'
    )
    raise UsageError(message, file=file, row=row, value=", ".join(_filled(upper)), hint=hint)


def _units(table: list[list[str]]) -> dict[str, str]:
    """Read the row below the header if it holds words where the rows below it hold numbers."""
    if len(table) < 3 or any(map(NUMBER.fullmatch, table[1])) or table[0] == table[1]:
        return {}
    header, words, *data = table
    units = {}
    for name, word, *cells in zip(header, words, *data, strict=False):
        known = [cell for cell in cells if not is_missing(cell)]
        if not is_missing(word) and known and all(map(NUMBER.fullmatch, known)):
            units[name] = word.strip("()[]")
    return units


def refuse_headless(grid: Grid) -> None:
    """Refuse a header that looks like a row of data, by the rows below it."""
    numbers = [name for name in grid.header if NUMBER.fullmatch(name)]
    columns = zip(grid.header, *(cells for _, cells in grid.sample), strict=False)
    again = any(name in column for name, *column in columns if name not in numbers)
    if numbers and (again or len(numbers) == len(grid.header)):
        message = f"the first row looks like data: {shown(grid.header)}."
        hint = (
            "Write the names of the columns in a line above it, such as"
            " subject,environment,trial,k_ref,k_adj."
        )
        raise UsageError(message, file=grid.file, row=grid.header_row, hint=hint)


def text_grid(text: str, file: str, delimiter: str | None) -> Grid:
    """Find the dialect of a text, and split it.

    Parameters
    ----------
    text : str
        The whole file, decoded.
    file : str
        Its name for messages.
    delimiter : str or None
        The one declared; None finds it.

    Returns
    -------
    Grid

    Raises
    ------
    UsageError
        No dialect fits, or several fit equally well.
    """
    text = text.replace("\r\r\n", "\r\n")  # So some programs end a line
    if sep := _SEP_LINE.match(text):
        delimiter = delimiter or sep[1]
        # A blank line in its place: lines keep their numbers.
        text = "\n" + text[sep.end() :]
    text = text.lstrip(_BYTE_ORDER_MARK)
    if _BYTE_ORDER_MARK in text:
        # An appending writer puts one before each repeated header.
        head = re.escape(re.split("[\r\n]", text, maxsplit=1)[0])
        text = re.sub(f"(^|[\r\n]){_BYTE_ORDER_MARK}(?={head})", r"\1", text)
    beginning = text[:_BEGINNING]
    header = next((line for line in beginning.splitlines() if line.strip()), "")
    fits: list[Grid] = []
    misfits: list[tuple[int, int, UsageError]] = []
    for sign in [delimiter] if delimiter else _delimiters(header, beginning):
        for quoting in _quotings(header, beginning):
            try:
                records = _records(text, sign, quoting, file)
                fits.append(Grid(records, file, sign, fewest=2))
                break
            except UsageError as misfit:
                # The delimiter meant splits the text most, and the quoting meant gets farthest.
                misfits.append((beginning.count(sign), misfit.row or 0, misfit))
    # Under a delimiter that is none, a row with one in a cell would look like a header.
    least = min((grid.skipped for grid in fits), default=0)
    fits = [grid for grid in fits if grid.skipped == least]
    if len(fits) == 1:
        return fits[0]
    if fits:
        names = " and ".join(_DELIMITERS[grid.delimiter] for grid in fits)
        hint = 'Declare [sessions] delimiter = ";" (or the one that is right).'
        raise UsageError(f"{names} can each split the lines.", file=file, hint=hint)
    if misfits:
        raise max(misfits, key=lambda misfit: misfit[:2])[2]
    message = "this is not a table: no comma, semicolon, tab, bar or space separates its columns."
    hint = "Export it as CSV, or declare [sessions] delimiter."
    raise UsageError(message, file=file, row=1, hint=hint)


def _delimiters(header: str, text: str) -> list[str]:
    """List delimiters to try: spaces only where the header has no other, for names have spaces."""
    *others, space = _DELIMITERS
    spaces = space in header and not any(sign in header for sign in others)
    return [space] * spaces + [sign for sign in others if sign in text]


def _quotings(header: str, text: str) -> tuple[Quoting, ...]:
    """List conventions to try, in order; PsychoPy's own only on a file of PsychoPy."""
    if '"' not in text:
        return ("doubled",)
    if "psychopyVersion" in header or "expName" in header:
        return ("wrapped", "doubled")
    return ("doubled", "backslash")


def _records(text: str, delimiter: str, quoting: Quoting, file: str) -> Rows:
    """Split a text into records."""
    if quoting == "backslash":
        # A NUL is refused before, so that it can stand for an escaped quote.
        text = text.replace('\\"', "\0")
    lines = (found[0] for found in _LINE.finditer(text))
    if delimiter == " ":
        # Runs of spaces align the columns.
        lines = (re.sub(" +", " ", line.strip(" \r\n")) + "\n" for line in lines)
    if quoting == "wrapped":
        for row, line in enumerate(lines, 1):
            yield row, _join(line.rstrip("\r\n").split(delimiter), delimiter)
        return
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    row = 1
    try:
        for cells in reader:
            if quoting == "backslash":
                cells = [cell.replace("\0", '"') for cell in cells]
            yield row, cells or [""]
            row = 1 + reader.line_num
    except csv.Error as error:
        message = "a quoted cell is not closed, or text follows its closing quote."
        if "limit" in str(error):
            message = f"a cell of more than {_LONGEST_CELL:,} characters."
        raise UsageError(message, file=file, row=row, hint=_QUOTES_HINT) from None


def _join(pieces: list[str], delimiter: str) -> list[str]:
    """Join the pieces of a line where PsychoPy's quotes wrap a cell with the delimiter."""
    last = max((at for at, piece in enumerate(pieces) if piece.endswith('"')), default=0)
    cells: list[str] = []
    parts: list[str] = []  # Of a cell whose quotes are open
    for at, piece in enumerate(pieces):
        ends = piece.endswith('"')
        # A cell quoted at both ends without a delimiter inside was not quoted by the writer: it
        # stays.
        opens = piece.startswith('"') and not (ends and len(piece) > 1) and at < last
        if not (parts or opens):
            cells.append(piece)
            continue
        parts.append(piece)
        if ends and len(parts) > 1:
            cells.append(delimiter.join(parts)[1:-1])
            parts = []
    return cells
