"""The section of the field's own numbers: points of equality, thresholds, spreads, reliability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from percept.report.select import (
    METHODS,
    Section,
    distinct,
    first,
    matching,
    ordered,
    words_of,
)
from percept.results import PsychophysicsRow, Results

__all__ = ["Measured", "psychophysics"]

#: What measures are called, in the order of the page.
_NAMES = {
    "pse": "PSE",
    "jnd": "JND (SD of adjustment)",
    "jnd_quartile": "JND (.6745 SD)",
    "weber": "Weber fraction",
    "sd_subjects": "SD between {subjects}",
    "icc_1": "ICC(1)",
    "sigma_u": "σ u",
    "sigma_w": "σ w",
    "sigma_e": "σ e",
    "icc_c1": "ICC(C,1)",
    "icc_a1": "ICC(A,1)",
    "correlation": "Correlation",
    "gamma": "γ per decade",
    "sigma_slope": "σ of slopes per decade",
}

#: Lines of the table that stand open: more would keep readers from the sections below.
_MOST_LINES = 100
#: Styles of what is a fraction of the reference; all else is plain.
_STYLES = {"weber": "percent"}


@dataclass(frozen=True)
class Line:
    """A measure in one environment, over all environments, or of one subject."""

    label: str
    cells: list[PsychophysicsRow | None]  # By method


@dataclass(frozen=True)
class Group:
    """One measure of one quantity."""

    head: str  # Measure, quantity and unit
    style: str  # Of its numbers
    lines: list[Line]


@dataclass(frozen=True)
class Measured:
    """The table of all measures: a group of rows for each, a column for each method."""

    methods: list[str]
    groups: list[Group]
    is_open: bool


def psychophysics(results: Results) -> Section | None:
    """Return the table of measures: by environment, over all environments, and by subject."""
    quantities = results.data.quantities
    means = {name for name, quantity in quantities.items() if not quantity.is_matched}
    rows = [
        row for row in results.psychophysics if row.parameter not in means or row.measure != "pse"
    ]
    if not rows:
        return None
    methods = ordered(METHODS, rows, "method")
    groups = []
    for measure in ordered(_NAMES, rows, "measure"):
        of_measure = matching(rows, measure=measure)
        for parameter in distinct(of_measure, "parameter"):
            of_parameter = matching(of_measure, parameter=parameter)
            together = matching(of_parameter, subject=None)
            by_subject = [row for row in of_parameter if row.subject is not None]
            for own in (together, by_subject):
                if own:
                    groups.append(_group(results, own, methods))
    is_open = sum(len(group.lines) for group in groups) <= _MOST_LINES
    return Section("psychophysics", "Psychophysics", Measured(methods, groups, is_open))


def _group(results: Results, rows: Sequence[PsychophysicsRow], methods: Sequence[str]) -> Group:
    """Lay out the rows of one measure and quantity."""
    words = words_of(results)
    row = rows[0]
    quantity = results.data.quantities.get(row.parameter)
    # A correlation is of two quantities together.
    what = quantity.words if quantity else row.parameter
    head = f"{_NAMES[row.measure].format(subjects=words.subjects)} of {what}"
    if row.unit:
        head += f", {row.unit}"
    if row.subject is not None:
        head += f", by {words.subject}"
    lines = []
    for environment, subject in dict.fromkeys((row.environment, row.subject) for row in rows):
        of_line = matching(rows, environment=environment, subject=subject)
        label = subject or environment or "all"
        lines.append(Line(label, [first(matching(of_line, method=name)) for name in methods]))
    return Group(head, _STYLES.get(row.measure, "plain"), lines)
