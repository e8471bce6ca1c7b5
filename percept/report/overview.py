"""The answer first: decisions in sentences, a row per environment, and cautions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.cautions import cautions, overruled
from percept.report.contrast import contrast_sentences, level_panels
from percept.report.decisions import (
    FEELINGS,
    RENDERED,
    coupling_sentences,
    device_sentences,
    feeling_sentences,
)
from percept.report.display import centrals
from percept.report.methods import who_gave_what
from percept.report.numbers import digits_of
from percept.report.paragraph import results_paragraph
from percept.report.sections import NOTHING, Cell, Columns, Section, Table, table_of, value
from percept.report.select import (
    METHOD_NAMES,
    METHODS,
    compared_by_difference,
    distinct,
    families_of,
    first,
    foremost,
    matching,
    words_of,
)
from percept.report.sentences import bias_sentences, user_sentences
from percept.results import (
    Findings,
    IntervalRow,
    Overview,
    OverviewRow,
    Results,
)

__all__ = ["decide", "findings", "overview", "setting_sentences", "summary"]

_KIND = "user"  # whose range stands beside the average's interval
_MOST_SENTENCES = 3
_MOST_CAUTIONS = 5  # that stand open


def findings(results: Results) -> Findings:
    """Work out what the first screen says from the results."""
    rows, classical = _both_rows(results)
    paragraph = results_paragraph(results, rows, classical)
    return Findings(overview(results), tuple(cautions(results)), paragraph)


def overview(results: Results) -> Overview:
    """Return the rows of the intervals that the page is about, and the decisions."""
    return Overview(tuple(_both_rows(results)[0]), tuple(decide(results)))


def decide(results: Results) -> list[str]:
    """Return at most three statements: what is so, how sure, and what to do next.

    A model that overrules the data is said before them.
    The study's own contrasts come first; then what can be rendered and feels real. Without a
    device, how far users set each quantity off.
    """
    words = words_of(results)
    warning = overruled(results, words)
    statements = contrast_sentences(results)
    effects = results.ladder.effects if results.ladder else ()
    feelings = feeling_sentences(results.verdicts, results.rendering or (), words, effects)
    if feelings:
        statements = [*statements[:1], " ".join(feelings)]
        statements += [" ".join(coupling_sentences(results.design, words))]
        statements += device_sentences(results, words)
    else:
        statements += setting_sentences(results)
    return [*warning, *[statement for statement in statements if statement][:_MOST_SENTENCES]]


def setting_sentences(results: Results) -> list[str]:
    """Say how far users set each quantity off, and where the next user's settings lie."""
    rows, classical = _both_rows(results)
    words = words_of(results)
    effects = results.ladder.effects if results.ladder else ()
    quantities = results.data.quantities
    sentences = bias_sentences(rows, classical, quantities, words, effects)
    return sentences + user_sentences(rows, quantities, words)


def _both_rows(results: Results) -> tuple[list[OverviewRow], list[OverviewRow]]:
    """Return the rows of the overview, and the rows of the classical method."""
    intervals = matching(results.intervals, joint="marginal")
    differences = compared_by_difference(intervals)
    preferred = families_of(results)
    rows = _rows(intervals, METHODS[::-1], preferred, differences)
    # Paired as the methods are compared: in equal families.
    families = [row.family for row in rows] or preferred
    return rows, _rows(intervals, ["classical"], families, differences)


def _rows(
    intervals: Sequence[IntervalRow],
    methods: Sequence[str],
    families: Sequence[str],
    differences: set[str],
) -> list[OverviewRow]:
    """Return a row per environment and quantity, of the first method and family that it has."""
    rows = []
    for environment in distinct(intervals, "environment"):
        for parameter in distinct(intervals, "parameter"):
            candidates = matching(intervals, environment=environment, parameter=parameter)
            mean = first(matching(candidates, kind="mean"), method=methods, family=families)
            user = first(matching(candidates, kind=_KIND), method=methods, family=families)
            main = mean or user
            if main:
                rows.append(_row(main, mean, user, relative=parameter not in differences))
    return rows


def _row(
    main: IntervalRow, mean: IntervalRow | None, user: IntervalRow | None, *, relative: bool
) -> OverviewRow:
    """Return what there is to say of one quantity of one environment."""
    reference = main.reference

    def bias(value: float | None) -> float | None:
        if value is None or reference is None:
            return None
        size = value / reference - 1.0 if relative else value - reference
        return size if math.isfinite(size) else None

    def ratio(value: float | None) -> float | None:
        if value is None or reference is None or not relative or bias(value) is None:
            return None
        return value / reference

    lower = None if user is None else user.lower
    upper = None if user is None else user.upper
    return OverviewRow(
        environment=main.environment,
        parameter=main.parameter,
        unit=main.unit,
        reference=reference,
        method=main.method,
        family=main.family,
        level=main.level,
        estimate=main.estimate,
        relative=relative,
        bias=bias(main.estimate),
        bias_lower=None if mean is None else bias(mean.lower),
        user_lower=lower,
        user_bias_lower=bias(lower),
        user_lower_ratio=ratio(lower),
        bias_upper=None if mean is None else bias(mean.upper),
        user_upper=upper,
        user_bias_upper=bias(upper),
        user_upper_ratio=ratio(upper),
    )


