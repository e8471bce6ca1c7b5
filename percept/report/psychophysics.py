"""The section of the field's own numbers: points of equality, thresholds, spreads, reliability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from percept.report.select import METHODS, Section, distinct, matching, ordered
from percept.results import PsychophysicsRow, Results

__all__ = ["psychophysics"]

#: Heads of the columns, in the order of the page.
_HEADS = {
    "pse": "PSE",
    "constant_error": "constant error",
    "constant_error_relative": "relative to the reference",
    "jnd": "JND (SD of adjustment)",
    "jnd_quartile": "JND (.6745 SD)",
    "weber": "Weber fraction",
    "sd_subjects": "SD between {subjects}",
    "weber_subjects": "relative to the reference",
    "icc_1": "ICC(1)",
    "sigma_u": "σ u",
    "sigma_w": "σ w",
    "sigma_e": "σ e",
    "icc_c1": "ICC(C,1)",
    "icc_a1": "ICC(A,1)",
    "correlation": "correlation",
    "gamma": "γ per decade",
    "sigma_slope": "σ of slopes per decade",
}

#: Styles of what is a fraction of the reference; all else is plain.
_STYLES = {"constant_error_relative": "bias", "weber": "percent", "weber_subjects": "percent"}


@dataclass(frozen=True)
class Line:
    """A row of a table: one environment, or one quantity, by one method."""

    label: str
    method: str
    cells: list[PsychophysicsRow | None]


@dataclass(frozen=True)
class Table:
    """Measures of one quantity by environment or subject, or of all quantities over all."""

    title: str
    by: str  # "environment", "subject", or "parameter" over all environments and subjects
    heads: list[str]
    styles: list[str]  # Of the numbers of each column
    lines: list[Line]


def psychophysics(results: Results) -> Section | None:
    """Return tables by environment, over all environments, and of subjects' own trials."""
    rows = results.psychophysics
    if not rows:
        return None
    overall = matching(rows, environment=None, subject=None)
    by_subject = [row for row in rows if row.subject is not None]
    by_environment = [row for row in rows if row.environment is not None]
    subjects = results.data.words.subject[1]
    tables = []
    for parameter in distinct(by_environment, "parameter"):
        quantity = results.data.quantities.get(parameter)
        title = quantity.head if quantity else f"{parameter} together"
        of_parameter = matching(by_environment, parameter=parameter)
        tables.append(_table(title, of_parameter, "environment", subjects))
    if overall:
        tables.append(_table("", overall, "parameter", subjects))
    for parameter in distinct(by_subject, "parameter"):
        head = results.data.quantities[parameter].head
        of_parameter = matching(by_subject, parameter=parameter)
        tables.append(_table(head, of_parameter, "subject", subjects))
    return Section("psychophysics", "Psychophysics", tables)


def _table(title: str, rows: Sequence[PsychophysicsRow], by: str, subjects: str) -> Table:
    """Lay rows out: a column for each measure, a line for each method and value of a field."""
    measures = ordered(_HEADS, rows, "measure")
    lines = []
    for label in distinct(rows, by):
        for method in METHODS:
            own = matching(rows, method=method, **{by: label})
            by_measure: dict[str, PsychophysicsRow] = {row.measure: row for row in own}
            if own:
                lines.append(Line(label, method, [by_measure.get(name) for name in measures]))
    heads = []
    for name in measures:
        units = [row.unit for row in rows if row.measure == name]
        # SDs of several quantities may have several units.
        one_unit = units[0] if len(set(units)) == 1 else ""
        head = _HEADS[name].format(subjects=subjects)
        heads.append(f"{head} in {one_unit}" if one_unit else head)
    styles = [_STYLES.get(name, "plain") for name in measures]
    return Table(title, by, heads, styles, lines)
