"""Texts to tables of text, under the one dialect that gives every line the same number of cells.

A dialect is a delimiter and a way of quoting. Those that the first block of a text may have are
tried on it. One fits if the first line that is not blank has several cells, and all records below
have as many as the first of them; it may have one more cell than the header where that is empty.
Of several that fit, those are taken whose header has columns that are read. Nothing is guessed: if
none or several are left, that is an error.

A text is read in blocks of whole records, one at a time. A block gives a `Grid` of strings as they
stand in the file. Where a text has no quotes and nothing odd, `Block.read_plain` has pandas read
the numbers, which is far faster; the grid of the same block would say the same.
"""

from __future__ import annotations

import csv
import io
import re
from bisect import bisect
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TextIO

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions import files
from percept.sessions.layout import FirstRows, LayoutError, refuse_aligned, refuse_layout
from percept.sessions.plain import are_plain, is_rectangular
from percept.sessions.records import NoDataError, Place, clip

Quoting = Literal["doubled", "backslash", "wrapped"]

_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "space"}
_SEP_LINE = re.compile(r'"?sep=(.)"?[ ]*(?:\r\n|\n|\r)', re.IGNORECASE)
_BYTE_ORDER_MARK = "\ufeff"
#: A header of more cells is no session table's; the bound keeps hostile lines cheap.
_MOST_CELLS = 20_000
#: The dialect of a file is found from about as many characters, some thousand trials.
_HEAD = 1 << 18
#: The pandas parser rounds correctly by default since 3.1. Older ones need "round_trip".
_EXACT: Any = None if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else "round_trip"
_QUOTES_HINT = "Write the table again as CSV with quotes doubled."
# Cells that hold mouse tracks pass csv's own limit of 128 kB. Blocks bound all cells: a block holds
# whole records, and may so be several times its size.
csv.field_size_limit(max(csv.field_size_limit(), 8 * files.BLOCK))


@dataclass(frozen=True)
class Dialect:
    """How a file separates and quotes its cells, and the cells of its header as they stand."""

    file: str
    delimiter: str = ","
    quoting: Quoting = "doubled"
    names: tuple[str, ...] = ()
    width: int = 0  # Cells of a record, once there is one

    @property
    def header(self) -> list[str]:
        """Column names, without an empty last one; one without a name is called by its position."""
        names = self.names
        if not names[-1].strip():
            names = names[:-1]
        return [name.strip() or f"column {number}" for number, name in enumerate(names, 1)]


@dataclass(frozen=True)
class Records:
    """Records of a text, each a list of cells, and the physical line on which each starts."""

    cells: list[list[str]]
    lines: list[int]

    def after(self, index: int) -> Records:
        """Return the records after one of them."""
        return Records(self.cells[index + 1 :], self.lines[index + 1 :])


@dataclass(frozen=True)
class Grid:
    """A text table: rows and columns of strings, a stretch of a file.

    `cells` has the texts of the data records: columns by position, the physical line as index.
    `dropped` counts the records left out as no data, by reason.
    """

    header: list[str]
    cells: pd.DataFrame
    dropped: Counter[str]

    @classmethod
    def of(cls, dialect: Dialect, records: Records, *, last: bool = True) -> Grid:
        """Drop what is no data; hold the rest to one width, but for one empty trailing column."""
        dropped = Counter[str]()
        kept = Records([], [])
        final = len(records.cells) - 1 if last else -1
        for index, (record, line) in enumerate(zip(records.cells, records.lines, strict=True)):
            reason = _no_data(record, dialect, last=index == final)
            if reason:
                dropped[reason] += 1
            else:
                kept.cells.append(record)
                kept.lines.append(line)
        header = dialect.header
        _refuse_ragged(kept, dialect)
        cells = [record[: len(header)] for record in kept.cells]
        columns = range(len(header))
        frame = pd.DataFrame(cells, index=kept.lines, columns=columns, dtype=object)
        return cls(header, frame, dropped)


