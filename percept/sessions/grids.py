"""Files to cells of text, under the one dialect in which every line has as many."""

from __future__ import annotations

import csv
import io
import re
from bisect import bisect
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, TextIO

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions import files
from percept.sessions.records import NoDataError, clip
from percept.sessions.values import LARGEST, LEAST

Quoting = Literal["doubled", "backslash", "wrapped"]

_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar"}
_SEP_LINE = re.compile(r'"?sep=(.)"?[ ]*(?:\r\n|\n|\r)', re.IGNORECASE)
_MARK = "\ufeff"
#: A header of more cells is no session table's; the bound keeps hostile lines cheap.
_CELLS = 20_000
#: The dialect of a file is found from about as many characters.
_HEAD = 1 << 18
#: The pandas parser rounds correctly by default since 3.1; before, it had to be asked.
_EXACT: Any = None if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else "round_trip"
# Cells hold recordings of mouse tracks, beyond the module's 128 kB; a block bounds them.
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
        names = self.names[:-1] if not self.names[-1].strip() else self.names
        return [name.strip() or f"column {at}" for at, name in enumerate(names, 1)]


@dataclass(frozen=True)
class Grid:
    """A rectangular stretch of a table of text."""

    header: list[str]
    cells: (
        pd.DataFrame
    )  # Texts of the data records; columns by position, the index is the physical line
    dropped: Counter[str]  # Records left out as no data, by reason

    @classmethod
    def of(
        cls, dialect: Dialect, records: list[list[str]], rows: list[int], *, last: bool = True
    ) -> Grid:
        """Drop what is no data; hold the rest to one width, but for one empty trailing column."""
        dropped = Counter[str]()
        kept: list[int] = []
        for at, record in enumerate(records):
            text = "".join(record).strip()
            if tuple(record) == dialect.names:
                dropped["repeated header"] += 1
            elif not text:
                dropped["blank line"] += 1
            elif last and at == len(records) - 1 and text == "END OF FILE":
                dropped["end-of-file mark"] += 1
            else:
                kept.append(at)
        header, named = dialect.header, len(dialect.names)
        width, columns = dialect.width or (len(records[kept[0]]) if kept else named), len(header)
        for at in kept:
            record = records[at]
            if len(record) != width or not columns <= width <= columns + 1 or any(record[columns:]):
                message = f"{len(record)} cells where the header has {named}"
                message += f" and the lines above have {width}." if len(record) != width else "."
                hint = "Mend this line, or the quoting of a cell in it."
                if len(record) == named + 1:
                    hint += " Decimal commas need quotes; R's write.table needs col.names = NA."
                value = clip(dialect.delimiter.join(record))
                raise UsageError(message, file=dialect.file, row=rows[at], value=value, hint=hint)
        lines, cells = [rows[at] for at in kept], [records[at][:columns] for at in kept]
        return cls(
            header, pd.DataFrame(cells, index=lines, columns=range(columns), dtype=object), dropped
        )


@dataclass
class Block:
    """A stretch of a table: split into cells, or a text to be split."""

    dialect: Dialect
    split: Grid | None = None
    text: str = ""
    first_row: int = 1
    last: bool = True

    def grid(self) -> Grid:
        """Split the text."""
        if self.split is None:
            cells, rows = _records(self.text, self.dialect, self.first_row)
            self.split = Grid.of(self.dialect, cells, rows, last=self.last)
        return self.split

    def plain(self, texts: list[int], numbers: list[int], mark: str) -> pd.DataFrame | None:
        """Read columns of a text without quotes by pandas' parser; None where cells need a closer look.

        The parser takes what percept refuses: lines of any width, infinity, "True" for 1, numbers
        too small for a double. It refuses words, and so every header and mark between the data.
        """
        delimiter, width = self.dialect.delimiter, self.dialect.width
        text = self.text.replace("\r\n", "\n") if "\r" in self.text else self.text
        if (
            self.split
            or not delimiter.isascii()
            or any(sign in text for sign in ('"', "\r", _MARK))
        ):
            return None
        body = text.encode() + (b"" if text.endswith("\n") else b"\n")
        characters = np.frombuffer(body, dtype=np.uint8)
        ends_line = characters == ord("\n")
        ends = ends_line[ends_line | (characters == ord(delimiter))]
        if (
            len(ends) % width
            or not ends[width - 1 :: width].all()
            or ends.sum() * width != len(ends)
        ):
            return None
        lowered = body.lower()
        if b"true" in lowered or b"false" in lowered:
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
        found = parsed[numbers].to_numpy()
        if np.isnan(found).all(axis=1).any():
            return None
        sizes = np.abs(found)
        # A zero may have been a number below the least double.
        small = sizes.min(initial=LARGEST, where=found != 0) < LEAST or (
            b"e-" in lowered and (found == 0).any()
        )
        if small or (sizes > LARGEST).any():
            return None
        parsed.index = pd.RangeIndex(self.first_row, self.first_row + len(parsed))
        return parsed


