"""What users set: contrasts of levels, intervals of every kind, and the field's own numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.basics import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    NOTHING,
    Cell,
    Columns,
    Estimated,
    Section,
    Table,
    best,
    bracketed,
    column,
    distinct,
    estimate,
    families_from,
    family_of,
    gives_means,
    grouped,
    limits,
    listed,
    matching,
    of,
    possessive,
    side_by_side,
    table_of,
    unwidened,
    value,
)
from percept.results import ContrastRow, IntervalRow, PsychophysicsRow, Results
from percept.sessions.options import TRIAL_REFERENCE

#: What measures are called, in the order of the page. The PSE is the mean that stands elsewhere.
_MEASURES = {
    "jnd": "JND",
    "weber": "Weber fraction",
    "sd_subjects": "SD between {subjects}",
    "icc_1": "ICC(1)",
    "sigma_u": "σ u",
    "sigma_w": "σ w",
    "sigma_e": "σ e",
    "correlation": "Correlation",
    "gamma": "γ per decade",
    "sigma_slope": "σ of slopes per decade",
}
#: What is compared, in the order of the table, and what it is called where not by its factor.
_PARTS = {
    "interaction": "",
    "level": "mean bias",
    "bias": "bias",
    "spread": "spread",
    "precision": "precision",
    "slope": "",
}
#: Digits of an estimate, at least: beside a wide interval it has the digits of the narrow one.
_LEAST_DIGITS = 3
_LIMITS = ("estimate", "lower", "upper", "lower_together", "upper_together")


def adjustments(results: Results) -> Section:
    """Return what users set and how far that lies from the references."""
    words = results.data.words
    off = "" if gives_means(results) else ", and how far off"
    return Section(
        "bias",
        f"What {words.users} {words.verb}{off}",
        parts=[_contrast(results), _intervals(results), _psychophysics(results), _jnd(results)],
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
    tables = [_interval_table(results, chosen) for chosen in grouped(rows, "parameter").values()]
    return Section("intervals", "Intervals", [said], tables, ["overview"])


def _interval_table(results: Results, rows: Sequence[IntervalRow]) -> Table:
    """Return a table with a row per environment, and a column per kind and method."""
    families = families_from(family_of(results))
    quantity = results.data.quantities[rows[0].parameter]
    names = distinct(rows, "environment")
    cells = grouped(rows, "environment", "kind", "method").values()
    shown = [best(of_cell, families) for of_cell in cells]
    shown.sort(key=lambda row: (KINDS.index(row.kind), METHODS.index(row.method)))
    columns: Columns = {capitalised(results.data.words.environment): str}
    if quantity.is_matched:
        columns["Reference"] = column(shown, "environment", of("reference", style="short"))
    if any(row.left_out for row in rows):
        columns["left out"] = column(shown, "environment", of("left_out", style="count"))
    columns |= side_by_side(
        shown,
        "environment",
        ("kind", "method"),
        lambda row: estimate(row) if row.kind == "mean" else limits(row),
    )
    unit = f" in {quantity.unit}" if quantity.unit else ""
    caption = f"{quantity.head}{unit}: {percent(rows[0].level)} limits ({shown[0].family})."
    return table_of(caption, names, columns, name=f"intervals_{quantity.name}", csv="intervals")


def _psychophysics(results: Results) -> Section:
    """Return one table of all measures, over all environments, by environment and by subject."""
    words = results.data.words
    measures = list(_MEASURES)
    # By environment, SDs between trials are the JNDs.
    rows = [
        row for row in results.psychophysics if row.measure != "sigma_e" or row.environment is None
    ]
    rows.sort(key=lambda row: measures.index(row.measure))
    if not rows:
        return Section("psychophysics")

    def named(cell: tuple[str, str | None, str | None]) -> str:
        units = distinct(matching(rows, measure=cell[0]), "unit")
        return _MEASURES[cell[0]].format(**vars(words)) + bracketed(", ".join(filter(None, units)))

    fields = "measure", "environment", "subject"
    columns: Columns = {
        "Measure": named,
        "Of": lambda cell: cell[1] or cell[2] or "all",
    }
    columns |= side_by_side(rows, fields, ("parameter", "method"), _measured)
    logarithms = " of logarithms" if rows[0].family == "lognormal" else ""
    said = (
        f"The PSE is the average {words.user}’s setting above. σ u, σ w and σ e are"
        f" SDs{logarithms}: between {words.subjects} in all {words.environments}, between them in"
        " one alone, and between trials. ICC(1) is the reliability of one trial."
    )
    if rows[0].measure == "jnd":
        said += f" The JND is the SD of a {words.subject}’s adjustments."
    caption = f"Measures with {percent(rows[0].level)} limits."
    table = table_of(caption, grouped(rows, *fields), columns, name="psychophysics")
    return Section("psychophysics", "Thresholds, spreads and reliability", [said], [table])


def _measured(row: PsychophysicsRow) -> Cell:
    return estimate(row, "percent" if row.measure == "weber" else "plain")


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

    columns: Columns = {
        capitalised(words.environment): of("environment"),
        "Quantity": of("parameter"),
        "Method": lambda row: METHOD_NAMES[row.method],
        "Verdict": of("outcome"),
        "JND": lambda row: (*value(row.jnd, 4), f" {row.unit}") if row.jnd else NOTHING,
        "probability": of("probability", 3),
        "p, within": of("p_within", 2),
        "p, beyond": of("p_beyond", 2),
    }
    table = table_of(caption, rows, columns, name="equivalence")
    return Section("equivalence", "Within one JND?", [sentence], [table])


def contrast_rows(results: Results) -> list[ContrastRow]:
    """Return the contrasts in the data's unit: parts of unequal references become per cents."""
    rows = []
    for row in results.contrast:
        scale, unit = unit_of(row, results)
        numbers = {name: getattr(row, name) for name in _LIMITS}
        scaled = {name: scale * one for name, one in numbers.items() if one is not None}
        rows.append(dataclasses.replace(row, unit=unit, **scaled))
    return rows


