"""Texts to rows of cells, under the one dialect that gives every line the same number of cells.

A dialect is a delimiter and a way of quoting. Those that a text may have are tried on its first
records. One fits if the first line that is not blank has several cells, and all records below have
as many as the first of them; it may have one more cell than the header where that is empty.
Nothing is guessed: if none or several fit, that is an error.
"""

from __future__ import annotations

import csv
import re
from bisect import bisect
from collections import Counter
from collections.abc import Iterator
from itertools import chain, islice
from typing import Literal

from percept.errors import UsageError, did_you_mean
from percept.sessions.layout import (
    COMMENT,
    MOST_ROWS,
    Layout,
    LayoutError,
    is_comment,
    layout_of,
    refuse_aligned,
)
from percept.sessions.records import NoDataError, Notice, clip, shown

#: Physical line (the header's is 1) and cells.
Rows = Iterator[tuple[int, list[str]]]
Quoting = Literal["doubled", "backslash", "wrapped"]

_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "space"}
_SEP_LINE = re.compile(r'"?sep=(.)"?[ ]*(?:\r\n|\n|\r)', re.IGNORECASE)
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_HALF = re.compile("[\ud800-\udfff]")
_BYTE_ORDER_MARK = "\ufeff"
#: A header of more cells is no session table's; the bound keeps hostile lines cheap.
_MOST_CELLS = 20_000
#: Characters at the beginning of a text that tell its dialect, and of a cell with a mouse track.
_BEGINNING = 1 << 19
_LONGEST_CELL = 1 << 24
#: A dialect is tried on so many rows.
_SAMPLE = 2_000
_QUOTES_HINT = "Write the table again as CSV with quotes doubled."
# csv's own limit of 128 kB is below what mouse tracks take.
csv.field_size_limit(max(csv.field_size_limit(), _LONGEST_CELL))


class Grid:
    """A table of texts: its header, and its rows one after the other.

    Parameters
    ----------
    file : str
        The file's name for messages.
    names : list of str
        Cells of the header as they stand.
    records : iterator
        Line and cells of each record below it.
    delimiter : str
        What stands between the cells in the file.
    layout : Layout, optional
        What stands around the table.

    Raises
    ------
    UsageError
        No row, or one of another width.
    """

    def __init__(
        self,
        file: str,
        names: list[str],
        records: Rows,
        delimiter: str = ",",
        layout: Layout | None = None,
    ) -> None:
        self.file = file
        self.delimiter = delimiter
        self.layout = layout or Layout()
        self.notices = list(self.layout.notices)
        self.dropped = Counter[str]()  # Records that are no data, by reason
        # A delimiter may end the header; a column without a name is called by its position.
        named = names if names[-1].strip() else names[:-1]
        self.header = [name.strip() or f"column {number}" for number, name in enumerate(named, 1)]
        self._rows = self._data(names, records)
        self.sample = list(islice(self._rows, _SAMPLE))

    def position(self, name: str) -> int:
        """Return where the one column of a name stands."""
        if self.header.count(name) == 1:
            return self.header.index(name)
        message = f"there is no column {name!r}."
        if name in self.header:
            message = f"two columns have the name {name!r}."
        hint = f"The columns are {shown(self.header)}.{did_you_mean(name, self.header)}"
        raise self.error(message, name, hint)

    def error(
        self, message: str, column: str, hint: str, kind: type[UsageError] = UsageError
    ) -> UsageError:
        """Return an error about a column of the header."""
        return kind(message, file=self.file, row=1, column=column, hint=hint)

    def rows(self) -> Rows:
        """Give the rows of data, once."""
        return chain(self.sample, self._rows)

    def _data(self, names: list[str], records: Rows) -> Rows:
        """Leave out what is no data, and hold the rest to one width."""
        columns = len(self.header)
        width = 0
        for line, cells in records:
            text = "".join(cells)
            if cells == names:
                self.dropped["repeated header"] += 1
            elif not text or text.isspace():
                self.dropped["blank line"] += 1
            elif text.strip() == "END OF FILE":
                self.dropped["end-of-file mark"] += 1
            elif text.startswith(COMMENT) and is_comment(cells):
                if not self.dropped["comment"]:
                    text = f"comments are skipped, here the first: {shown([cells[0]])}"
                    self.notices.append(Notice(text, self.file, line))
                self.dropped["comment"] += 1
            else:
                width = width or len(cells)
                # A writer may end every line with a delimiter, whether or not it ends the header
                # so.
                fits = columns <= width <= columns + 1 and len(cells) == width
                if not fits or (width > columns and cells[-1]):
                    raise self._ragged(names, line, cells, width)
                yield line, cells

    def _ragged(self, names: list[str], line: int, cells: list[str], width: int) -> UsageError:
        """Say that a record has not as many cells as the first, or fits no header."""
        message = f"{len(cells)} cells where the header has {len(names)}"
        message += f" and the lines above have {width}." if len(cells) != width else "."
        hint = "Fix this line or its quotes."
        if len(cells) == len(names) + 1:
            hint += " Decimal commas need quotes; R's write.table needs col.names = NA."
        value = clip(self.delimiter.join(cells))
        return UsageError(message, file=self.file, row=line, value=value, hint=hint)


