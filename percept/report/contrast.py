"""Factors, groups and covariates: how their levels differ, in sentences and in one table."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.basics import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    Estimated,
    digits_of,
    distinct,
    gives_means,
    listed,
    matching,
    possessive,
    present,
)
from percept.report.sections import (
    NOTHING,
    Cell,
    Columns,
    Section,
    Table,
    estimate,
    of,
    table_of,
    value,
)
from percept.results import ContrastRow, Results
from percept.sessions.formula import TRIAL_REFERENCE

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


def contrast_rows(results: Results) -> list[ContrastRow]:
    """Return the contrasts in the data's unit: parts of unequal references become per cents."""
    rows = []
    for row in results.contrast:
        # Pure numbers have no word for their unit.
        unit = row.unit.removesuffix("units")
        scale = 1.0
        if unit == "references":
            cells = matching(results.intervals, parameter=row.parameter)
            sizes = {one.reference for one in cells if one.environment.startswith(row.references)}
            size = sizes.pop() if len(sizes) == 1 else None
            unit = results.data.quantities[row.parameter].unit if size else "% of the reference"
            scale = size or 100.0
        scaled: dict[str, Any] = {}
        for name in _LIMITS:
            number = getattr(row, name)
            scaled[name] = None if number is None else scale * number
        rows.append(dataclasses.replace(row, unit=unit, **scaled))
    return rows


def is_ratio(row: ContrastRow) -> bool:
    """Say whether a contrast is a ratio; it is a difference otherwise."""
    return row.family == "lognormal" or row.kind is None


def level_figures(results: Results) -> dict[str, tuple[str, str]]:
    """Name a figure for each quantity and factor whose levels have means."""
    found = {}
    means = matching(results.contrast, of="level", kind="mean")
    pairs = dict.fromkeys((row.parameter, row.factor) for row in results.levels)
    for number, (parameter, factor) in enumerate(pairs, start=1):
        if matching(means, parameter=parameter, factor=factor):
            found[f"levels_{parameter}_{number}"] = (parameter, factor)
    return found


def contrast(results: Results) -> Section:
    """Return sentences on what contrasts rest on, one table, and tests of terms."""
    rows = contrast_rows(results)
    if not rows:
        return Section("contrast")
    words = results.data.words
    within = listed(distinct(matching(rows, within=True), "factor"))
    groups = listed(distinct(matching(rows, within=False), "factor"))
    sentences = []
    if within:
        sentences.append(
            f"Every {words.subject} went through all levels of {within}: contrasts pair each"
            f" {words.subject}’s own means."
        )
    if groups:
        sentences.append(f"Different {words.subjects} are compared in {groups}.")
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
        [_table(rows, results), _anova(results)],
    )