def text_blocks(
    stream: TextIO, *, file: str, delimiter: str | None, resolves: Callable[[list[str]], bool]
) -> Iterator[Block]:
    """Find the dialect of a text, and cut it into stretches of whole records."""
    with stream:
        text, first_row = _stretch(stream, file, _HEAD), 1
        if sep := _SEP_LINE.match(text):
            delimiter = delimiter or sep[1]
            text, first_row = text[sep.end() :], 2
        text = text.lstrip(_MARK)
        line = re.split("[\r\n]", text, maxsplit=1)[0]
        following = _stretch(stream, file, files.BLOCK)
        block = Block(Dialect(file), None, _without_marks(text, line), first_row, not following)
        block.dialect, block.split = _find_dialect(block, delimiter, resolves)
        yield block
        while following:
            first_row += files.line_ends(text)
            text, following = following, _stretch(stream, file, files.BLOCK)
            yield Block(block.dialect, None, _without_marks(text, line), first_row, not following)


def _stretch(stream: TextIO, file: str, size: int) -> str:
    """Read about `size` characters up to the end of a record."""
    lines = [stream.read(size), stream.readline(size)]
    if len(lines[1]) >= size:
        hint = "This is no session table, or its line ends are lost."
        raise UsageError(f"a line of more than {size} characters.", file=file, hint=hint)
    # A quoted cell may hold line ends: a record ends where quotes are even, escaped ones too.
    quotes, escaped = (sum(line.count(sign) for line in lines) for sign in ('"', '\\"'))
    length = 0
    while (quotes % 2 or escaped % 2) and length < size and (line := stream.readline(size)):
        lines.append(line)
        quotes, escaped, length = (
            quotes + line.count('"'),
            escaped + line.count('\\"'),
            length + len(line),
        )
    return "".join(lines)


def _without_marks(text: str, line: str) -> str:
    """Drop the byte-order mark that an appending writer puts before each repeated header."""
    if _MARK not in text:
        return text
    return re.sub(f"(^|[\r\n]){_MARK}(?={re.escape(line)})", r"\1", text)


def _find_dialect(
    block: Block, delimiter: str | None, resolves: Callable[[list[str]], bool]
) -> tuple[Dialect, Grid]:
    """Find the one dialect that fits a text with its header, and split it."""
    file, text = block.dialect.file, block.text
    head = next((line for line in text.splitlines() if line.strip()), "")
    fits: list[tuple[Dialect, Grid]] = []
    misfits: list[tuple[int, UsageError]] = []
    for candidate in [delimiter] if delimiter else [d for d in _DELIMITERS if d in text]:
        for quoting in _quotings(text):
            tried = Dialect(file, candidate, quoting)
            try:
                fits.append(_with_header(block, tried))
                break
            except UsageError as misfit:
                # The delimiter meant splits the header most, and the quoting meant gets farthest.
                misfits.append((head.count(candidate), misfit))
    if len(fits) > 1:
        fits = [fit for fit in fits if resolves(fit[1].header)] or fits
    if len(fits) == 1:
        return fits[0]
    if fits:
        names = " and ".join(_DELIMITERS[dialect.delimiter] for dialect, _ in fits)
        hint = 'Declare [sessions] delimiter = ";" (or the one that is right).'
        raise UsageError(f"the lines can be split by {names} alike.", file=file, hint=hint)
    if misfits:
        raise max(misfits, key=lambda tried: (tried[0], tried[1].row or 0))[1]
    message = "this is not a table: no comma, semicolon, tab or bar separates its columns."
    hint = "Export it as CSV, or declare [sessions] delimiter."
    raise UsageError(message, file=file, row=block.first_row, hint=hint)


