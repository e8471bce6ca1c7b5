"""One dialect per file: the delimiter and quoting under which every line has the same number of cells."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from percept.errors import UsageError
from percept.sessions.problems import clip
from percept.sessions.tokens import Quoting, Records, SplitError, tokenise

_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar"}
_SEP_LINE = re.compile(r'"?sep=(.)"?[ ]*(?:\r\n|\n|\r)', re.IGNORECASE)
_FIRST_LINE = re.compile(r"[^\r\n]*")
_MARK = "\ufeff"
_END_OF_FILE = "END OF FILE"


@dataclass(frozen=True)
class Dialect:
    """How a file separates and quotes its cells."""

    delimiter: str
    quoting: Quoting


@dataclass(frozen=True)
class Grid:
    """A rectangular table of text."""

    header: list[str]  # Column names, without surrounding space
    cells: list[list[str]]  # Data records, each as long as `header`
    rows: list[int]  # Physical line of each data record
    dialect: Dialect
    dropped: dict[str, int]  # Records left out as no data, by reason


def read_grid(text: str, *, file: str, delimiter: str | None, resolves: Callable[[list[str]], bool]) -> Grid:
    """Find the one dialect that fits a text, and split it."""
    first_row = 1
    sep = _SEP_LINE.match(text)
    if sep:
        delimiter = delimiter or sep[1]
        text = text[sep.end() :]
        first_row = 2
    text = _without_marks(text)
    if not text.strip():
        raise UsageError("the file has no header.", file=file, hint="Leave it out, or export it again.")
    candidates = [delimiter] if delimiter else [d for d in _DELIMITERS if d in text]
    fits: list[Grid] = []
    failures: list[tuple[int, UsageError]] = []
    for candidate in candidates:
        try:
            fits.append(_split(text, candidate, file, first_row))
        except _Misfit as misfit:
            failures.append((misfit.width, misfit.error))
    if len(fits) > 1:
        named = [grid for grid in fits if resolves(grid.header)]
        fits = named or fits
    if len(fits) == 1:
        return fits[0]
    if fits:
        names = " and ".join(_DELIMITERS.get(g.dialect.delimiter, g.dialect.delimiter) for g in fits)
        raise UsageError(
            f"the lines can be split by {names} alike.",
            file=file,
            hint='Declare [sessions] delimiter = ";" (or the one that is right).',
        )
    if failures:
        raise max(failures, key=lambda failure: failure[0])[1]
    raise UsageError(
        "this is not a table: no comma, semicolon, tab or bar separates its columns.",
        file=file,
        row=first_row,
        hint="Export it as CSV, or declare [sessions] delimiter.",
    )


def _without_marks(text: str) -> str:
    """Drop the byte-order mark that an appending writer puts before each repeated header."""
    if _MARK not in text:
        return text
    text = text.lstrip(_MARK)
    header = _FIRST_LINE.match(text)
    line = header[0] if header else ""
    for end in ("\n", "\r"):
        text = text.replace(f"{end}{_MARK}{line}", f"{end}{line}")
    return text


def split_plain(text: str, header: Sequence[str], *, delimiter: str, file: str, first_row: int) -> Grid:
    """Split a stretch of a file without quotes, below a header that is known."""
    records = tokenise(text, delimiter=delimiter, quoting="plain", first_row=first_row)
    cells, rows = [list(header), *records.cells], [1, *records.rows]
    try:
        return _rectangle(Records(cells, rows), Dialect(delimiter, "plain"), file)
    except _Misfit as misfit:
        raise misfit.error from None


class _Misfit(Exception):  # noqa: N818 - a control value between two functions, never shown
    """A delimiter that does not fit; `width` is the number of header cells it gave."""

    def __init__(self, width: int, error: UsageError) -> None:
        super().__init__(str(error))
        self.width = width
        self.error = error


def _split(text: str, delimiter: str, file: str, first_row: int) -> Grid:
    failure: _Misfit | None = None
    for quoting in _quotings(text):
        try:
            records = tokenise(text, delimiter=delimiter, quoting=quoting, first_row=first_row)
        except SplitError as error:
            hint = "Write the table again as CSV with quotes doubled."
            problem = UsageError(error.message + ".", file=file, row=error.row, hint=hint)
            failure = failure or _Misfit(0, problem)
            continue
        try:
            return _rectangle(records, Dialect(delimiter, quoting), file)
        except _Misfit as misfit:
            failure = failure if failure and failure.width >= misfit.width else misfit
    assert failure is not None  # no split is tried that neither works nor says why
    raise failure


def _quotings(text: str) -> tuple[Quoting, ...]:
    """Conventions to try, in order; PsychoPy's own is tried only on a file that says it is PsychoPy's."""
    if '"' not in text:
        return ("plain",)
    head = text[: text.find("\n") + 1 or len(text)]
    if "psychopyVersion" in head or "expName" in head:
        return ("wrapped", "doubled")
    return ("doubled", "backslash")


def _rectangle(records: Records, dialect: Dialect, file: str) -> Grid:
    """Drop what is no data, and hold every record to the header's width."""
    cells, rows = records.cells, records.rows
    start = next((at for at, record in enumerate(cells) if any(cell.strip() for cell in record)), None)
    if start is None:
        raise _Misfit(0, UsageError("the file has no header.", file=file))
    raw_header = cells[start]
    dropped: dict[str, int] = {}
    kept: list[list[str]] = []
    kept_rows: list[int] = []
    for at in range(start + 1, len(cells)):
        record = cells[at]
        if record == raw_header:
            reason = "repeated header"
        elif any(record) and any(cell.strip() for cell in record):
            if at < len(cells) - 1 or not _is_end_mark(record):
                kept.append(record)
                kept_rows.append(rows[at])
                continue
            reason = "end-of-file mark"
        else:
            reason = "blank line"
        dropped[reason] = dropped.get(reason, 0) + 1
    header = [name.strip() for name in raw_header]
    if len(header) < 2:
        raise _Misfit(1, UsageError("the header has a single cell.", file=file, row=rows[start]))
    grid = Grid(header, kept, kept_rows, dialect, dropped)
    return _trim(grid, file, rows[start])


