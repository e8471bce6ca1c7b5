"""What the cells of a column say of its part in a study: evidence from the whole table."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import printable
from percept.sessions.values import CellError, is_missing, pick

__all__ = [
    "Column",
    "agreement",
    "counts_up",
    "is_designed",
    "is_moment",
    "nearness",
    "steadiness",
    "table_columns",
    "varies_within",
]

#: Share of numbers among the different cells of a column of numbers: a slip leaves it one.
_NUMERIC = 0.9
#: Share of rows that rise above the row before them in a column that counts up; it may restart.
_RISING = 0.8
#: Share of those rises that are of one.
_BY_ONE = 0.7
#: Share of different values in a column of moments.
_NEVER_AGAIN = 0.9
#: More different values than these are nobody's design; the bound keeps cross tables small.
_MOST_LEVELS = 400
#: Share of subjects that meet a value which the design has, and share of such values.
_DESIGNED = 0.8
#: Ratio of adjustments to references, either way, up to which both have one unit.
_SAME_UNIT = 3.0
#: More different numbers than these are described by their range.
_LISTED_NUMBERS = 20
#: As many equal extremes are seldom a chance: a column of more different numbers piles up there.
_PILED = 3
#: Values that a comment quotes of a column that could stand in another's place.
_QUOTED = 3
#: Keys of a record in JSON cells that are looked at.
_MOST_KEYS = 12
#: Units at the end of a name, and what each is of; k and b are percept's own names.
UNITS = {
    "ms": "duration", "s": "duration", "sec": "duration", "g": "weight", "kg": "weight",
    "mm": "length", "cm": "length", "m": "length", "N": "force", "Hz": "frequency", "dB": "level",
    "deg": "angle", "N/m": "k", "N/mm": "k", "N*s/m": "b", "N·s/m": "b", "Ns/m": "b",
}  # fmt: skip
_BRACKETED_UNIT = re.compile(r"[(\[]\s*([^)\]]+?)\s*[)\]]\s*$")
_PLAIN_NUMBER = re.compile(r"[+-]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?")
_Codes = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a whole table, by its name and its cells."""

    name: str
    cells: pd.Series[str]

    @cached_property
    def texts(self) -> list[str]:
        """Different cells that are not blank, in the order they appear."""
        stripped = (cell.strip() for cell in self.cells.unique())
        return [text for text in dict.fromkeys(stripped) if not is_missing(text)]

    @cached_property
    def codes(self) -> _Codes:
        """A whole number for each different cell, by row."""
        codes, _ = pd.factorize(self.cells.str.strip())
        return codes

    @cached_property
    def numbers(self) -> npt.NDArray[np.float64]:
        """Numbers by row, NaN in cells without one."""
        read = {text: _number(text) for text in self.texts}
        return np.array(self.cells.str.strip().map(read), dtype=np.float64)

    @cached_property
    def is_numeric(self) -> bool:
        """Whether it is a column of numbers, but for a few slips."""
        numeric = [text for text in self.texts if not math.isnan(_number(text))]
        return len(numeric) > 0 and len(numeric) >= _NUMERIC * len(self.texts)

    @property
    def is_whole(self) -> bool:
        """Whether all its numbers are whole."""
        known = self.numbers[~np.isnan(self.numbers)]
        return self.is_numeric and bool((known == np.round(known)).all())

    @property
    def ends(self) -> tuple[float, float] | None:
        """Least and largest number where values pile up at one of them, as at a control's ends."""
        known = self.numbers[~np.isnan(self.numbers)]
        # Of a scale with a few steps each step has many values.
        if len(self.texts) <= _LISTED_NUMBERS:
            return None
        lower = float(known.min())
        upper = float(known.max())
        at_ends = max((known == lower).sum(), (known == upper).sum())
        return (lower, upper) if at_ends >= _PILED and lower >= 0 else None

    @cached_property
    def unit(self) -> str | None:
        """Unit that the name gives."""
        if bracket := _BRACKETED_UNIT.search(self.name):
            return bracket[1]
        words = self._name_words
        return words[-1] if len(words) > 1 and words[-1] in UNITS else None

    @cached_property
    def words(self) -> list[str]:
        """Words of the name without its unit, in lower case."""
        words = self._name_words
        if len(words) > 1 and words[-1] in UNITS and not _BRACKETED_UNIT.search(self.name):
            words = words[:-1]
        return [word.casefold() for word in words]

    @property
    def _name_words(self) -> list[str]:
        stem = _BRACKETED_UNIT.sub("", self.name)
        # A capital begins a word, but in "level_dB".
        spaced = re.sub(r"(?<=[a-z0-9])(?<![^a-zA-Z]d)(?=[A-Z])", " ", stem)
        return re.findall(r"[^\W_]+", spaced)

    def quoted(self, most: int = _QUOTED) -> str:
        """Its first values, for a comment."""
        listed = ", ".join(self.texts[:most])
        more = " …" if len(self.texts) > most else ""
        return printable(f"{listed}{more}")[:60]

    def seen(self) -> str:
        """Say what it holds, for a comment."""
        if self.is_numeric and len(self.texts) > _LISTED_NUMBERS:
            ends = f"{np.nanmin(self.numbers):g} to {np.nanmax(self.numbers):g}"
            return f"{ends}: {self.quoted()}"
        if not self.texts:
            return "empty"
        if len(self.texts) == 1:
            return f"always {self.quoted()}"
        return f"{len(self.texts)} different: {self.quoted(_QUOTED + 1)}"


