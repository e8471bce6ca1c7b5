"""What all of a report is made with: records found, numbers written, sections and their tables.

A table is defined once. The page, LaTeX and Word show its cells; CSV has the records it is made of.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from operator import attrgetter
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

from percept.results import IntervalRow, Results
from percept.sessions.quantities import IMPEDANCE

R = TypeVar("R")

KINDS = ("mean", "user", "share")
METHODS = ("classical", "bayesian")
METHOD_NAMES = {"classical": "classical", "bayesian": "Bayesian"}
#: Joint treatments that the page shows: k and b each at the level asked for, or drawn together.
_UNWIDENED = ("marginal", "joint")


def makes_impedance(results: Results) -> bool:
    """Say whether the quantities make an impedance, so that haptic terms apply."""
    return results.data.quantities.keys() <= IMPEDANCE.keys()


def gives_means(results: Results) -> bool:
    """Say whether nothing was matched, so that biases from zero are the means themselves."""
    return not any(quantity.is_matched for quantity in results.data.quantities.values())


def without_ratios(intervals: Iterable[IntervalRow]) -> set[str]:
    """Return parameters with a reference of zero or below: their bias is no fraction of it."""
    return {
        row.parameter for row in intervals if row.reference is not None and not row.reference > 0
    }


def title_of(results: Results) -> str:
    """Return the title of the page where the scene gives none."""
    if makes_impedance(results):
        return "Realistic performance boundaries"
    labels = [quantity.label for quantity in results.data.quantities.values()]
    return f"Intervals of {listed(labels)}"


def family_of(results: Results) -> str:
    """Return the family of the study's own model."""
    return str(results.provenance.scene["inference"]["family"])


def families_from(family: str) -> tuple[str, ...]:
    """Return the families in order of preference, a study's own first."""
    return tuple(dict.fromkeys((family, "lognormal", "normal")))


def distinct(records: Iterable[Any], name: str) -> list[Any]:
    """Return the different values of a field, in order of first appearance."""
    return list(grouped(records, name))


def grouped(records: Iterable[R], *names: str) -> dict[Any, list[R]]:
    """Return records by the values of one field or more, in the order they first appear."""
    key_of = attrgetter(*names)
    groups: dict[Any, list[R]] = {}
    for record in records:
        groups.setdefault(key_of(record), []).append(record)
    return groups


def matching(records: Iterable[R], **wanted: object) -> list[R]:
    """Return the records whose fields have these values."""
    return [
        record
        for record in records
        if all(getattr(record, name) == value for name, value in wanted.items())
    ]


def unwidened(records: Iterable[R]) -> list[R]:
    """Return the records that the page shows: not widened so that k and b hold together."""
    return [record for record in records if getattr(record, "joint", "") in _UNWIDENED]


def present(names: Iterable[str], records: Iterable[Any], field: str) -> list[str]:
    """Return the names that some record has, in their order."""
    found = distinct(records, field)
    return [name for name in names if name in found]


def best(records: Sequence[R], families: Sequence[str]) -> R:
    """Return the record of the Bayesian method, if there is one, in the family preferred."""

    def rank(record: Any) -> tuple[bool, int]:
        return record.method != "bayesian", families.index(record.family)

    return min(records, key=rank)


SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: A bias of so many references and more is written as a multiple.
_MULTIPLE = 9.0
#: An upper limit over the lower one beyond which the two say nothing.
_UNKNOWN = 1e10
#: Environments that a sentence names; more are counted.
MOST_NAMED = 5


def rounded(value: float, digits: int = 5) -> str:
    """Write a number to significant digits, as a power of ten where very large or small."""
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if -4 <= power < max(digits, 6):
        # Decimal, because rounding to a count of decimals would round the rounded once more.
        text = f"{Decimal(f'{mantissa}e{power}'):f}"
    else:
        text = f"{mantissa} × 10{str(power).translate(SUPERSCRIPT)}"
    return text.replace("-", "−")


def short(value: float, digits: int = 3) -> str:
    """Write a number to significant digits, without zeros at its end."""
    mantissa, times, power = rounded(value, digits).partition(" ×")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").removesuffix(".")
    return mantissa + times + power


def is_known(lower: float, upper: float) -> bool:
    """Say whether limits are informative: positive ones span ten decades at most."""
    return not 0.0 < _UNKNOWN * lower < upper


def bracketed(unit: str) -> str:
    """Write a unit in brackets, to follow a name; nothing for a pure number."""
    return f" ({unit})" if unit else ""


def percentage(value: float, digits: int = 3) -> str:
    """Write a fraction as a percentage, "< 0.1 %" where it is less."""
    if 0 < value < 0.001:
        return "< 0.1\u202f%"
    return f"{short(100 * value, digits)}\u202f%"


def _bias(value: float) -> str:
    """Write how far something lies from its reference: +38 %, −7.1 %, or 254 times as high."""
    if value >= _MULTIPLE:
        return f"{short(1 + value, 3)} times"
    sign = "+" if value > 0 else ""
    if abs(value) < 0.001:
        # The sign may decide, so that no bias is written as less than something.
        return f"{sign}{short(100 * value, 2)}\u202f%"
    # Whole percents at least.
    return sign + percentage(value, 2 if abs(value) < 0.995 else 3)


