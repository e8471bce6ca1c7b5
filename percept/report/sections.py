"""What a page is made of: sections of sentences, tables and figures. Nothing is written here yet.

A table is defined once. The page, LaTeX and Word show its cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

from percept.report.numbers import digits_of

__all__ = [
    "NOTHING", "Cell", "Columns", "Plot", "Section", "Table", "Value", "ends", "of", "plus_minus",
    "table_of", "value", "with_limits",
]  # fmt: skip


@dataclass(frozen=True)
class Value:
    """A number of the results, by the way to it from a record."""

    record: object
    steps: tuple[str | int, ...]
    digits: int = 5
    style: str = "plain"

    @property
    def exact(self) -> Any:
        """Return what stands there; None where a record on the way is missing."""
        found: Any = self.record
        for step in self.steps:
            if isinstance(found, Mapping):
                found = found.get(str(step))
            elif isinstance(found, tuple) and isinstance(step, int):
                found = found[step]
            else:
                found = getattr(found, str(step), None)
        return found


#: A cell of a table: texts and numbers, one after the other.
Cell: TypeAlias = tuple[str | Value, ...]
NOTHING: Cell = ("–",)
#: What makes the cells of a table of records, by head.
Columns: TypeAlias = dict[str, Callable[[Any], Cell | str]]


@dataclass(frozen=True)
class Table:
    """A table."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    name: str = ""  # Of its files; empty for a table that has none
    csv: str = ""  # Name of the file with every digit, and with what the table leaves out
    ids: Sequence[str] = ()  # Of the rows, where something on the page leads to them


class Plot(NamedTuple):
    """A figure that is drawn."""

    title: str  # What it shows, in a few words
    description: str  # What a reader who cannot see it should know
    size: tuple[float, float]  # Width and height, mm
    svg: str  # ``<svg>`` element for a page
    formats: tuple[str, ...]  # Of the files written


@dataclass(frozen=True)
class Section:
    """A part of a page; without sentences, tables, figures and parts it does not appear."""

    name: str  # Its id on the page
    title: str
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[str] = ()  # Names of drawings
    parts: Sequence[Section] = ()
    form: Literal["text", "list", "warning", "paste", "code", "curves"] = "text"
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


def value(record: object, *steps: str | int, digits: int = 5, style: str = "plain") -> Cell:
    """Return the cell of a number."""
    return (Value(record, steps, digits, style),)


def of(path: str, digits: int = 5, style: str = "plain") -> Callable[[Any], Cell]:
    """Return what makes the cell of a record's number, or of its text."""
    steps = tuple(path.split("."))

    def cell(record: object) -> Cell:
        found = Value(record, steps, digits, style)
        if isinstance(found.exact, str):
            return (found.exact,)
        return NOTHING if found.exact is None else (found,)

    return cell


def plus_minus(path: str, error: str, digits: int = 3, style: str = "percent") -> Any:
    """Return what makes the cell of a number and its Monte Carlo error; of none, without it."""
    number = of(path, digits, style)
    its_error = of(error, 2, style)

    def cell(record: object) -> Cell:
        shown = its_error(record)
        size = shown[0].exact if isinstance(shown[0], Value) else None
        return (*number(record), " ± ", *shown) if size else number(record)

    return cell


def with_limits(
    record: Any, middle: str = "estimate", *, style: str = "plain", least: int = 2
) -> Cell:
    """Return the cell of an estimate, its limits in brackets."""
    digits = max(digits_of(getattr(record, middle), record.lower, record.upper), least)
    return (
        *value(record, middle, digits=digits, style=style),
        " (",
        *ends(record, style=style),
        ")",
    )


def ends(record: Any, lower: str = "lower", upper: str = "upper", *, style: str = "plain") -> Cell:
    """Return the cell of two limits."""
    low = getattr(record, lower)
    high = getattr(record, upper)
    return (
        *value(record, lower, digits=digits_of(low, low, high), style=style),
        " to ",
        *value(record, upper, digits=digits_of(high, low, high), style=style),
    )


def table_of(
    caption: str,
    records: Iterable[Any],
    columns: Mapping[str, Callable[[Any], Cell | str]],
    **given: Any,
) -> Table:
    """Return a table with a row for each record, and a column for each head."""
    rows = []
    for record in records:
        cells = [column(record) for column in columns.values()]
        rows.append([(cell,) if isinstance(cell, str) else cell for cell in cells])
    return Table(caption, tuple(columns), rows, **given)
