"""Whether the sampler and the model may be relied on, and the subjects one by one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.cautions import misfits
from percept.report.numbers import digits_of, short
from percept.report.sections import Cell, Section, Table, of, table_of, value
from percept.report.select import (
    distinct,
    family_of,
    first,
    foremost,
    matching,
    words_of,
)
from percept.results import GateVerdict, OverviewRow, Results

__all__ = ["checks"]


def checks(results: Results, rows: Sequence[OverviewRow]) -> Section:
    """Return the section of checks; `rows` are those of the overview."""
    return Section(
        "checks",
        "Checks",
        parts=[_sampling(results), _model(results), _people(results), _without(results, rows)],
        is_folded=True,
    )


def _sampling(results: Results) -> Section:
    """Return the measures behind the gate's verdict on the sampler, and the priors."""
    diagnostics = results.diagnostics
    if diagnostics is None:
        return Section("diagnostics", "")
    gate = diagnostics.gate
    measures = {
        "rhat": ("Rank R̂ across ensembles, largest", 5, f"below {gate.rhat_limit}"),
        "autocorrelation_time": ("Autocorrelation time, longest (steps)", 4, "finite"),
        "times_run": (
            "Length of a kept run in autocorrelation times",
            4,
            f"{gate.times_needed:g} or more",
        ),
        "effective_draws": ("Effective draws, fewest", 5, ""),
        "acceptance": ("Fraction of proposals accepted", 3, ""),
        "worst_error": (
            "Monte Carlo error of the Bayesian intervals’ limits, largest (half-widths)",
            3,
            "within the tolerance",
        ),
    }
    lines: list[list[Cell]] = []
    for name, (label, digits, limit) in measures.items():
        if getattr(gate, name) is not None:
            lines.append([(label,), value(gate, name, digits=digits), (limit,)])
    caption = (
        f"Diagnostics of the sampler: {diagnostics.ensembles} ensembles, {diagnostics.walkers}"
        f" walkers, {diagnostics.steps} steps."
    )
    priors = table_of(
        "Priors in force; the scene’s [model.priors] changes them.",
        diagnostics.priors,
        {"Prior": of("prior"), "Value": of("value", 4), "Meaning (unit)": of("meaning")},
    )
    measured = Table(caption, ["Measure", "Value", "Asked"], lines)
    return Section("diagnostics", "Sampling", _gate_said(gate, results), [measured, priors])


def _gate_said(gate: GateVerdict, results: Results) -> list[str]:
    """Say what the gate found, and what it leaves open."""
    if not gate.passed:
        said = "The sampler’s checks failed, and the Bayesian numbers are withheld."
        return [said, *gate.reasons]
    said = "The sampler’s checks passed: every Bayesian limit is as accurate as asked."
    if not gate.tolerance_met:
        said = f"The sampler’s checks passed, but it missed the tolerance. {gate.error_reached}"
    if results.checks is None:
        said += " Whether the model suits the data was not checked."
    return [said]


def _model(results: Results) -> Section:
    """Return the checks of the model against data and priors."""
    record = results.checks
    if record is None:
        return Section("model", "")
    words = words_of(results)
    sentences = []
    if record.loo:
        messages = list(misfits(record, family_of(results), words))
        sentences += messages or [f"No {words.subject} is an outlier."]
        density = f"unreliable, as a few draws have most of the weight without some {words.subject}"
        if record.loo.elpd is not None and record.loo.se is not None:
            density = f"{short(record.loo.elpd, 4)} ± {short(record.loo.se, 2)} nats"
        sentences.append(
            f"Log predictive density of the {words.subjects}, each left out in turn: {density}."
        )
    return Section("model", "The model", sentences, [_normality(results), _statistics(results)])


def _normality(results: Results) -> Table:
    """Return the probabilities of Shapiro and Wilk's tests."""
    words = words_of(results)
    rows = results.checks.normality if results.checks else ()
    caption = (
        f"p of Shapiro–Wilk tests of the {words.subjects}’ values (normal) and of their logarithms"
        " (lognormal), which classical intervals assume."
    )
    return _by_environment(rows, ("parameter", "family"), "p_value", caption, words.environment)


def _statistics(results: Results) -> Table:
    """Return how probably new studies have more of a statistic."""
    words = words_of(results)
    rows = results.checks.statistics if results.checks else ()
    caption = (
        f"Probability that a new study drawn from the posterior has a larger mean, SD or farthest"
        f" {words.subject}."
    )
    return _by_environment(rows, ("parameter", "statistic"), "above", caption, words.environment)