def written(value: float | None, digits: int = 5, style: str = "plain") -> str:
    """Write a number in a style, a dash where there is none."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return rounded(value)
    if style == "ratio":
        return short(math.exp(value), digits)
    if style == "count":
        return f"{value:,}".replace(",", "\u202f")
    if style == "short":
        # Somebody chose these digits.
        return f"{value:.10g}".replace("-", "−")
    if style == "bias":
        return _bias(value)
    if style == "percent":
        return percentage(value, digits)
    sign = "+" if style == "difference" and value > 0 else ""
    return sign + short(value, digits)


def digits_of(record: Any, least: int = 2) -> int:
    """Return the digits worth reading: to about a hundredth of an interval's half-width."""
    width = record.upper - record.lower
    size = abs(record.estimate)
    if not (0.0 < width < math.inf and 0.0 < size < math.inf):
        return 4
    return min(max(math.ceil(math.log10(size / (0.005 * width))), least), 6)


@dataclass(frozen=True)
class Estimated:
    """An estimate and its limits, which sentences write with the same digits and unit."""

    estimate: float
    lower: float
    upper: float
    unit: str = ""
    style: str = "plain"
    least_digits: int = 2

    def text(self, number: float, style: str = "") -> str:
        """Write a number with its unit."""
        digits = digits_of(self, self.least_digits)
        text = written(number, digits, style or self.style).replace("\u202f", " ")
        return f"{text} {self.unit}".rstrip()

    @property
    def limits(self) -> str:
        """Both limits; a unit that they share stands once."""
        lower = self.text(self.lower)
        upper = self.text(self.upper)
        for unit in (" %", f" {self.unit}"):
            if upper.endswith(unit):
                lower = lower.removesuffix(unit)
        return f"{lower} to {upper}"


def listed(names: Sequence[str], most: int = 10**6) -> str:
    """Join names with commas and a final "and"; count those beyond the first few."""
    if len(names) > most:
        names = [*names[:most], f"{len(names) - most} more"]
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def possessive(nouns: str) -> str:
    """Write what belongs to several: the subjects’, the children’s."""
    return f"{nouns}’" if nouns.endswith("s") else f"{nouns}’s"


def spanned(sizes: Sequence[float], texts: Sequence[str]) -> str:
    """List sizes; of many only the smallest and the largest, and equal ones once."""
    if len(set(texts)) == 1:
        return texts[0]
    if len(texts) <= MOST_NAMED:
        return listed(texts)
    by_size = [text for _, text in sorted(zip(sizes, texts, strict=True))]
    return f"{by_size[0]} to {by_size[-1]}"


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
    csv: str = ""  # File with every digit and what the table leaves out, where not called `name`


class Plot(NamedTuple):
    """A figure that is drawn."""

    title: str  # What it shows, in a few words
    description: str  # What a reader who cannot see it should know
    image: str  # SVG, in base64
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
            found = found[int(name)] if name.isdigit() else getattr(found, name, None)
        return found if isinstance(found, str) else value(found, digits, style)

    return cell


def plus_minus(path: str, error: str, style: str = "percent") -> Any:
    """Return what makes the cell of a number and its Monte Carlo error, if it has one."""
    number = of(path, 3, style)
    its_error = of(error, 2, style)

    def cell(record: object) -> Cell | str:
        shown = its_error(record)
        has_error = isinstance(shown[0], Value) and shown[0].exact
        return (*number(record), " ± ", *shown) if has_error else number(record)

    return cell


def limits(record: Any, style: str = "plain", least: int = 2) -> Cell:
    """Return the cell of a record's two limits."""
    if not is_known(record.lower, record.upper):
        return ("not known",)
    digits = digits_of(record, least)
    return (*value(record.lower, digits, style), " to ", *value(record.upper, digits, style))


def estimate(record: Any, style: str = "plain", least: int = 2) -> Cell:
    """Return the cell of a record's estimate, its limits in brackets."""
    middle = value(record.estimate, digits_of(record, least), style)
    return (*middle, " (", *limits(record, style, least), ")")


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
    records: Sequence[Any], down: str | Sequence[str], cell: Callable[[Any], Cell | str]
) -> Callable[[Any], Cell | str]:
    """Return what makes the cell of the record that has a row's name, or names, in some fields."""
    name_of = attrgetter(*([down] if isinstance(down, str) else down))
    by_name = {name_of(record): record for record in reversed(records)}
    return lambda name: cell(by_name[name]) if name in by_name else NOTHING


def side_by_side(
    records: Sequence[Any],
    down: str | Sequence[str],
    across: Sequence[str],
    cell: Callable[[Any], Cell | str],
) -> Columns:
    """Return a column for each combination of some fields; rows are the values of others."""
    groups: dict[str, list[Any]] = {}
    for record in records:
        texts = [getattr(record, name) for name in across]
        head = ", ".join(METHOD_NAMES.get(text, text) for text in texts)
        groups.setdefault(head, []).append(record)
    return {head: column(group, down, cell) for head, group in groups.items()}