def _no_data(record: list[str], dialect: Dialect, *, last: bool) -> str:
    """Say why a record is no data; empty where it is."""
    text = "".join(record).strip()
    if tuple(record) == dialect.names:
        return "repeated header"
    if not text:
        return "blank line"
    if last and text == "END OF FILE":
        return "end-of-file mark"
    return ""


def _refuse_ragged(records: Records, dialect: Dialect) -> None:
    """Refuse a record that has not as many cells as the first, or that fits no header."""
    named = len(dialect.names)
    columns = len(dialect.header)
    width = dialect.width or len(next(iter(records.cells), dialect.names))
    # A writer may end every line with a delimiter, whether or not it ends the header so.
    fits_header = columns <= width <= columns + 1
    for record, line in zip(records.cells, records.lines, strict=True):
        if fits_header and len(record) == width and not any(record[columns:]):
            continue
        message = f"{len(record)} cells where the header has {named}"
        message += f" and the lines above have {width}." if len(record) != width else "."
        hint = "Fix this line or its quotes."
        if len(record) == named + 1:
            hint += " Decimal commas need quotes; R's write.table needs col.names = NA."
        value = clip(dialect.delimiter.join(record))
        raise UsageError(message, file=dialect.file, row=line, value=value, hint=hint)


@dataclass
class Block:
    """A stretch of a table: split into cells, or a text to be split."""

    dialect: Dialect
    split: Grid | None = None
    text: str = ""
    first_row: int = 1  # Physical line on which the text starts
    last: bool = True  # Whether the table ends with it

    def grid(self) -> Grid:
        """Split the text."""
        if self.split is None:
            records = _records(self.text, self.dialect, self.first_row)
            self.split = Grid.of(self.dialect, records, last=self.last)
        return self.split

    def read_plain(
        self, texts: list[int], numbers: list[int], decimal_mark: str
    ) -> pd.DataFrame | None:
        """Read columns of a plain text by pandas' parser; None where cells need a closer look.

        The parser takes what percept refuses: lines of any width, infinity, "True" for 1, numbers
        too small for a double. It refuses words, and so every header and mark between the data.
        """
        delimiter = self.dialect.delimiter
        text = self.text.replace("\r\n", "\n") if "\r" in self.text else self.text
        special = any(sign in text for sign in ('"', "\r", _BYTE_ORDER_MARK))
        if special or not (text and delimiter.isascii()):
            return None
        body = text.encode()
        if not text.endswith("\n"):
            body += b"\n"
        lowered = body.lower()
        if b"true" in lowered or b"false" in lowered:
            return None
        if not is_rectangular(body, delimiter, self.dialect.width):
            return None
        kinds: Any = dict.fromkeys(texts, "str") | dict.fromkeys(numbers, np.float64)
        blank: Any = {column: [""] for column in numbers}
        try:
            parsed = pd.read_csv(
                io.BytesIO(body),
                sep=delimiter,
                header=None,
                usecols=[*texts, *numbers],
                dtype=kinds,
                decimal=decimal_mark,
                keep_default_na=False,
                na_values=blank,
                quoting=csv.QUOTE_NONE,
                skip_blank_lines=False,
                float_precision=_EXACT,
                engine="c",
            )
        except (ValueError, OverflowError):
            return None
        if not are_plain(parsed[numbers].to_numpy(), exponents=b"e-" in lowered):
            return None
        parsed.index = pd.RangeIndex(self.first_row, self.first_row + len(parsed))
        return parsed