def _table(rows: Sequence[ContrastRow], results: Results) -> Table:
    """Return the one table of the contrasts of average users, and of spreads."""
    words = results.data.words
    is_mean = gives_means(results)
    parameters = list(results.data.quantities)
    pairs = list(dict.fromkeys((row.factor, row.first, row.second) for row in rows))

    def place(row: ContrastRow) -> tuple[int, int, int]:
        pair = pairs.index((row.factor, row.first, row.second))
        return list(_PARTS).index(row.of), pair, parameters.index(row.parameter)

    def where(row: ContrastRow) -> str:
        return row.environment or f"overall, {len(row.references)} of {results.data.references}"

    def compared(row: ContrastRow) -> str:
        named = _PARTS.get(row.of) or f"{row.of} {row.factor}"
        if is_mean and row.kind:
            named = {"level": "mean", "bias": "difference"}.get(row.of, named)
        return f"{named} ({row.unit})" if row.unit else named

    def together(row: ContrastRow) -> Cell:
        if row.lower_together is None or row.upper_together is None:
            return NOTHING
        digits = digits_of(row.estimate, row.lower, row.upper)
        lower = value(row.lower_together, digits)
        return (*lower, " to ", *value(row.upper_together, digits))

    above = "P(> 1)" if rows[0].family == "lognormal" else "P(> 0)"
    columns: Columns = {
        "Contrast": lambda row: (
            row.second if is_mean and row.of == "level" else f"{row.second} against {row.first}"
        ),
        capitalised(words.environment): where,
        "Quantity": lambda row: results.data.quantities[row.parameter].label,
        "Of": compared,
        "Method": lambda row: METHOD_NAMES[row.method],
        "estimate (limits)": lambda row: estimate(row, least=_LEAST_DIGITS),
        "together": together,
        "p": of("p_value", 2),
        above: of("probability_above", 3, "percent"),
        "d_z": of("d_z", 2),
        words.subjects: of("n", style="count"),
    }
    shown = [row for row in rows if row.kind in ("mean", None)] or list(rows)
    measure = "over" if rows[0].family == "lognormal" else "less"
    caption = (
        f"Contrasts of levels for the average {words.user}: A against B is A {measure} B; spreads"
        f" are ratios of SDs ({percent(rows[0].level)} limits). Overall, all references weigh the"
        " same."
    )
    return table_of(caption, sorted(shown, key=place), columns, name="contrast", csv="contrast")


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
    return table_of(caption, results.anova, columns, name="anova", csv="anova")


def contrast_sentences(results: Results) -> list[str]:
    """Say how levels differ: each factor's clearest contrast of each quantity, interactions first.

    It is over all references where there is such a one, of the average user, and of the better
    method.
    """
    rows = [row for row in contrast_rows(results) if row.of not in ("level", "spread", "precision")]
    clearest = []
    for factor, parameter in dict.fromkeys((row.factor, row.parameter) for row in rows):
        own = matching(rows, factor=factor, parameter=parameter)
        own = matching(own, kind=present(KINDS, own, "kind")[0])
        own = matching(own, method=present(METHODS[::-1], own, "method")[0])
        clearest.append(max(matching(own, environment=None) or own, key=_clarity))
    clearest.sort(key=lambda row: row.of != "interaction")
    return [_difference(row, results) for row in clearest]


def _clarity(row: ContrastRow) -> float:
    """Return how many lengths of its interval a contrast lies from none."""
    return abs(row.estimate - is_ratio(row)) / (row.upper - row.lower or 1.0)


def _difference(row: ContrastRow, results: Results) -> str:
    """Say how the second level differs from the first, and on how much of the study that rests."""
    words = results.data.words
    who = {"user": f"next {words.user}’s ", "share": f"most {possessive(words.users)} "}.get(
        row.kind or "", ""
    )
    what = who + results.data.quantities[row.parameter].label
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
        estimate=row.estimate,
        lower=row.lower,
        upper=row.upper,
        unit="" if is_product else row.unit,
        style="plain" if is_product else "difference",
        least_digits=_LEAST_DIGITS,
    )
    level = percent(row.level)
    limits = f"({level}: {shown.limits})"
    times = " times" if is_product else ""
    size = shown.text(abs(row.estimate), "plain") + times
    lower = row.lower if row.lower_together is None else row.lower_together
    upper = row.upper if row.upper_together is None else row.upper_together
    if row.of == "slope" and row.factor == TRIAL_REFERENCE:
        way = "falls" if row.estimate < is_product else "rises"
        said = f"Per decade of reference the bias of the {what} {way} by {size} {limits}."
        if is_product:
            # The reference itself is ten times as high.
            said = (
                f"Per decade of reference the {what} is {shown.text(10.0 * row.estimate)} times as"
                f" large: the ratio to the reference {way} to {size} {limits}."
            )
    elif lower <= is_product <= upper:
        together = "" if row.lower_together is None else ", together"
        outer = dataclasses.replace(shown, lower=lower, upper=upper)
        said = (
            f"The {what} does not differ clearly between {factor} {second} and {first}:"
            f" {shown.text(row.estimate)}{times} ({level}{together}: {outer.limits})."
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
