"""The answer first: findings in sentences, a row per quantity and environment, and cautions."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from percept.report.cautions import cautions, overruled
from percept.report.contrast import contrast_sentences, level_panels
from percept.report.feelings import (
    RENDERED,
    coupling_sentences,
    feeling_sentences,
    rendering_sentences,
)
from percept.report.paragraph import results_paragraph
from percept.report.people import NamedSubject, named_subjects
from percept.report.select import (
    METHODS,
    Section,
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
    Verdict,
)

__all__ = ["findings", "first_screen", "overview"]

_KIND = "user"  # whose range stands beside the average's interval


def findings(results: Results) -> Findings:
    """Work out what the first screen says from the results."""
    rows, classical = _both_rows(results)
    paragraph = results_paragraph(results, rows, classical)
    return Findings(overview(results), tuple(cautions(results)), paragraph)


def overview(results: Results) -> Overview:
    """Return the rows of the first table, and the sentences above them."""
    rows, classical = _both_rows(results)
    words = words_of(results)
    sentences = [*overruled(results, words), *contrast_sentences(results)]
    contrasts = len(sentences)
    effects = results.ladder.effects if results.ladder else ()
    sentences += bias_sentences(rows, classical, results.data.quantities, words, effects)
    if feelings := feeling_sentences(results.verdicts, words, effects):
        sentences.append(" ".join(feelings))
    if about_coupling := [*rendering_sentences(results), *coupling_sentences(results)]:
        sentences.append(" ".join(about_coupling))
    sentences += user_sentences(rows, results.data.quantities, words)
    # The next user's ranges answer where no device lets percept judge what feels real.
    most = contrasts + max(3, 2 * len(distinct(rows, "parameter")))
    return Overview(tuple(rows), tuple(sentences[:most]))


def _both_rows(results: Results) -> tuple[list[OverviewRow], list[OverviewRow]]:
    """Return the rows of the first table, and the rows of the classical method."""
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
    """Return what the table says of one quantity of one environment."""
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


@dataclasses.dataclass(frozen=True)
class Line:
    """A row of the first table."""

    row: OverviewRow
    rowspan: int  # Quantities of the environment
    verdicts: list[Verdict | None]  # As the environment is rendered: directly, through the coupling


@dataclasses.dataclass(frozen=True)
class FirstScreen:
    """The first screen."""

    lines: list[Line]
    folded: list[Line]  # Of many environments those whose bias is less clear
    levels: list[str]  # Figures of factors, by quantity
    panels: list[str]  # Figures, by quantity
    every: list[str]  # Figures of all environments, where `panels` leave some out
    rendered: list[str]  # How environments are displayed, in words
    named: list[NamedSubject]  # By a warning


def first_screen(results: Results, summary: Findings) -> Section:
    """Return the first screen: sentences, the table of environments, and warnings."""
    rows = summary.overview.rows
    rendered = distinct(results.verdicts, "coupled")
    open_ones = foremost(rows)
    lines: list[Line] = []
    folded: list[Line] = []
    for row in rows:
        felt = matching(results.verdicts, environment=row.environment)
        verdicts = [first(matching(felt, coupled=coupled)) for coupled in rendered]
        line = Line(row, len(matching(rows, environment=row.environment)), verdicts)
        (lines if row.environment in open_ones else folded).append(line)
    parameters = distinct(rows, "parameter")
    panels = [f"overview_{name}" for name in parameters]
    every = [f"overview_all_{name}" for name in parameters] if folded else []
    view = FirstScreen(
        lines=lines,
        folded=folded,
        levels=[panel.name for panel in level_panels(results)],
        panels=panels,
        every=every,
        rendered=[RENDERED[coupled] for coupled in rendered],
        named=named_subjects(results),
    )
    return Section("summary", "Summary", view)
