"""What users set: contrasts, biases, intervals of every kind, and the field's own numbers."""

from __future__ import annotations

from collections.abc import Sequence

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.basics import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    distinct,
    families_from,
    family_of,
    first,
    gives_means,
    matching,
    present,
    unwidened,
)
from percept.report.contrast import contrast
from percept.report.sections import (
    NOTHING,
    Cell,
    Columns,
    Section,
    Table,
    column,
    estimate,
    limits,
    of,
    side_by_side,
    table_of,
    value,
)
from percept.results import EquivalenceRow, IntervalRow, PsychophysicsRow, Results

#: What measures are called, in the order of the page. The PSE is the mean that stands elsewhere.
_MEASURES = {
    "jnd": "JND (SD of a {subject}’s adjustments)",
    "weber": "Weber fraction",
    "sd_subjects": "SD between {subjects}",
    "icc_1": "ICC(1), the reliability of one trial",
    "sigma_u": "σ u",
    "sigma_w": "σ w",
    "sigma_e": "σ e",
    "icc_c1": "ICC(C,1)",
    "icc_a1": "ICC(A,1)",
    "correlation": "Correlation",
    "gamma": "γ per decade",
    "sigma_slope": "σ of slopes per decade",
}


def bias(results: Results) -> Section:
    """Return what users set and how far that lies from the references."""
    words = results.data.words
    off = "" if gives_means(results) else ", and how far off"
    return Section(
        "bias",
        f"What {words.users} {words.verb}{off}",
        parts=[contrast(results), _intervals(results), _psychophysics(results), _jnd(results)],
        is_folded=True,
    )


def _intervals(results: Results) -> Section:
    """Return a table of intervals for each quantity, in the study's family."""
    words = results.data.words
    geometric = " (a geometric mean)" if family_of(results) == "lognormal" else ""
    said = (
        f"Mean: the average {words.user}{geometric}. User: the next {words.user}. Share: a stated"
        f" share of all {words.users}. One does not stand in for another."
    )
    rows = unwidened(results.intervals)
    if any(row.left_out for row in rows):
        said += " Adjustments at the limits of the control are left out and counted."
    tables = [
        _interval_table(results, matching(rows, parameter=name))
        for name in distinct(rows, "parameter")
    ]
    figures = [] if results.psychophysics else ["overview"]
    return Section("intervals", "Intervals", [said], tables, figures)


def _interval_table(results: Results, rows: Sequence[IntervalRow]) -> Table:
    """Return a table with a row per environment, and a column per kind and method."""
    families = families_from(family_of(results))
    quantity = results.data.quantities[rows[0].parameter]
    shown = []
    for kind in KINDS:
        for method in METHODS:
            for name in distinct(rows, "environment"):
                of_cell = matching(rows, environment=name, kind=kind, method=method)
                row = first(of_cell, family=families)
                if row is not None:
                    shown.append(row)
    columns: Columns = {capitalised(results.data.words.environment): str}
    if quantity.is_matched:
        columns["Reference"] = column(shown, "environment", of("reference", style="short"))
    if any(row.left_out for row in rows):
        columns["left out"] = column(shown, "environment", of("left_out", style="count"))
    columns |= side_by_side(shown, "environment", ("kind", "method"), _interval)
    unit = f" in {quantity.unit}" if quantity.unit else ""
    caption = f"{quantity.head}{unit}: {percent(rows[0].level)} limits ({shown[0].family})."
    name = f"intervals_{quantity.name}"
    return table_of(caption, distinct(shown, "environment"), columns, name=name, csv="intervals")


def _interval(row: IntervalRow) -> Cell:
    return estimate(row) if row.kind == "mean" else limits(row)


def _psychophysics(results: Results) -> Section:
    """Return a table per measure of environments or subjects, and one over all environments."""
    words = results.data.words
    rows = [row for row in results.psychophysics if row.measure in _MEASURES]
    if not rows:
        return Section("psychophysics")
    level = percent(rows[0].level)
    overall = [row for row in rows if row.environment is None and row.subject is None]
    tables = [_overall(overall, results)]
    for measure in present(_MEASURES, rows, "measure"):
        named = _MEASURES[measure].format(**vars(words))
        of_measure = matching(rows, measure=measure)
        for field in ("environment", "subject"):
            own = [row for row in of_measure if getattr(row, field) is not None]
            # By environment, SDs between trials are the JNDs above.
            if own and (measure != "sigma_e" or field == "subject"):
                by = getattr(words, field)
                columns: Columns = {capitalised(by): str}
                columns |= side_by_side(own, field, ("parameter", "method"), _measured)
                units = ", ".join(distinct(own, "unit"))
                caption = f"{named}{f' ({units})' if units else ''}, by {by}, {level} limits."
                tables.append(table_of(caption, distinct(own, field), columns, csv="psychophysics"))
    said = f"The PSE is the average {words.user}’s setting above."
    if overall:
        logarithms = " of logarithms" if rows[0].family == "lognormal" else ""
        said += (
            f" σ u, σ w and σ e are SDs{logarithms}: between {words.subjects} in all"
            f" {words.environments}, between them in one alone, and between trials. ICC(C,1) is"
            f" high where {words.subjects} keep their order, ICC(A,1) where they keep their values."
        )
    title = "Thresholds, spreads and reliability"
    return Section("psychophysics", title, [said], tables, ["overview"])


def _measured(row: PsychophysicsRow) -> Cell:
    return estimate(row, "percent" if row.measure == "weber" else "plain")


def _overall(rows: Sequence[PsychophysicsRow], results: Results) -> Table:
    """Return the table of what is over all environments."""
    words = results.data.words

    def named(measure: str) -> str:
        units = ", ".join(filter(None, distinct(matching(rows, measure=measure), "unit")))
        return _MEASURES[measure].format(**vars(words)) + (f" ({units})" if units else "")

    columns: Columns = {"Measure": named}
    columns |= side_by_side(rows, "measure", ("parameter", "method"), estimate)
    caption = f"Over all {words.environments}, with limits."
    measures = present(_MEASURES, rows, "measure")
    return table_of(caption, measures, columns, name="psychophysics", csv="psychophysics")


def _jnd(results: Results) -> Section:
    """Return whether biases are smaller than one JND."""
    words = results.data.words
    rows = results.equivalence
    if not rows:
        return Section("equivalence")
    sentence = (
        f"Is the typical {words.user}’s bias smaller than one JND? “Within” or “beyond” needs"
        f" {percent(rows[0].decision)} probability (Bayesian), or two one-sided tests (classical)."
    )
    caption = (
        "Biases against one JND. p, within: the larger of the two tests’. p, beyond: the smaller"
        " one doubled."
    )

    def jnd(row: EquivalenceRow) -> Cell:
        return NOTHING if row.jnd is None else (*value(row.jnd, 4), f" {row.unit}")

    columns: Columns = {
        capitalised(words.environment): of("environment"),
        "Quantity": of("parameter"),
        "Method": lambda row: METHOD_NAMES[row.method],
        "Verdict": of("outcome"),
        "JND": jnd,
        "probability": of("probability", 3),
        "p, within": of("p_within", 2),
        "p, beyond": of("p_beyond", 2),
    }
    table = table_of(caption, rows, columns, name="equivalence", csv="equivalence")
    return Section("equivalence", "Within one JND?", [sentence], [table])
