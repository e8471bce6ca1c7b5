"""What users set: contrasts, biases, intervals of every kind, and the field's own numbers."""

from __future__ import annotations

from collections.abc import Sequence

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.contrast import contrast
from percept.report.overview import setting_sentences
from percept.report.sections import (
    NOTHING,
    Cell,
    Columns,
    Section,
    Table,
    ends,
    of,
    table_of,
    with_limits,
)
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    distinct,
    families_of,
    first,
    matching,
    ordered,
    words_of,
)
from percept.results import EquivalenceRow, IntervalRow, PsychophysicsRow, Results

__all__ = ["bias"]

#: What measures are called, in the order of the page. The PSE is the mean that stands elsewhere.
_MEASURES = {
    "jnd": "JND (SD of a {subject}’s adjustments)",
    "jnd_quartile": "JND (.6745 SD)",
    "weber": "Weber fraction",
    "sd_subjects": "SD between {subjects}",
    "icc_1": "ICC(1), the reliability of one trial",
    "sigma_u": "σ u, between {subjects}",
    "sigma_w": "σ w, within one of the {environments}",
    "sigma_e": "σ e, between trials",
    "icc_c1": "ICC(C,1): {subjects} keep their order",
    "icc_a1": "ICC(A,1): {subjects} keep their values",
    "correlation": "Correlation",
    "gamma": "γ per decade",
    "sigma_slope": "σ of slopes per decade",
}


def bias(results: Results) -> Section:
    """Return what users set and how far that lies from the references."""
    words = words_of(results)
    matched = any(quantity.is_matched for quantity in results.data.quantities.values())
    return Section(
        "bias",
        f"What {words.users} {words.verb}" + (", and how far off" if matched else ""),
        setting_sentences(results),
        figures=["overview"] * bool(results.levels),
        parts=[contrast(results), _intervals(results), _psychophysics(results), _jnd(results)],
        is_folded=True,
    )


def _intervals(results: Results) -> Section:
    """Return a table of intervals for each quantity, in the study's family."""
    words = words_of(results)
    rows = matching(results.intervals, joint="marginal")
    sentences = [
        f"Mean: the average {words.user}. User: the next {words.user}. Share: a stated share of all"
        f" {words.users}. One does not stand in for another."
    ]
    if any(row.left_out for row in rows):
        sentences.append(
            "Adjustments at the limits of the control are left out; their number stands beside the"
            f" {words.environment}."
        )
    tables = [
        _interval_table(results, matching(rows, parameter=name))
        for name in distinct(rows, "parameter")
    ]
    return Section("intervals", "Intervals", sentences, tables)


def _interval_table(results: Results, rows: Sequence[IntervalRow]) -> Table:
    """Return a table with a row per environment, and a column per kind and method."""
    words = words_of(results)
    families = families_of(results)
    quantity = results.data.quantities[rows[0].parameter]

    def found(environment: str, kind: str, method: str) -> IntervalRow | None:
        of_cell = matching(rows, environment=environment, kind=kind, method=method)
        return first(of_cell, family=families)

    lines = []
    for name in distinct(rows, "environment"):
        own = matching(rows, environment=name)
        label: Cell = (name,)
        if own[0].left_out:
            label = (f"{name} (", *of("left_out", style="count")(own[0]), " left out)")
        line = [label]
        if quantity.is_matched:
            line.append(of("reference", style="short")(own[0]))
        for kind, method in _kinds_and_methods(rows):
            row = found(name, kind, method)
            if row is None:
                line.append(NOTHING)
            else:
                line.append(with_limits(row) if kind == "mean" else ends(row))
        lines.append(line)
    heads = [capitalised(words.environment), *["Reference"] * quantity.is_matched]
    heads += [f"{kind}, {METHOD_NAMES[method]}" for kind, method in _kinds_and_methods(rows)]
    unit = f" in {quantity.unit}" if quantity.unit else ""
    used = [family for family in families if matching(rows, family=family)]
    level = percent(rows[0].level)
    caption = f"{quantity.head}{unit}: {level} limits ({used[0]})."
    name = f"intervals_{quantity.name}"
    return Table(caption, heads, lines, name=name, csv=name)


def _kinds_and_methods(rows: Sequence[IntervalRow]) -> list[tuple[str, str]]:
    pairs = {(row.kind, row.method) for row in rows}
    return [(kind, method) for kind in KINDS for method in METHODS if (kind, method) in pairs]


