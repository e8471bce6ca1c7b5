"""Text to cells, under the one dialect in which every line has as many."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, TextIO

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions import files
from percept.sessions.records import NoDataError, clip

Quoting = Literal["doubled", "backslash", "wrapped"]

_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar"}
_SEP_LINE = re.compile(r'"?sep=(.)"?[ ]*(?:\r\n|\n|\r)', re.IGNORECASE)
_FIRST_LINE = re.compile(r"[^\r\n]*")
_MARK = "\ufeff"
#: A line of more cells than this is no session table; the bound keeps hostile lines cheap.
_CELLS = 20_000
#: The dialect of a large file is found from about as many characters.
_HEAD = 1 << 18
#: The pandas parser rounds correctly by default since 3.1; before, it had to be asked.
_EXACT: Any = None if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else "round_trip"
#: A longer line may hold a number too small for a double without an exponent.
_LONG = 300
# Cells hold recordings of mouse tracks, beyond the module's 128 kB; a block bounds them.
csv.field_size_limit(max(csv.field_size_limit(), 8 * files.BLOCK))


def with_names(header: list[str]) -> list[str]:
    """Name columns without a name, as R and pandas write an index, by their position: "column 1"."""
    return [name or f"column {at}" for at, name in enumerate(header, 1)]


@dataclass(frozen=True)
class Grid:
    """A rectangular stretch of a table of text."""

    header: list[str]  # Column names, without surrounding space
    cells: pd.DataFrame  # Texts of the data records; columns by position, the index is the physical line
    dropped: Counter[str]  # Records left out as no data, by reason

    @classmethod
    def of(cls, header: list[str], records: list[list[str]], rows: list[int], dropped: Counter[str]) -> Grid:
        """Lay out records, each as long as the header."""
        columns = range(len(header))
        return cls(header, pd.DataFrame(records, index=rows, columns=columns, dtype=object), dropped)


class _MisfitError(UsageError):
    """A dialect that does not fit; `width` is the number of header cells it gave."""

    def __init__(self, width: int, message: str, **place: Any) -> None:
        super().__init__(message, **place)
        self.width = width


class _EmptyError(_MisfitError, NoDataError):
    """A header alone."""


@dataclass
class Layout:
    """How a file separates and quotes its cells, and its header."""

    file: str
    delimiter: str
    quoting: Quoting = "doubled"
    names: list[str] = field(default_factory=list)  # The header's cells as they stand
    width: int = 0  # Cells of a record as they stand, once there is one

    @property
    def header(self) -> list[str]:
        """Column names, without surrounding space and an empty last one."""
        header = [name.strip() for name in self.names]
        return with_names(header[:-1] if header[-1] == "" else header)

    def grid(self, cells: list[list[str]], rows: list[int], *, last: bool) -> Grid:
        """Drop what is no data; hold the rest to one width, but for one empty trailing column."""
        dropped = Counter[str]()
        kept: list[int] = []
        for at, record in enumerate(cells):
            text = "".join(record).strip()
            if record == self.names:
                dropped["repeated header"] += 1
            elif not text:
                dropped["blank line"] += 1
            elif last and at == len(cells) - 1 and text == "END OF FILE":
                dropped["end-of-file mark"] += 1
            else:
                kept.append(at)
        cells, rows = [cells[at] for at in kept], [rows[at] for at in kept]
        self.width = width = self.width or (len(cells[0]) if cells else 0)
        if self._lacks_first_name(cells):
            self.names = ["row names", *self.names]
        header, named = self.header, len(self.names)
        fits = not cells or width in (named, len(header)) or width == named + 1 == len(header) + 1
        odd = next((at for at, r in enumerate(cells) if len(r) != width or (width > named and r[-1])), None)
        if odd is not None or not fits:
            wrong = next((at for at, r in enumerate(cells) if len(r) not in (named, len(header))), odd or 0)
            message = f"{len(cells[wrong])} cells where the header has {named}."
            value = clip(self.delimiter.join(cells[wrong]))
            hint = "Mend this line, or the quoting of a cell in it."
            if len(cells[wrong]) == named + 1:
                hint += " Decimal commas need quotes; R's write.table needs col.names = NA."
            raise _MisfitError(named, message, file=self.file, row=rows[wrong], value=value, hint=hint)
        return Grid.of(header, [record[: len(header)] for record in cells], rows, dropped)

    def _lacks_first_name(self, cells: Sequence[Sequence[str]]) -> bool:
        """Whether the header lacks the name of row names, as R's write.table leaves it.

        Between commas a decimal comma may have made the cell that is too many.
        """
        if self.delimiter == "," or self.width != len(self.names) + 1:
            return False
        if not all(len(r) == self.width and r[-1] and r[0].isdecimal() and len(r[0]) < 10 for r in cells):
            return False
        names = [int(r[0]) for r in cells]
        return all(one < other for one, other in pairwise(names))


@dataclass
class Block:
    """A stretch of a table: split into cells, or a text to be split."""

    split: Grid | None = None
    layout: Layout = field(default_factory=lambda: Layout("", ","))
    text: str = ""
    first_row: int = 1
    last: bool = True

    def grid(self) -> Grid:
        """Split the text."""
        if self.split is None:
            records = _records(self.text, self.layout, self.first_row)
            self.split = self.layout.grid(*records, last=self.last)
        return self.split

    def plain(self, texts: Sequence[int], numbers: Sequence[int], mark: str) -> pd.DataFrame | None:
        """Read columns of a text without quotes by pandas' parser; None where cells need a closer look.

        The parser takes what percept refuses: lines of any width, infinity, "True" for 1, numbers too small
        for a double. It refuses words, and so every header and mark between the data.
        """
        delimiter, width = self.layout.delimiter, self.layout.width
        text = self.text.replace("\r\n", "\n") if "\r" in self.text else self.text
        if self.split or not delimiter.isascii() or any(sign in text for sign in ('"', "\r", _MARK)):
            return None
        body = text.encode() + (b"" if text.endswith("\n") else b"\n")
        characters = np.frombuffer(body, dtype=np.uint8)
        ends_line = characters == ord("\n")
        ends = ends_line[ends_line | (characters == ord(delimiter))]
        if len(ends) % width or not ends[width - 1 :: width].all() or ends.sum() * width != len(ends):
            return None
        kinds: Any = dict.fromkeys(texts, "str") | dict.fromkeys(numbers, np.float64)
        blank: Any = {at: [""] for at in numbers}
        try:
            parsed = pd.read_csv(
                io.BytesIO(body),
                sep=delimiter,
                header=None,
                usecols=[*texts, *numbers],
                dtype=kinds,
                decimal=mark,
                keep_default_na=False,
                na_values=blank,
                quoting=csv.QUOTE_NONE,
                skip_blank_lines=False,
                float_precision=_EXACT,
                engine="c",
            )
        except (ValueError, OverflowError):
            return None
        found = parsed[[*numbers]].to_numpy()
        empty, zero = np.isnan(found), found == 0
        if np.isinf(found).any() or empty.all(axis=1).any():
            return None
        if (empty | zero | (found == 1)).all(axis=0).any() and re.search(b"true|false", body.lower()):
            return None
        if zero.any() and (b"e-" in body.lower() or max(map(len, body.splitlines())) > _LONG):
            return None
        parsed.index = pd.RangeIndex(self.first_row, self.first_row + len(parsed))
        return parsed


def text_blocks(
    stream: TextIO, *, file: str, delimiter: str | None, large: bool, resolves: Callable[[list[str]], bool]
) -> Iterator[Block]:
    """Find the dialect of a text, and cut it into stretches of whole records."""
    with stream:
        text, first_row = _stretch(stream, file, _HEAD) if large else stream.read(), 1
        if sep := _SEP_LINE.match(text):
            delimiter = delimiter or sep[1]
            text, first_row = text[sep.end() :], 2
        text = text.lstrip(_MARK)
        line = _FIRST_LINE.match(text)[0]  # type: ignore[index]  # it matches any text
        following = _stretch(stream, file, files.BLOCK)
        layout, grid = _find_layout(
            _without_marks(text, line), file, delimiter, first_row, resolves, last=not following
        )
        yield Block(grid)
        while following:
            first_row += files.line_ends(text)
            text, following = following, _stretch(stream, file, files.BLOCK)
            yield Block(None, layout, _without_marks(text, line), first_row, not following)


def _stretch(stream: TextIO, file: str, size: int) -> str:
    """Read about `size` characters up to the end of a record."""
    lines = [stream.read(size), stream.readline(size)]
    if len(lines[1]) >= size:
        hint = "This is no session table, or its line ends are lost."
        raise UsageError(f"a line of more than {size} characters.", file=file, hint=hint)
    # A quoted cell may hold line ends: a record ends where quotes are even, escaped ones too.
    quotes, escaped, length = 0, 0, 0
    if '"' in lines[0] or '"' in lines[1]:
        quotes, escaped = (sum(line.count(sign) for line in lines) for sign in ('"', '\\"'))
    while (quotes % 2 or escaped % 2) and length < size and (line := stream.readline(size)):
        lines.append(line)
        quotes, escaped, length = quotes + line.count('"'), escaped + line.count('\\"'), length + len(line)
    return "".join(lines)


def _without_marks(text: str, line: str) -> str:
    """Drop the byte-order mark that an appending writer puts before each repeated header."""
    if _MARK not in text:
        return text
    for end in ("\n", "\r"):
        text = text.replace(f"{end}{_MARK}{line}", f"{end}{line}")
    return text.removeprefix(_MARK) if text.startswith(_MARK + line) else text


def _find_layout(
    text: str,
    file: str,
    delimiter: str | None,
    first_row: int,
    resolves: Callable[[list[str]], bool],
    *,
    last: bool,
) -> tuple[Layout, Grid]:
    """Find the one dialect that fits a text with its header, and split it."""
    if not text.strip():
        raise UsageError("the file has no header.", file=file, hint="Leave it out, or export it again.")
    fits: list[tuple[Layout, Grid]] = []
    misfits: list[tuple[int, _MisfitError]] = []
    first = next(line for line in text.splitlines() if line.strip())
    for candidate in [delimiter] if delimiter else [d for d in _DELIMITERS if d in text]:
        failed: list[_MisfitError] = []
        for quoting in _quotings(text):
            layout = Layout(file, candidate, quoting)
            try:
                fits.append((layout, _with_header(layout, text, first_row, last=last)))
                break
            except _MisfitError as misfit:
                failed.append(misfit)
        else:
            # Quotes may be wrong on any line: how a header splits says which delimiter was meant.
            width = first.count(candidate)
            misfits.append((width, max(failed, key=lambda misfit: misfit.width)))
    if len(fits) > 1:
        fits = [fit for fit in fits if resolves(fit[0].header)] or fits
    if len(fits) == 1:
        return fits[0]
    if fits:
        names = " and ".join(_DELIMITERS[layout.delimiter] for layout, _ in fits)
        hint = 'Declare [sessions] delimiter = ";" (or the one that is right).'
        raise UsageError(f"the lines can be split by {names} alike.", file=file, hint=hint)
    if misfits:
        raise max(misfits, key=lambda one: (one[0], one[1].width))[1]
    message = "this is not a table: no comma, semicolon, tab or bar separates its columns."
    hint = "Export it as CSV, or declare [sessions] delimiter."
    raise UsageError(message, file=file, row=first_row, hint=hint)


def _quotings(text: str) -> tuple[Quoting, ...]:
    """Conventions to try, in order; PsychoPy's own is tried only on a file that says it is PsychoPy's."""
    if '"' not in text:
        return ("doubled",)
    head = text[: text.find("\n") + 1 or len(text)]
    if "psychopyVersion" in head or "expName" in head:
        return ("wrapped", "doubled")
    return ("doubled", "backslash")


def _with_header(layout: Layout, text: str, first_row: int, *, last: bool) -> Grid:
    """Split a text under a dialect that is tried, its first line that is not blank being the header."""
    cells, rows = _records(text, layout, first_row)
    start = next((at for at, record in enumerate(cells) if any(cell.strip() for cell in record)), None)
    if start is None:
        raise _MisfitError(0, "the file has no header.", file=layout.file)
    place: Any = {"file": layout.file, "row": rows[start]}
    layout.names = cells[start]
    if len(layout.names) < 2:
        raise _MisfitError(1, "the header has a single cell.", **place)
    grid = layout.grid(cells[start + 1 :], rows[start + 1 :], last=last)
    if grid.cells.empty:
        message, hint = "there are no data below the header.", "Leave the file out."
        raise _EmptyError(len(layout.names), message, hint=hint, **place)
    return grid


def _records(text: str, layout: Layout, first_row: int) -> tuple[list[list[str]], list[int]]:
    """Split a text into records, and give the physical line on which each starts."""
    delimiter, file = layout.delimiter, layout.file
    hint = "Write the table again as CSV with quotes doubled."
    if layout.quoting == "backslash":
        # A NUL is refused before, so that it can stand for an escaped quote.
        text = text.replace('\\"', "\0")
    lines = io.StringIO(text, newline="").readlines()
    if layout.quoting == "wrapped":
        cells = [_join(line.rstrip("\r\n").split(delimiter), delimiter) for line in lines]
        ends = list(range(1, len(lines) + 1))
    else:
        unclosed = "a quoted cell is not closed, or text follows its closing quote."
        if (before := _misplaced(text, delimiter, layout.quoting)) is not None:
            row = first_row + files.line_ends(before)
            raise _MisfitError(0, unclosed, file=file, row=row, hint=hint)
        cells, ends = [], []
        reader = csv.reader(lines, delimiter=delimiter, strict=True, doublequote=layout.quoting == "doubled")
        try:
            for record in reader:
                cells.append(record or [""])
                ends.append(reader.line_num)
        except csv.Error:
            row = first_row + (ends[-1] if ends else 0)
            raise _MisfitError(0, unclosed, file=file, row=row, hint=hint) from None
        if layout.quoting == "backslash":
            cells = [[cell.replace("\0", '"') for cell in record] for record in cells]
    rows = [first_row, *(first_row + end for end in ends[:-1])][: len(cells)]
    longest = max(range(len(cells)), key=lambda at: len(cells[at]), default=None)
    if longest is not None and len(cells[longest]) > _CELLS:
        message = f"more than {_CELLS} cells in a line."
        raise _MisfitError(0, message, file=file, row=rows[longest], hint=hint)
    if "\r" in text:
        closing = [lines[end - 1] for end in ends]
        alone = [at for at, line in enumerate(closing) if line.endswith("\r")]
        if alone and any(line.endswith("\n") for line in closing):
            message = "a carriage return stands alone in a file whose lines end otherwise."
            raise _MisfitError(0, message, file=file, row=first_row + ends[alone[0]] - 1, hint=hint)
    return cells, rows


def _misplaced(text: str, delimiter: str, quoting: Quoting) -> str | None:
    """Return what stands before a misplaced quote; the csv module takes quotes anywhere in a cell."""
    pieces = text.split('"')
    stops = (delimiter, "\r", "\n")
    for at in range(0, len(pieces), 2):
        piece, first, last = pieces[at], at == 0, at == len(pieces) - 1
        begins, ends = first or piece.startswith(stops), last or piece.endswith(stops)
        doubled = not piece and (first or last or quoting == "doubled")
        if "\0" in piece or not ((begins and ends) or doubled):
            return '"'.join(pieces[: at + begins])
    return None


def _join(pieces: list[str], delimiter: str) -> list[str]:
    """Put a line's pieces together again where PsychoPy's quotes wrap a cell that holds the delimiter."""
    if not any('"' in piece for piece in pieces):
        return pieces
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