def _by_environment(
    rows: Sequence[Any], across: tuple[str, str], shown: str, caption: str, environment: str
) -> Table:
    """Return a table with a row per environment, and a column per pair of values of two fields."""
    pairs = list(dict.fromkeys(tuple(getattr(row, name) for name in across) for row in rows))
    lines = []
    for name in distinct(rows, "environment"):
        line: list[Cell] = [(name,)]
        for pair in pairs:
            row = first(matching(rows, environment=name, **dict(zip(across, pair, strict=True))))
            line.append(of(shown, 3)(row))
        lines.append(line)
    return Table(caption, [capitalised(environment), *map(", ".join, pairs)], lines)


def _people(results: Results) -> Section:
    """Return a row per subject with mean, SD and distance from the others."""
    rows = results.data.people
    if not rows:
        return Section("people", "")
    words = words_of(results)
    parameters = distinct(rows, "parameter")
    loo = results.checks.loo if results.checks else None
    heads = [capitalised(words.subject)]
    for parameter in parameters:
        row = matching(rows, parameter=parameter)[0]
        measured = " of the reference" if row.relative else f" ({row.unit})" if row.unit else ""
        heads += [f"{parameter}, mean{measured}", f"{parameter}, SD", f"{parameter}, distance"]
    if loo:
        heads += ["as far or farther", "Pareto index"]
    lines = []
    subjects = distinct(rows, "subject")
    for subject in subjects:
        line: list[Cell] = [(subject,)]
        for parameter in parameters:
            found = first(matching(rows, subject=subject, parameter=parameter))
            relative = found is not None and found.relative
            line += [
                of("mean", 2, "bias" if relative else "difference")(found),
                of("sd", 2, "percent" if relative else "plain")(found),
                of("distance", 2)(found),
            ]
        if loo:
            check = first(matching(loo.subjects, subject=subject))
            line += [of("farther", 2)(check), of("pareto_k", 2)(check)]
        lines.append(line)
    logarithms = " (of logarithms)" if rows[0].log else ""
    caption = (
        f"What each {words.subject} {words.verb} over the {words.environments}: mean deviation,"
        f" SD{logarithms}, and distance from the others’ mean in their SDs."
    )
    if loo:
        caption += (
            " The model expects as far or farther with the stated probability; a Pareto index above"
            f" {short(loo.good_k, 2)} is too high for reweighting."
        )
    table = Table(caption, heads, lines, name="subjects", csv="subjects")
    return Section("people", f"The {words.subjects}, one by one", tables=[table])


def _without(results: Results, overview: Sequence[OverviewRow]) -> Section:
    """Return the average user's intervals without each subject in turn."""
    loo = results.checks.loo if results.checks else None
    if results.checks is None or loo is None:
        return Section("without", "")
    words = words_of(results)
    shown = foremost(overview)
    rows = [row for row in results.checks.without if row.environment in shown]
    tables = []
    level = percent(results.provenance.scene["inference"]["level"])
    for parameter in distinct(rows, "parameter"):
        own = matching(rows, parameter=parameter)
        lines = []
        for index, check in enumerate(loo.subjects):
            lines.append([(check.subject,), *(_left_out(row, index) for row in own)])
        quantity = results.data.quantities[parameter]
        unit = f" in {quantity.unit}" if quantity.unit else ""
        caption = f"{quantity.head}{unit}: {level} limits without each {words.subject} (Bayesian)."
        heads = ["Without", *(row.environment for row in own)]
        tables.append(Table(caption, heads, lines))
    return Section(
        "without",
        f"The average {words.user} without each {words.subject}",
        [
            "The posterior draws count by the weights of leave-one-out cross-validation. To leave a"
            f" {words.subject} out for good, set exclude in [sessions]."
        ],
        tables,
        is_folded=True,
    )


def _left_out(row: Any, index: int) -> Cell:
    """Return the interval without one subject."""
    if row.estimate[index] is None:
        return ("unreliable",)
    digits = digits_of(row.estimate[index], row.lower[index], row.upper[index])

    def cell(name: str) -> Cell:
        return value(row, name, index, digits=digits)

    return (*cell("estimate"), " (", *cell("lower"), " to ", *cell("upper"), ")")
