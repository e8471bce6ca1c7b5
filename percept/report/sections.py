"""What a page is made of: sections of sentences, tables and figures. Nothing is written here yet.

A table is defined once. The page, LaTeX and Word show its cells; CSV has the records it is made of.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

from percept.report.basics import METHOD_NAMES, digits_of, is_known, matching, written


@dataclass(frozen=True)
class Value:
    """A number, and how it is shown."""

    exact: float
    digits: int = 5
    style: str = "plain"

    @property
    def text(self) -> str:
        """The number as a reader sees it."""
        return written(self.exact, self.digits, self.style)


#: A cell of a table: texts and numbers, one after the other.
Cell: TypeAlias = tuple[str | Value, ...]
NOTHING: Cell = ("–",)
#: What makes the cells of a table, by head.
Columns: TypeAlias = dict[str, Callable[[Any], Cell | str]]


class Table(NamedTuple):
    """A table; without rows it does not appear."""

    caption: str = ""
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[Cell]] = ()
    name: str = ""  # Of its LaTeX and Word; empty for a table that has none
    csv: str = ""  # Name of the file with every digit, and with what the table leaves out


class Plot(NamedTuple):
    """A figure that is drawn."""

    title: str  # What it shows, in a few words
    description: str  # What a reader who cannot see it should know
    svg: str  # ``<svg>`` element for a page
    formats: tuple[str, ...]  # Of the files written


@dataclass(frozen=True)
class Section:
    """A part of a page; without sentences, tables, figures and parts it does not appear."""

    name: str  # Its id on the page
    title: str = ""
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[str] = ()  # Names of drawings
    parts: Sequence[Section] = ()
    form: Literal["text", "list", "warning", "paste", "curves"] = "text"
    is_folded: bool = False

    @property
    def filled(self) -> bool:
        """Whether there is anything to show."""
        return bool(
            any(self.sentences)
            or any(table.rows for table in self.tables)
            or self.figures
            or any(part.filled for part in self.parts)
        )


def value(exact: float | None, digits: int = 5, style: str = "plain") -> Cell:
    """Return the cell of a number."""
    return NOTHING if exact is None else (Value(exact, digits, style),)


def of(path: str, digits: int = 5, style: str = "plain") -> Callable[[Any], Cell | str]:
    """Return what makes the cell of a record's number, or of its text."""

    def cell(record: object) -> Cell | str:
        found: Any = record
        for name in path.split("."):
            found = getattr(found, name, None)
        return found if isinstance(found, str) else value(found, digits, style)

    return cell


def plus_minus(path: str, error: str, digits: int = 3, style: str = "percent") -> Any:
    """Return what makes the cell of a number and its Monte Carlo error; of none, without it."""
    number = of(path, digits, style)
    its_error = of(error, 2, style)

    def cell(record: object) -> Cell | str:
        shown = its_error(record)
        has_error = isinstance(shown[0], Value) and shown[0].exact
        return (*number(record), " ± ", *shown) if has_error else number(record)

    return cell


def limits(record: Any) -> Cell:
    """Return the cell of a record's two limits."""
    if not is_known(record.lower, record.upper):
        return ("not known",)
    lower = value(record.lower, digits_of(record.lower, record.lower, record.upper))
    upper = value(record.upper, digits_of(record.upper, record.lower, record.upper))
    return (*lower, " to ", *upper)


def estimate(record: Any, style: str = "plain", least: int = 2) -> Cell:
    """Return the cell of a record's estimate, its limits in brackets."""
    digits = max(digits_of(record.estimate, record.lower, record.upper), least)
    middle = value(record.estimate, digits, style)
    if not is_known(record.lower, record.upper):
        return (*middle, " (not known)")
    lower = value(record.lower, digits, style)
    upper = value(record.upper, digits, style)
    return (*middle, " (", *lower, " to ", *upper, ")")


def table_of(caption: str, rows: Iterable[Any], columns: Columns, **names: str) -> Table:
    """Return a table with a row for each record or name; columns of dashes do not appear."""
    rows = list(rows)
    cells = {head: [column(row) for row in rows] for head, column in columns.items()}
    heads = [head for head, found in cells.items() if any(cell != NOTHING for cell in found)]
    lines = []
    for index in range(len(rows)):
        line = [cells[head][index] for head in heads]
        lines.append([(cell,) if isinstance(cell, str) else cell for cell in line])
    return Table(caption, heads, lines, **names)


def column(
    records: Sequence[Any], down: str, cell: Callable[[Any], Cell | str]
) -> Callable[[Any], Cell | str]:
    """Return what makes the cell of the record that has a row's name in a field."""
    by_name = {getattr(record, down): record for record in reversed(records)}
    return lambda name: cell(by_name[name]) if name in by_name else NOTHING


def side_by_side(
    records: Sequence[Any], down: str, across: Sequence[str], cell: Callable[[Any], Cell | str]
) -> Columns:
    """Return a column for each combination of some fields; rows are the values of another field."""
    columns: Columns = {}
    for combination in dict.fromkeys(tuple(getattr(r, name) for name in across) for r in records):
        own = matching(records, **dict(zip(across, combination, strict=True)))
        head = ", ".join(METHOD_NAMES.get(text, text) for text in combination)
        columns[head] = column(own, down, cell)
    return columns