def _is_end_mark(record: list[str]) -> bool:
    return [cell.strip() for cell in record if cell.strip()] == [_END_OF_FILE]


def _trim(grid: Grid, file: str, header_row: int) -> Grid:
    """Check the widths; one empty trailing column of header, records or both may go."""
    header, cells = grid.header, grid.cells
    width = len(header)
    if not cells:
        raise _Misfit(
            width,
            UsageError(
                "there are no data below the header.", file=file, row=header_row, hint="Leave the file out."
            ),
        )
    common = len(cells[0])
    odd = next((at for at, record in enumerate(cells) if len(record) != common), None)
    names_end = width - (header[-1] == "")
    fits = odd is None and (
        common in (width, names_end)
        or (common == width + 1 == names_end + 1 and not any(r[-1] for r in cells))
    )
    if not fits:
        wrong = next((at for at, r in enumerate(cells) if len(r) not in (width, names_end)), odd or 0)
        raise _Misfit(
            width,
            UsageError(
                f"{len(cells[wrong])} cells where the header has {width}.",
                file=file,
                row=grid.rows[wrong],
                value=clip(grid.dialect.delimiter.join(cells[wrong])),
                hint="Mend this line, or the quoting of a cell in it.",
            ),
        )
    if common == width + 1:
        cells = [record[:-1] for record in cells]
    elif header[-1] == "" and (common == names_end or all(not record[-1] for record in cells)):
        header = header[:-1]
        cells = [record[:-1] for record in cells] if common == width else cells
    return replace(grid, header=header, cells=cells)