def _number(text: str) -> float:
    """Read a number with either decimal mark; NaN for other texts."""
    if not _PLAIN_NUMBER.fullmatch(text):
        return math.nan
    number = float(text.replace(",", "."))
    return number if math.isfinite(number) else math.nan


def table_columns(header: Sequence[str], cells: pd.DataFrame) -> list[Column]:
    """Make the columns of a table, with those that stand inside JSON cells behind them."""
    columns = []
    for position, name in enumerate(header):
        column = Column(name, cells[position])
        columns.append(column)
        first = next(iter(column.texts), "")
        if first.startswith("{"):
            columns += _columns_inside(column, first)
    return columns


def _columns_inside(column: Column, first: str) -> list[Column]:
    """Make columns of the keys that a first JSON cell has, each called `column.key`."""
    try:
        record = json.loads(first)
    except (ValueError, RecursionError):
        return []
    inside = []
    for key in list(record)[:_MOST_KEYS]:
        picked = {}
        for cell in column.cells.unique():
            try:
                picked[cell] = pick(cell, key) or ""
            except CellError:
                picked[cell] = ""
        inside.append(Column(f"{column.name}.{key}", column.cells.map(picked)))
    return inside


def counts_up(column: Column) -> bool:
    """Whether whole numbers rise by one from row to row; they may start again."""
    if not column.is_whole:
        return False
    steps = _steps(column)
    rises = steps[steps > 0]
    if not len(rises) or len(rises) < _RISING * len(steps):
        return False
    return bool(np.mean(rises == 1.0) >= _BY_ONE)


def is_moment(column: Column) -> bool:
    """Whether numbers rise nearly always and never come again, as times of day and clocks do."""
    if not column.is_numeric or len(column.texts) < _NEVER_AGAIN * len(column.cells):
        return False
    steps = _steps(column)
    return len(steps) > 2 and bool(np.mean(steps > 0) >= _RISING)


def _steps(column: Column) -> npt.NDArray[np.float64]:
    """Differences between a number and the one before it."""
    return np.diff(column.numbers[~np.isnan(column.numbers)])


def steadiness(column: Column) -> float:
    """Share of 1: each value stands in one run of rows, as a subject's does; less if it recurs."""
    runs = 1 + int(np.count_nonzero(np.diff(column.codes)))
    return len(np.unique(column.codes)) / runs


def is_designed(column: Column, subjects: _Codes) -> bool:
    """Whether a column's values belong to a design: most subjects meet most of them."""
    if len(column.texts) > _MOST_LEVELS:
        return False
    known = ~column.cells.map(is_missing).to_numpy()
    met = np.unique(np.stack([column.codes[known], subjects[known]]), axis=1)
    subjects_of_value = np.unique(met[0], return_counts=True)[1]
    all_subjects = len(np.unique(subjects))
    return bool(np.mean(subjects_of_value >= _DESIGNED * all_subjects) >= _DESIGNED)


def varies_within(column: Column, groups: _Codes) -> bool:
    """Whether numbers differ inside most groups of several rows, as adjustments do in a cell.

    Where no group has several rows nothing is known against it.
    """
    numbers = pd.Series(column.numbers)
    by_group = numbers.groupby(groups).agg(["nunique", "count"])
    repeated = by_group[by_group["count"] > 1]
    if repeated.empty:
        return True
    return bool((repeated["nunique"] > 1).mean() > 0.5)


def agreement(column: Column, reference: Column, groups: _Codes) -> float:
    """Rank correlation of two columns of numbers within groups; 0 where one of them is constant."""
    both = pd.DataFrame({"one": column.numbers, "other": reference.numbers}).dropna()
    ranks = both.groupby(groups[both.index]).rank(pct=True)
    if len(ranks) < 3 or not bool((ranks.std() > 0).all()):
        return 0.0
    return float(ranks["one"].corr(ranks["other"]))


def nearness(column: Column, reference: Column) -> float:
    """How near the numbers of two columns are at the median: 1 for equal, 0 from a third on."""
    positive = (column.numbers > 0) & (reference.numbers > 0)
    if not positive.any():
        return 0.0
    ratio = np.median(column.numbers[positive] / reference.numbers[positive])
    return max(0.0, 1.0 - abs(math.log(ratio)) / math.log(_SAME_UNIT))
