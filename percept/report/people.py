"""The section of the subjects, one by one, and the places of those whom a warning names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from percept.report.select import MOST_OPEN, Section, distinct, first, foremost, matching, words_of
from percept.results import IntervalWithout, LeftOut, OverviewRow, Results, SubjectCheck, SubjectRow

__all__ = ["NamedSubject", "named_subjects", "people"]


@dataclass(frozen=True)
class NamedSubject:
    """A subject and the id of the own row."""

    subject: str
    row_id: str


@dataclass(frozen=True)
class PersonLine:
    """A row of the table."""

    named: NamedSubject
    rows: list[SubjectRow | None]  # By quantity
    check: SubjectCheck | None  # None without the checks of the model


@dataclass(frozen=True)
class WithoutTable:
    """Intervals of one quantity without each subject; columns are environments."""

    title: str  # Of the quantity
    unit: str
    rows: list[IntervalWithout]


@dataclass(frozen=True)
class People:
    """The section of the subjects."""

    heads: list[str]  # Of the quantities: how deviations are measured
    lines: list[PersonLine]
    checked: bool
    is_open: bool
    left_out: list[str]  # Subjects in the order of the intervals without them
    without: list[WithoutTable]


def people(results: Results, overview: Sequence[OverviewRow]) -> Section | None:
    """Return a row per subject with mean, SD and distance, and the intervals without each."""
    rows = results.data.people
    if not rows:
        return None
    parameters = distinct(rows, "parameter")
    loo = results.checks.loo if results.checks else None
    lines = []
    for named in _named(rows):
        own = matching(rows, subject=named.subject)
        by_parameter = [first(matching(own, parameter=parameter)) for parameter in parameters]
        check = first(matching(loo.subjects, subject=named.subject)) if loo else None
        lines.append(PersonLine(named, by_parameter, check))
    heads = []
    for parameter in parameters:
        row = matching(rows, parameter=parameter)[0]
        measured = "of the reference" if row.relative else row.unit
        heads.append(f"{parameter} ({measured})" if measured else parameter)
    view = People(
        heads,
        lines,
        checked=loo is not None,
        is_open=len(lines) <= MOST_OPEN,
        left_out=[check.subject for check in loo.subjects] if loo else [],
        without=_without(results, foremost(overview)),
    )
    return Section("people", f"The {words_of(results).subjects}, one by one", view)


def _without(results: Results, environments: set[str]) -> list[WithoutTable]:
    """Return a table per quantity, with the environments that the first screen shows."""
    if results.checks is None:
        return []
    rows = [row for row in results.checks.without if row.environment in environments]
    tables = []
    for parameter in distinct(rows, "parameter"):
        quantity = results.data.quantities[parameter]
        tables.append(
            WithoutTable(quantity.head, quantity.unit, matching(rows, parameter=parameter))
        )
    return tables


def named_subjects(results: Results) -> list[NamedSubject]:
    """Return the subjects whom a warning names, in the order of the table."""
    loo = results.checks.loo if results.checks else None
    if loo is None:
        return []
    suspects = _suspects(loo)
    return [named for named in _named(results.data.people) if named.subject in suspects]


def _suspects(loo: LeftOut) -> set[str]:
    """Return the subjects that are outliers, in all cells together or in one."""
    whole = {row.subject for row in loo.subjects if row.outlier}
    return whole | {cell.subject for cell in loo.cells if cell.outlier}


def _named(rows: Sequence[SubjectRow]) -> list[NamedSubject]:
    """Give every subject the number of its row as id: names may hold what no id can."""
    subjects = distinct(rows, "subject")
    return [NamedSubject(name, f"subject-{rank}") for rank, name in enumerate(subjects, start=1)]