def summary(results: Results, found: Findings) -> Section:
    """Return the first screen: decisions, the table of environments, cautions and a figure."""
    words = words_of(results)
    rows = found.overview.rows
    names = distinct(rows, "environment")
    shown = foremost(rows)
    others = [name for name in names if name not in shown]
    table = _environments(results, rows, [name for name in names if name in shown], "overview")
    further = _environments(results, rows, others, "overview_other")
    figures = [panel.name for panel in level_panels(results)] or ["overview"] * bool(rows)
    return Section(
        "summary",
        "Summary",
        parts=[
            Section("withheld", "", _withheld(results), form="warning"),
            Section("decisions", "", found.overview.sentences, form="list"),
            Section("environments", "", [], [table, centrals(results)]),
            Section(
                "others",
                f"The other {len(others)} {words.environments}",
                tables=[further],
                figures=["overview_all"] if others else [],
                is_folded=True,
            ),
            Section(
                "cautions",
                "Before you rely on it",
                found.cautions[:_MOST_CAUTIONS],
                parts=[
                    Section(
                        "more-cautions",
                        "More to know",
                        found.cautions[_MOST_CAUTIONS:],
                        form="list",
                        is_folded=True,
                    )
                ],
                form="warning",
            ),
            Section("source", "", [who_gave_what(results)], figures=figures),
        ],
    )


def _withheld(results: Results) -> list[str]:
    """Say where a run of the sampler gave no numbers."""
    diagnostics = results.diagnostics
    if diagnostics is None or diagnostics.gate.passed:
        return []
    return ["The Bayesian numbers are withheld: the sampler did not pass its checks."]


def _environments(
    results: Results, rows: Sequence[OverviewRow], names: Sequence[str], name: str
) -> Table:
    """Return the table with a row per environment."""
    if not names:
        return Table("", [], [])
    quantities = results.data.quantities
    parameters = distinct(rows, "parameter")
    columns: Columns = {capitalised(words_of(results).environment): str}
    heads = {}
    for parameter in parameters:
        quantity = quantities[parameter]
        unit = f" ({quantity.unit})" if quantity.unit else ""
        heads[parameter] = f"Mean {quantity.symbol}{unit}"
        if quantity.is_matched:
            of_parameter = matching(rows, parameter=parameter)
            in_unit = "" if of_parameter[0].relative else unit
            heads[parameter] = f"Bias of {quantity.symbol}{in_unit}"
            columns[f"Reference {quantity.symbol}{unit}"] = _column(of_parameter, _reference)
    for coupled in distinct(results.rendering or results.verdicts, "coupled"):
        columns[capitalised(RENDERED[coupled])] = _display(results, coupled=coupled)
    for parameter in parameters:
        cell = partial(_bias, is_matched=quantities[parameter].is_matched)
        columns[heads[parameter]] = _column(matching(rows, parameter=parameter), cell)
    return table_of(_caption(results, rows[0]), names, columns, name=name)


def _column(
    rows: Sequence[OverviewRow], cell: Callable[[OverviewRow], Cell]
) -> Callable[[str], Cell]:
    """Return what makes an environment's cell of one quantity."""
    by_name = {row.environment: row for row in rows}

    def of_environment(name: str) -> Cell:
        return cell(by_name[name]) if name in by_name else NOTHING

    return of_environment


def _reference(row: OverviewRow) -> Cell:
    return value(row, "reference", style="short")


def _bias(row: OverviewRow, *, is_matched: bool) -> Cell:
    """Return a bias with its interval; where nothing was matched, a mean."""
    style = "bias" if row.relative else "difference" if is_matched else "plain"
    digits = digits_of(row.estimate, row.user_lower, row.user_upper)
    estimate = value(row, "bias", digits=digits, style=style)
    lower = value(row, "bias_lower", digits=digits, style=style)
    upper = value(row, "bias_upper", digits=digits, style=style)
    return (*estimate, " (", *lower, " to ", *upper, ")")


def _display(results: Results, *, coupled: bool) -> Callable[[str], Cell]:
    """Return what makes a cell on rendering, and on feeling real of what can be rendered."""
    verdicts = matching(results.verdicts, coupled=coupled)
    rendering = matching(results.rendering or (), coupled=coupled)

    def cell(name: str) -> Cell:
        rendered = first(matching(rendering, environment=name))
        verdict = first(matching(verdicts, environment=name))
        if rendered is not None and rendered.verdict == "cannot":
            return ("cannot be rendered",)
        if rendered is not None and rendered.verdict == "undecided":
            return ("rendering not decided",)
        if verdict is None:
            return ("can be rendered",) if rendered else NOTHING
        probability = value(verdict, "probability", digits=3, style="percent")
        return (FEELINGS[verdict.outcome], ", ", *probability)

    return cell


def _caption(results: Results, row: OverviewRow) -> str:
    """Say what the columns are."""
    words = words_of(results)
    method = f"{percent(row.level)}, {METHOD_NAMES[row.method]}, {row.family}"
    what = f"Mean: of all {words.users}"
    if results.data.quantities[row.parameter].is_matched:
        what = f"Bias: how far the average {words.user} is off the reference"
    said = f"{what}, with its interval ({method})."
    if results.verdicts:
        verdict = results.verdicts[0]
        measure = "probability" if verdict.method == "bayesian" else "confidence"
        said += (
            f" Real: among the central {percent(verdict.central)} of {words.users} at every ω, with"
            f" {METHOD_NAMES[verdict.method]} {measure} of {percent(verdict.decision)} or more."
        )
    return said