def _psychophysics(results: Results) -> Section:
    """Return a table per measure of environments or subjects, and one over all environments."""
    words = words_of(results)
    rows = [row for row in results.psychophysics if row.measure in _MEASURES]
    if not rows:
        return Section("psychophysics", "")
    level = percent(rows[0].level)
    tables = []
    for measure in ordered(_MEASURES, rows, "measure"):
        named = _MEASURES[measure].format(**vars(words))
        of_measure = [row for row in matching(rows, measure=measure) if row.environment]
        for by in (words.environment, words.subject):
            is_of_subjects = by == words.subject
            own = [row for row in of_measure if (row.subject is not None) == is_of_subjects]
            if own:
                caption = f"{named}, by {by}, with {level} limits."
                tables.append(_measured(results, own, caption, by))
    overall = [row for row in rows if row.environment is None and row.subject is None]
    tables.append(
        _overall(results, overall, f"Over all {words.environments}, with {level} limits.")
    )
    logarithms = " SDs are of logarithms." if rows[0].family == "lognormal" else ""
    sentences = [f"The PSE is the average {words.user}’s setting above.{logarithms}"]
    is_shared = results.data.form == "trials" and not matching(rows, measure="sigma_slope")
    if matching(rows, measure="gamma") and is_shared:
        sentences.append(
            f"All {words.subjects} share the slope γ. Where theirs differ, its limits are too"
            " narrow: [model] subjects_slope = true gives each one of their own."
        )
    return Section("psychophysics", "Thresholds, spreads and reliability", sentences, tables)


def _measured(results: Results, rows: Sequence[PsychophysicsRow], caption: str, by: str) -> Table:
    """Return a table of one measure: quantities and methods side by side."""
    style = "percent" if rows[0].measure == "weber" else "plain"
    columns = []
    for parameter in distinct(rows, "parameter"):
        for method in METHODS:
            if matching(rows, parameter=parameter, method=method):
                columns.append((parameter, method))
    units = {row.parameter: f" ({row.unit})" if row.unit else "" for row in rows}
    heads = [capitalised(by)]
    heads += [f"{name}{units[name]}, {METHOD_NAMES[method]}" for name, method in columns]
    lines = []
    for environment, subject in dict.fromkeys((row.environment, row.subject) for row in rows):
        of_line = matching(rows, environment=environment, subject=subject)
        line: list[Cell] = [(subject or environment or "all",)]
        for parameter, method in columns:
            row = first(matching(of_line, parameter=parameter, method=method))
            line.append(NOTHING if row is None else with_limits(row, style=style))
        lines.append(line)
    return Table(caption, heads, lines, csv="psychophysics")


def _overall(results: Results, rows: Sequence[PsychophysicsRow], caption: str) -> Table:
    """Return the table of what is over all environments: a measure of a quantity a row."""
    words = words_of(results)
    lines = []
    for measure in ordered(_MEASURES, rows, "measure"):
        for parameter in distinct(matching(rows, measure=measure), "parameter"):
            own = matching(rows, measure=measure, parameter=parameter)
            unit = f" ({own[0].unit})" if own[0].unit else ""
            named = _MEASURES[measure].format(**vars(words))
            line: list[Cell] = [(named,), (f"{parameter}{unit}",)]
            for method in METHODS:
                row = first(matching(own, method=method))
                line.append(NOTHING if row is None else with_limits(row))
            lines.append(line)
    heads = ["Measure", "Quantity", *METHOD_NAMES.values()]
    return Table(caption, heads, lines, name="psychophysics", csv="psychophysics")


def _jnd_cell(row: EquivalenceRow) -> Cell:
    """Return the JND with its unit."""
    return NOTHING if row.jnd is None else (*of("jnd", 4)(row), f" {row.unit}")


def _jnd(results: Results) -> Section:
    """Return whether biases are smaller than one JND."""
    words = words_of(results)
    rows = results.equivalence
    if not rows:
        return Section("equivalence", "")
    sentence = (
        f"Is the typical {words.user}’s bias smaller than one JND? “Within” or “beyond” needs"
        f" {percent(rows[0].decision)} probability (Bayesian), or two one-sided tests (classical)."
    )
    caption = (
        "Biases against one JND. p, within: the larger of the two tests’. p, beyond: the smaller"
        " one doubled."
    )
    columns: Columns = {
        capitalised(words.environment): of("environment"),
        "Quantity": of("parameter"),
        "Method": lambda row: METHOD_NAMES[row.method],
        "Verdict": of("outcome"),
        "JND": _jnd_cell,
        "probability": of("probability", 3),
        "p, within": of("p_within", 2),
        "p, beyond": of("p_beyond", 2),
    }
    table = table_of(caption, rows, columns, name="equivalence", csv="equivalence")
    return Section("equivalence", "Within one JND?", [sentence], [table])