def refuse_half(text: str, file: str, row: int) -> None:
    """Refuse half of a character, which JSON and escapes can write, and no file can hold.

    The text begins in the row that is given.
    """
    found = None if text.isascii() else _HALF.search(text)
    if found:
        row += text.count("\n", 0, found.start())
        message = "half of a character (a lone surrogate)."
        value = clip(text[found.start() :])
        raise UsageError(message, file=file, row=row, value=value, hint="Write the text again.")


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
    refuse_half(text, file, 1)
    text = text.replace("\r\r\n", "\r\n")  # So some programs end a line
    first_row = 1
    if sep := _SEP_LINE.match(text):
        delimiter = delimiter or sep[1]
        text = text[sep.end() :]
        first_row = 2
    text = text.lstrip(_BYTE_ORDER_MARK)
    if _BYTE_ORDER_MARK in text:
        # An appending writer puts one before each repeated header.
        head = re.escape(re.split("[\r\n]", text, maxsplit=1)[0])
        text = re.sub(f"(^|[\r\n]){_BYTE_ORDER_MARK}(?={head})", r"\1", text)
    beginning = text[:_BEGINNING]
    header = next((line for line in beginning.splitlines() if line.strip()), "")
    fits: list[Grid] = []
    misfits: list[tuple[bool, int, int, UsageError]] = []
    for sign in [delimiter] if delimiter else _delimiters(header, beginning):
        for quoting in _quotings(beginning):
            try:
                records = _records(text, sign, quoting, file, first_row)
                fits.append(with_header(records, file, sign, fewest=2))
                break
            except UsageError as misfit:
                # The delimiter meant splits the text most, and the quoting meant gets farthest.
                named = isinstance(misfit, LayoutError)
                misfits.append((named, beginning.count(sign), misfit.row or 0, misfit))
    # Under a delimiter that is none, a row with one in a cell would look like a header.
    least = min((grid.layout.skipped for grid in fits), default=0)
    fits = [grid for grid in fits if grid.layout.skipped == least]
    if len(fits) == 1:
        return fits[0]
    if fits:
        names = " and ".join(_DELIMITERS[grid.delimiter] for grid in fits)
        hint = 'Declare [sessions] delimiter = ";" (or the one that is right).'
        raise UsageError(f"{names} can each split the lines.", file=file, hint=hint)
    refuse_aligned(beginning, file, first_row)
    if misfits:
        raise max(misfits, key=lambda misfit: misfit[:3])[3]
    message = "this is not a table: no comma, semicolon, tab, bar or space separates its columns."
    hint = "Export it as CSV, or declare [sessions] delimiter."
    raise UsageError(message, file=file, row=first_row, hint=hint)


def _delimiters(header: str, text: str) -> list[str]:
    """List delimiters to try: spaces only where the header has no other, for names have spaces."""
    *others, space = _DELIMITERS
    spaces = space in header and not any(sign in header for sign in others)
    return [space] * spaces + [sign for sign in others if sign in text]


def _quotings(text: str) -> tuple[Quoting, ...]:
    """List conventions to try, in order; PsychoPy's own only on a file of PsychoPy."""
    if '"' not in text:
        return ("doubled",)
    head = text[: text.find("\n") + 1 or len(text)]
    if "psychopyVersion" in head or "expName" in head:
        return ("wrapped", "doubled")
    return ("doubled", "backslash")


def with_header(records: Rows, file: str, delimiter: str = ",", *, fewest: int = 1) -> Grid:
    """Make a table of records whose header stands below a title or blank lines, or first.

    The header has at least the fewest cells that are given.

    Raises
    ------
    UsageError
        There is no header, or there are no data below it.
    """
    first = list(islice(records, MOST_ROWS))
    if not any(cell.strip() for _, cells in first for cell in cells):
        hint = "Leave it out, or export it again."
        raise UsageError("the file has no header.", file=file, hint=hint)
    layout = layout_of(first, file)
    line, names = first[layout.header]
    if not fewest <= len(names) <= _MOST_CELLS:
        hint = "Correct the header, or declare [sessions] delimiter."
        raise UsageError(f"a header of {len(names)} cells.", file=file, row=line, hint=hint)
    records = chain(first[layout.data :], records)
    grid = Grid(file, names, records, delimiter, layout)
    if not grid.sample:
        message = "there are no data below the header."
        raise NoDataError(message, file=file, row=line, hint="Leave the file out.")
    return grid


def _records(text: str, delimiter: str, quoting: Quoting, file: str, first_row: int) -> Rows:
    """Split a text into records."""
    if quoting == "backslash":
        # A NUL is refused before, so that it can stand for an escaped quote.
        text = text.replace('\\"', "\0")
    lines = (found[0] for found in _LINE.finditer(text))
    if quoting == "wrapped":
        for row, line in enumerate(lines, first_row):
            yield row, _join(line.rstrip("\r\n").split(delimiter), delimiter)
        return
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    row = first_row
    try:
        for cells in reader:
            if quoting == "backslash":
                cells = [cell.replace("\0", '"') for cell in cells]
            yield row, cells or [""]
            row = first_row + reader.line_num
    except csv.Error as error:
        message = "a quoted cell is not closed, or text follows its closing quote."
        if "limit" in str(error):
            message = f"a cell of more than {_LONGEST_CELL:,} characters."
        raise UsageError(message, file=file, row=row, hint=_QUOTES_HINT) from None


def _join(pieces: list[str], delimiter: str) -> list[str]:
    """Join the pieces of a line where PsychoPy's quotes wrap a cell with the delimiter."""
    closing = [index for index, piece in enumerate(pieces) if piece.endswith('"')]
    cells: list[str] = []
    index = 0
    while index < len(pieces):
        piece = pieces[index]
        last = index
        following = bisect(closing, index)
        # A cell quoted at both ends without a delimiter inside was not quoted by the writer: it
        # stays.
        whole = len(piece) > 1 and piece.endswith('"')
        if piece.startswith('"') and not whole and following < len(closing):
            last = closing[following]
        if last > index:
            piece = delimiter.join(pieces[index : last + 1])[1:-1]
        cells.append(piece)
        index = last + 1
    return cells