def text_blocks(
    stream: TextIO, *, file: str, delimiter: str | None, resolves: Callable[[list[str]], bool]
) -> Iterator[Block]:
    """Find the dialect of a text, and cut it into stretches of whole records.

    Parameters
    ----------
    stream : text stream
        Read to its end, and closed.
    file : str
        Its name for messages.
    delimiter : str or None
        The one declared; None finds it.
    resolves : callable
        Whether a header has columns that are read; it decides between delimiters that fit.

    Yields
    ------
    Block
        The first is split.

    Raises
    ------
    UsageError
        No dialect fits, or several fit equally well.
    """
    with stream:
        text = _stretch(stream, file, _HEAD)
        first_row = 1
        if sep := _SEP_LINE.match(text):
            delimiter = delimiter or sep[1]
            text = text[sep.end() :]
            first_row = 2
        text = text.lstrip(_BYTE_ORDER_MARK)
        head = re.split("[\r\n]", text, maxsplit=1)[0]
        following = _stretch(stream, file, files.BLOCK)
        unsplit = Block(
            Dialect(file),
            text=_without_marks(text, head),
            first_row=first_row,
            last=not following,
        )
        dialect, grid = _find_dialect(unsplit, delimiter, resolves)
        after_header = int(grid.cells.index[0]) - first_row
        lines = io.StringIO(unsplit.text, newline="").readlines()
        rest = "" if grid.dropped else "".join(lines[after_header:])
        yield Block(dialect, grid, rest, first_row + after_header)
        while following:
            first_row += files.line_ends(text)
            text = following
            following = _stretch(stream, file, files.BLOCK)
            yield Block(
                dialect,
                text=_without_marks(text, head),
                first_row=first_row,
                last=not following,
            )


def _stretch(stream: TextIO, file: str, size: int) -> str:
    """Read about `size` characters up to the end of a record."""
    lines = [stream.read(size), stream.readline(size)]
    if lines[1].endswith("\r"):
        # Some programs end a line with two carriage returns and a line feed.
        lines.append(stream.readline(size))
    if len(lines[1]) >= size:
        hint = "This is no session table, or its line ends are lost."
        raise UsageError(f"a line of more than {size} characters.", file=file, hint=hint)
    # A quoted cell may hold line ends: a record ends where quotes are even, escaped ones too.
    quotes = sum(line.count('"') for line in lines)
    escaped = sum(line.count('\\"') for line in lines)
    length = 0
    while (quotes % 2 or escaped % 2) and length < size:
        line = stream.readline(size)
        if not line:
            break
        lines.append(line)
        quotes += line.count('"')
        escaped += line.count('\\"')
        length += len(line)
    return "".join(lines).replace("\r\r\n", "\r\n")


def _without_marks(text: str, head: str) -> str:
    """Drop the byte-order mark that an appending writer puts before each repeated header."""
    if _BYTE_ORDER_MARK not in text:
        return text
    return re.sub(f"(^|[\r\n]){_BYTE_ORDER_MARK}(?={re.escape(head)})", r"\1", text)


def _find_dialect(
    block: Block, delimiter: str | None, resolves: Callable[[list[str]], bool]
) -> tuple[Dialect, Grid]:
    """Find the one dialect that fits a text with its header, and split it."""
    file = block.dialect.file
    text = block.text
    head = next((line for line in text.splitlines() if line.strip()), "")
    candidates = [delimiter] if delimiter else _delimiters(head, text)
    fits: list[tuple[Dialect, Grid]] = []
    misfits: list[tuple[int, int, UsageError]] = []
    for candidate in candidates:
        for quoting in _quotings(text):
            try:
                fits.append(_with_header(block, Dialect(file, candidate, quoting)))
                break
            except UsageError as misfit:
                # The delimiter meant splits the header most, and the quoting meant gets farthest.
                misfits.append((head.count(candidate), misfit.row or 0, misfit))
    if len(fits) > 1:
        fits = [fit for fit in fits if resolves(fit[1].header)] or fits
    if len(fits) == 1:
        return fits[0]
    if fits:
        names = " and ".join(_DELIMITERS[dialect.delimiter] for dialect, _ in fits)
        hint = 'Declare [sessions] delimiter = ";" (or the one that is right).'
        raise UsageError(f"{names} can each split the lines.", file=file, hint=hint)
    refuse_aligned(text, file, block.first_row)
    if misfits:
        named = [misfit for misfit in misfits if isinstance(misfit[2], LayoutError)]
        raise max(named or misfits, key=lambda misfit: misfit[:2])[2]
    message = "this is not a table: no comma, semicolon, tab, bar or space separates its columns."
    hint = "Export it as CSV, or declare [sessions] delimiter."
    raise UsageError(message, file=file, row=block.first_row, hint=hint)