def unit_of(row: ContrastRow, results: Results) -> tuple[float, str]:
    """Return the unit in which a contrast is told, and how many of it its own unit is."""
    if row.unit != "references":
        # Pure numbers have no word for their unit.
        return 1.0, row.unit.removesuffix("units")
    cells = matching(results.intervals, parameter=row.parameter)
    sizes = {one.reference for one in cells if one.environment.startswith(row.references)}
    size = sizes.pop() if len(sizes) == 1 else None
    if size is None:
        return 100.0, "% of the reference"
    return size, results.data.quantities[row.parameter].unit


def is_ratio(row: ContrastRow) -> bool:
    """Say whether a contrast is a ratio; it is a difference otherwise."""
    return row.family == "lognormal" or row.kind is None


def level_figures(results: Results) -> dict[str, tuple[str, str]]:
    """Name a figure for each quantity and factor whose levels have means."""
    pairs = grouped(matching(results.contrast, of="level", kind="mean"), "parameter", "factor")
    return {f"levels_{pair[0]}_{number}": pair for number, pair in enumerate(pairs, start=1)}


def _contrast(results: Results) -> Section:
    """Return one table of contrasts, how to read it, and the tests of terms."""
    rows = contrast_rows(results)
    if not rows:
        return Section("contrast")
    words = results.data.words
    sentences = []
    if matching(rows, of="interaction"):
        sentences.append(
            "An interaction compares changes: “b, y against a, x” is the change from a to b at y,"
            " against that at x."
        )
    if matching(rows, of="precision"):
        sentences.append(
            f"Precision is the ratio of SDs between a {words.subject}’s trials, and so of JNDs and"
            " Weber fractions. Its classical limits are paired t or Welch’s, of log SDs."
        )
    if matching(rows, method="bayesian"):
        sentences.append(
            "All contrasts of a factor lie within their “together” limits with the stated"
            " probability."
        )
    return Section(
        "contrast",
        f"Differences between levels of {listed(distinct(rows, 'factor'))}",
        [" ".join(sentences)],
        [_contrasts(rows, results), _anova(results)],
    )


def _contrasts(rows: Sequence[ContrastRow], results: Results) -> Table:
    """Return the one table of the contrasts of average users, and of spreads."""
    words = results.data.words
    is_mean = gives_means(results)

    def where(row: ContrastRow) -> str:
        return row.environment or f"overall, {len(row.references)} of {results.data.references}"

    def levels(row: ContrastRow) -> str:
        is_alone = is_mean and row.of == "level"
        return row.second if is_alone else f"{row.second} against {row.first}"

    def compared(row: ContrastRow) -> str:
        named = _PARTS.get(row.of) or f"{row.of} {row.factor}"
        if is_mean and row.kind:
            named = {"level": "mean", "bias": "difference"}.get(row.of, named)
        return named + bracketed(row.unit)

    def together(row: ContrastRow) -> Cell:
        outer = _together(row)
        return NOTHING if outer is row else limits(outer, least=_LEAST_DIGITS)

    is_log = rows[0].family == "lognormal"
    columns: Columns = {
        "Contrast": levels,
        capitalised(words.environment): where,
        "Quantity": lambda row: results.data.quantities[row.parameter].label,
        "Of": compared,
        "Method": lambda row: METHOD_NAMES[row.method],
        "estimate (limits)": lambda row: estimate(row, least=_LEAST_DIGITS),
        "together": together,
        "p": of("p_value", 2),
        "P(> 1)" if is_log else "P(> 0)": of("probability_above", 3, "percent"),
        "d_z": of("d_z", 2),
        words.subjects: of("n", style="count"),
    }
    shown = [row for row in rows if row.kind in ("mean", None)] or rows
    ordered: list[ContrastRow] = []
    for part in _PARTS:
        for of_pair in grouped(matching(shown, of=part), "factor", "first", "second").values():
            ordered += of_pair
    caption = (
        f"Contrasts of levels for the average {words.user}: A against B is A"
        f" {'over' if is_log else 'less'} B; spreads are ratios of SDs"
        f" ({percent(rows[0].level)} limits). Overall, all references weigh the same."
    )
    return table_of(caption, ordered, columns, name="contrast")


