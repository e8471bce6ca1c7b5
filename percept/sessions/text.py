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
from typing import Literal

from percept.errors import UsageError
from percept.sessions.grid import Grid, LayoutError, Rows, refuse_aligned
from percept.sessions.records import clip

Quoting = Literal["doubled", "backslash", "wrapped"]

_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "space"}
_SEP_LINE = re.compile(r'"?sep=(.)"?[ ]*(?:\r\n|\n|\r)', re.IGNORECASE)
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_HALF = re.compile("[\ud800-\udfff]")
_BYTE_ORDER_MARK = "\ufeff"
#: Characters at the beginning of a text that tell its dialect, and of a cell with a mouse track.
_BEGINNING = 1 << 19
_LONGEST_CELL = 1 << 24
_QUOTES_HINT = "Write the table again as CSV with quotes doubled."
# csv's own limit of 128 kB is below what mouse tracks take.
csv.field_size_limit(max(csv.field_size_limit(), _LONGEST_CELL))


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
                fits.append(Grid(records, file, sign, fewest=2))
                break
            except UsageError as misfit:
                # The delimiter meant splits the text most, and the quoting meant gets farthest.
                named = isinstance(misfit, LayoutError)
                misfits.append((named, beginning.count(sign), misfit.row or 0, misfit))
    # Under a delimiter that is none, a row with one in a cell would look like a header.
    least = min((grid.skipped for grid in fits), default=0)
    fits = [grid for grid in fits if grid.skipped == least]
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