def _delimiters(head: str, text: str) -> list[str]:
    """List delimiters to try: spaces only where the header has no other, for names have spaces."""
    *others, space = _DELIMITERS
    spaces = space in head and not any(sign in head for sign in others)
    return [space] * spaces + [sign for sign in others if sign in text]


def _quotings(text: str) -> tuple[Quoting, ...]:
    """List conventions to try, in order; PsychoPy's own only on a file of PsychoPy."""
    if '"' not in text:
        return ("doubled",)
    head = text[: text.find("\n") + 1 or len(text)]
    if "psychopyVersion" in head or "expName" in head:
        return ("wrapped", "doubled")
    return ("doubled", "backslash")


def _with_header(block: Block, tried: Dialect) -> tuple[Dialect, Grid]:
    """Split a text under a dialect. The first line that is not blank is the header."""
    records = _records(block.text, tried, block.first_row)
    refuse_layout(FirstRows.of(tried.file, records.cells, records.lines))
    start = 0
    while start < len(records.cells) and not any(cell.strip() for cell in records.cells[start]):
        start += 1
    if start == len(records.cells):
        hint = "Leave it out, or export it again."
        raise UsageError("the file has no header.", file=tried.file, hint=hint)
    names = tuple(records.cells[start])
    place = Place(file=tried.file, row=records.lines[start])
    if not 2 <= len(names) <= _MOST_CELLS:
        hint = "Correct the header, or declare [sessions] delimiter."
        raise UsageError(f"a header of {len(names)} cells.", hint=hint, **place)
    tried = replace(tried, names=names)
    grid = Grid.of(tried, records.after(start), last=block.last)
    if grid.cells.empty:
        message = "there are no data below the header."
        raise NoDataError(message, hint="Leave the file out.", **place)
    first = records.lines.index(int(grid.cells.index[0]))
    return replace(tried, width=len(records.cells[first])), grid


def _records(text: str, dialect: Dialect, first_row: int) -> Records:
    """Split a text into records."""
    if dialect.quoting == "backslash":
        # A NUL is refused before, so that it can stand for an escaped quote.
        text = text.replace('\\"', "\0")
    lines = io.StringIO(text, newline="").readlines()
    cells: list[list[str]] = []
    ends: list[int] = []  # How many lines end with each record
    if dialect.quoting == "wrapped":
        for line in lines:
            cells.append(_join(line.rstrip("\r\n").split(dialect.delimiter), dialect.delimiter))
        ends = list(range(1, len(lines) + 1))
    else:
        reader = csv.reader(lines, delimiter=dialect.delimiter, strict=True)
        try:
            for record in reader:
                cells.append(record or [""])
                ends.append(reader.line_num)
        except csv.Error:
            message = "a quoted cell is not closed, or text follows its closing quote."
            row = first_row + (ends[-1] if ends else 0)
            raise UsageError(message, file=dialect.file, row=row, hint=_QUOTES_HINT) from None
    if dialect.quoting == "backslash":
        cells = [[cell.replace("\0", '"') for cell in record] for record in cells]
    if "\r" in text:
        _refuse_lone_returns(lines, ends, dialect.file, first_row)
    starts = [first_row, *(first_row + end for end in ends)]
    return Records(cells, starts[: len(cells)])


def _refuse_lone_returns(
    lines: Sequence[str], ends: Sequence[int], file: str, first_row: int
) -> None:
    """Refuse a record that ends in a carriage return, where others end in a line feed."""
    closing = [lines[end - 1] for end in ends]
    alone = [end for end, line in zip(ends, closing, strict=True) if line.endswith("\r")]
    if alone and any(line.endswith("\n") for line in closing):
        message = "a line ends in a lone carriage return, and other lines do not."
        raise UsageError(message, file=file, row=first_row + alone[0] - 1, hint=_QUOTES_HINT)


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