def _together(row: ContrastRow) -> ContrastRow:
    """Return a contrast with the joint limits of its factor, if it has any."""
    if row.lower_together is None or row.upper_together is None:
        return row
    return dataclasses.replace(row, lower=row.lower_together, upper=row.upper_together)


def _anova(results: Results) -> Table:
    """Return the table of the tests of terms."""
    quantities = results.data.quantities
    columns: Columns = {
        "Term": lambda row: row.factor.replace(":", " × "),
        "Quantity": lambda row: quantities[row.parameter].label,
        "F": of("f", 4),
        "df": of("df_corrected", 4),
        "df of error": of("df_error_corrected", 4),
        "ε": of("epsilon", 3),
        "p": of("p_corrected", 2),
        "partial η²": of("partial_eta2", 2),
        "generalised η²": of("generalised_eta2", 2),
    }
    caption = (
        f"Analysis of variance of the {possessive(results.data.words.subjects)} means; degrees of"
        " freedom by Greenhouse and Geisser’s ε."
    )
    return table_of(caption, results.anova, columns, name="anova")


def contrast_sentences(results: Results) -> list[str]:
    """Say how levels differ: each factor's clearest contrast of each quantity, interactions first.

    It is over all references where there is such a one, of the average user, and of the better
    method.
    """

    def clarity(row: ContrastRow) -> float:
        """Return how far a contrast lies from no difference, in widths of its interval."""
        return abs(row.estimate - is_ratio(row)) / (row.upper - row.lower or 1.0)

    means = matching(contrast_rows(results), kind="mean")
    rows = [row for row in means if row.of != "level"]
    clearest = []
    for of_factor in grouped(rows, "factor", "parameter").values():
        chosen = matching(of_factor, method="bayesian") or of_factor
        clearest.append(max(matching(chosen, environment=None) or chosen, key=clarity))
    clearest.sort(key=lambda row: row.of != "interaction")
    return [_difference(row, results) for row in clearest]


def _difference(row: ContrastRow, results: Results) -> str:
    """Say how the second level differs from the first, and on how much of the study that rests."""
    words = results.data.words
    what = results.data.quantities[row.parameter].label
    if row.environment and results.data.references > 1:
        what += f" in {row.environment}"
    factor, first, second = row.factor, row.first, row.second
    if row.of == "interaction":
        # The change over one factor, at two levels of the rest.
        start, _, first = row.first.partition(", ")
        end, _, second = row.second.partition(", ")
        changing, _, factor = factor.partition(":")
        what = f"change of the {what} from {changing} {start} to {end}"
    is_product = is_ratio(row)
    shown = Estimated(
        row.estimate,
        row.lower,
        row.upper,
        unit="" if is_product else row.unit,
        style="plain" if is_product else "difference",
        least_digits=_LEAST_DIGITS,
    )
    level = percent(row.level)
    limits = f"({level}: {shown.limits})"
    times = " times" if is_product else ""
    size = shown.text(abs(row.estimate), "plain") + times
    outer = _together(row)
    if row.of == "slope" and row.factor == TRIAL_REFERENCE:
        way = "falls" if row.estimate < is_product else "rises"
        said = f"Per decade of reference the bias of the {what} {way} by {size} {limits}."
        if is_product:
            # The reference itself is ten times as high.
            said = (
                f"Per decade of reference the {what} is {shown.text(10.0 * row.estimate)} times as"
                f" large: the ratio to the reference {way} to {size} {limits}."
            )
    elif outer.lower <= is_product <= outer.upper:
        together = "" if outer is row else ", together"
        wide = dataclasses.replace(shown, lower=outer.lower, upper=outer.upper)
        said = (
            f"The {what} does not differ clearly between {factor} {second} and {first}:"
            f" {shown.text(row.estimate)}{times} ({level}{together}: {wide.limits})."
        )
    else:
        side = "as large" if is_product else "smaller" if row.estimate < 0.0 else "larger"
        other = "as" if is_product else "than"
        said = f"The {what} is {size} {side} for {factor} {second} {other} for {first} {limits}."
    rests_on = []
    if row.n < results.data.subjects:
        rests_on.append(f"{row.n} of {results.data.subjects} {words.subjects}")
    if row.environment is None and len(row.references) < results.data.references:
        rests_on.append(f"{len(row.references)} of {results.data.references} references")
    return f"{said} It rests on {listed(rests_on)}." if rests_on else said