def _quotings(text: str) -> tuple[Quoting, ...]:
    """Conventions to try, in order; PsychoPy's own is tried only on a file that says it is PsychoPy's."""
    if '"' not in text:
        return ("doubled",)
    head = text[: text.find("\n") + 1 or len(text)]
    if "psychopyVersion" in head or "expName" in head:
        return ("wrapped", "doubled")
    return ("doubled", "backslash")


def _with_header(block: Block, tried: Dialect) -> tuple[Dialect, Grid]:
    """Split a text under a dialect, its first line that is not blank being the header."""
    cells, rows = _records(block.text, tried, block.first_row)
    start = next((at for at, record in enumerate(cells) if any(map(str.strip, record))), None)
    if start is None:
        hint = "Leave it out, or export it again."
        raise UsageError("the file has no header.", file=tried.file, hint=hint)
    place: Any = {"file": tried.file, "row": rows[start]}
    if not 2 <= len(cells[start]) <= _CELLS:
        hint = "Correct the header, or declare [sessions] delimiter."
        raise UsageError(f"a header of {len(cells[start])} cells.", hint=hint, **place)
    tried = replace(tried, names=tuple(cells[start]))
    grid = Grid.of(tried, cells[start + 1 :], rows[start + 1 :], last=block.last)
    if grid.cells.empty:
        raise NoDataError(
            "there are no data below the header.", hint="Leave the file out.", **place
        )
    first = rows.index(int(grid.cells.index[0]))
    return replace(tried, width=len(cells[first])), grid


def _records(text: str, dialect: Dialect, first_row: int) -> tuple[list[list[str]], list[int]]:
    """Split a text into records, and give the physical line on which each starts."""
    delimiter, quoting = dialect.delimiter, dialect.quoting
    place: Any = {"file": dialect.file, "hint": "Write the table again as CSV with quotes doubled."}
    if quoting == "backslash":
        # A NUL is refused before, so that it can stand for an escaped quote.
        text = text.replace('\\"', "\0")
    lines = io.StringIO(text, newline="").readlines()
    if quoting == "wrapped":
        cells = [_join(line.rstrip("\r\n").split(delimiter), delimiter) for line in lines]
        ends = list(range(1, len(lines) + 1))
    else:
        cells, ends = [], []
        reader = csv.reader(lines, delimiter=delimiter, strict=True)
        try:
            for record in reader:
                cells.append(record or [""])
                ends.append(reader.line_num)
        except csv.Error:
            unclosed = "a quoted cell is not closed, or text follows its closing quote."
            raise UsageError(unclosed, row=first_row + (ends[-1] if ends else 0), **place) from None
        if quoting == "backslash":
            cells = [[cell.replace("\0", '"') for cell in record] for record in cells]
    closing = [lines[end - 1] for end in ends] if "\r" in text else []
    alone = [at for at, line in enumerate(closing) if line.endswith("\r")]
    if alone and any(line.endswith("\n") for line in closing):
        message = "a carriage return stands alone in a file whose lines end otherwise."
        raise UsageError(message, row=first_row + ends[alone[0]] - 1, **place)
    return cells, [first_row + end for end in (0, *ends)][: len(cells)]


def _join(pieces: list[str], delimiter: str) -> list[str]:
    """Put a line's pieces together again where PsychoPy's quotes wrap a cell that holds the delimiter."""
    closing = [at for at, piece in enumerate(pieces) if piece.endswith('"')]
    cells: list[str] = []
    at = 0
    while at < len(pieces):
        piece, last, after = pieces[at], at, bisect(closing, at)
        # A cell quoted at both ends without a delimiter inside was not quoted by the writer: it
        # stays.
        whole = len(piece) > 1 and piece.endswith('"')
        if piece.startswith('"') and not whole and after < len(closing):
            last = closing[after]
        cells.append(delimiter.join(pieces[at : last + 1])[1:-1] if last > at else piece)
        at = last + 1
    return cells
