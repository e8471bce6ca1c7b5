"""What to know before relying on the numbers: cautions of the first screen, from the results."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from scipy import special

from percept.errors import capitalised, counted
from percept.report.decisions import doubtful_verdicts, judged_verdicts
from percept.report.numbers import short
from percept.report.select import (
    METHODS,
    MOST_OPEN,
    Words,
    distinct,
    family_of,
    listed,
    matching,
    words_of,
)
from percept.results import (
    Checks,
    Data,
    IntervalRow,
    Note,
    Rendered,
    Results,
    Skipped,
)

__all__ = ["cautions", "misfits", "overruled"]

_FEW = 5  # fewer subjects than this are called few
#: Shift, in half-widths of the classical interval, from which on pooling is told: at 95 % it takes
#: an interval of that width to a coverage of 92 %.
_PULLED = 0.25
#: What a statistic of a cell says of the data where it is too high or too low for the model.
_UNEXPECTED = {
    ("mean", "high"): "the mean of {quantity} is higher",
    ("mean", "low"): "the mean of {quantity} is lower",
    ("sd", "high"): "{subjects} differ more in {quantity}",
    ("sd", "low"): "{subjects} differ less in {quantity}",
    ("farthest", "high"): "one {subject} lies farther from the others in {quantity}",
    ("farthest", "low"): "the {subjects} lie closer together in {quantity}",
}
#: Classical standard errors between the model's mean and the data's from which one is told first.
_OVERRULED = 2.0
_WARNINGS = 3  # the summary repeats the reader's first warnings


def cautions(results: Results) -> list[str]:
    """Return the cautions of results, those that change their meaning first."""
    diagnostics = results.diagnostics
    words = words_of(results)
    said = [*_left_out(results.skipped)]
    said += _other_family(results)
    if diagnostics and diagnostics.gate.passed and not diagnostics.gate.tolerance_met:
        said.append(diagnostics.gate.error_reached)
    said += doubtful_verdicts(judged_verdicts(results.verdicts, results.rendering or ()), words)
    said += _pooled(results, words)
    said += _at_limits(results.intervals, results.data)
    said += _few(results.intervals, words)
    if family_of(results) == "normal":
        said += _below_zero(results.intervals, results.data)
    said += _growing(results.rendering or (), words)
    if results.checks:
        said += misfits(results.checks, family_of(results), words)
    said += _warnings(results.data.doubts)
    return said


def _left_out(skipped: Sequence[Skipped]) -> Iterator[str]:
    """Say what the hierarchical model is missing, or that there is none."""
    for row in skipped:
        if row.what.endswith(", in the hierarchical model"):
            yield f"The hierarchical model leaves out {row.what.partition(',')[0]}: {row.why}."
        elif row.what == "Bayesian intervals":
            yield f"There are no Bayesian intervals: {row.why}"


def _other_family(results: Results) -> Iterator[str]:
    """Say which environments have intervals of the normal family alone."""
    means = matching(results.intervals, kind="mean", joint="marginal")
    for parameter in distinct(means, "parameter"):
        of_quantity = matching(means, parameter=parameter)
        own = distinct(matching(of_quantity, family=family_of(results)), "environment")
        others = [name for name in distinct(of_quantity, "environment") if name not in own]
        if own and others:
            yield (
                f"Intervals of {results.data.quantities[parameter].label} are of the normal family"
                f" in {listed(others)}, where values of zero or below have no logarithm, and of the"
                f" {family_of(results)} family in {listed(own)}."
            )


def _pooled(results: Results, words: Words) -> Iterator[str]:
    """Say where the hierarchical model draws a mean far towards the others."""
    means = matching(results.intervals, kind="mean", joint="marginal", family=family_of(results))
    for parameter in distinct(means, "parameter"):
        of_quantity = matching(means, parameter=parameter)
        classical = {row.environment: row for row in matching(of_quantity, method="classical")}
        shifts = {}
        for row in matching(of_quantity, method="bayesian"):
            if row.environment in classical:
                shifts[row.environment] = _shift(row, classical[row.environment])
        environment = max(shifts, key=shifts.__getitem__, default=None)
        if environment is None or len(shifts) == 1 or shifts[environment] < _PULLED:
            continue
        plain = classical[environment]
        pooled = matching(of_quantity, method="bayesian", environment=environment)[0]
        unit = f" {plain.unit}" if plain.unit else ""
        yield (
            f"The hierarchical model draws {words.environments} towards each other. Its mean"
            f" {results.data.quantities[parameter].label} of {environment} is"
            f" {_short(pooled.estimate)}{unit}; that of the data is {_short(plain.estimate)}{unit},"
            " as in the classical interval."
        )


def overruled(results: Results, words: Words) -> list[str]:
    """Say where the model's mean lies far from that of the data, by its own standard error."""
    means = matching(results.intervals, kind="mean", joint="marginal", family=family_of(results))
    classical = {
        (row.parameter, row.environment): row for row in matching(means, method="classical")
    }
    named = []
    for row in matching(means, method="bayesian"):
        of_data = classical.get((row.parameter, row.environment))
        if of_data is None:
            continue
        half_width = -special.stdtrit(of_data.n - 1.0, 0.5 * (1.0 - of_data.level))
        if half_width * _shift(row, of_data) > _OVERRULED:
            label = results.data.quantities[row.parameter].label
            unit = f" {row.unit}" if row.unit else ""
            named.append(
                f"{label} of {row.environment} ({_short(row.estimate)} instead of"
                f" {_short(of_data.estimate)}{unit})"
            )
    if not named:
        return []
    return [
        f"The Bayesian mean lies more than two standard errors from the {words.subjects}’ mean in"
        f" {_first_of(named)}. Use the classical interval, or wider [model.priors]."
    ]


def _shift(row: IntervalRow, classical: IntervalRow) -> float:
    """Distance of two estimates in half-widths of the classical interval."""
    ends = [row.estimate, classical.estimate, classical.lower, classical.upper]
    if row.family == "lognormal":
        ends = [math.log(value) for value in ends]
    estimate, plain, lower, upper = ends
    return 2.0 * abs(estimate - plain) / (upper - lower) if upper > lower else 0.0


def _short(value: float | None) -> str:
    return "–" if value is None else short(value)


def _at_limits(intervals: Sequence[IntervalRow], data: Data) -> Iterator[str]:
    """Say what intervals leave out at the limits of a control."""
    for name, quantity in data.quantities.items():
        rows = matching(intervals, parameter=name)
        counts = {row.environment: row.left_out for row in rows if row.left_out}
        if counts:
            where = ", ".join(f"{count} in {place}" for place, count in counts.items())
            yield (
                f"Intervals of {quantity.label} leave out adjustments at the limits of the"
                f" control: {where}."
            )


def _few(intervals: Sequence[IntervalRow], words: Words) -> Iterator[str]:
    subjects = max((row.n for row in intervals), default=_FEW)
    if subjects < _FEW:
        rest = {
            "classical": f"classical limits rest on {counted(subjects - 1, 'degree')} of freedom",
            "bayesian": "Bayesian limits rest largely on the priors",
        }
        methods = [rest[method] for method in METHODS if matching(intervals, method=method)]
        yield f"{subjects} {words.subjects} are few: {', '.join(methods)}."


def _below_zero(intervals: Sequence[IntervalRow], data: Data) -> Iterator[str]:
    cells: dict[str, dict[str, None]] = {}
    # What people set below zero is a quantity that may lie there. Ratings and changes may, too.
    signed = {cell.parameter for cell in data.cells if min(cell.values, default=0.0) < 0}
    signed |= {name for name, quantity in data.quantities.items() if not quantity.is_matched}
    for row in matching(intervals, family="normal", joint="marginal"):
        if row.parameter in signed:
            continue
        if row.lower < 0 <= (row.reference or 0.0):
            cells.setdefault(row.kind, {})[f"{row.parameter} of {row.environment}"] = None
    if cells:
        labels = " or ".join(
            quantity.label for name, quantity in data.quantities.items() if name not in signed
        )
        where = "; ".join(f"{kind}: {_first_of(list(names))}" for kind, names in cells.items())
        yield (
            f"Some limits of the normal family are below zero, where no {labels} can be ({where})."
            " Limits of the lognormal family never are."
        )


def _growing(rendering: Sequence[Rendered], words: Words) -> Iterator[str]:
    rows = matching(rendering, coupled=False, verdict="cannot")
    if rows:
        yield (
            f"Rendered directly, {_first_of([str(row.environment) for row in rows])} may chatter:"
            f" with some hands the motion grows. {capitalised(words.users)} may then set them"
            " wrongly."
        )


def misfits(checks: Checks, family: str, words: Words) -> Iterator[str]:
    """Say what the checks of the model found, in the family of the study."""
    rows = matching(checks.normality, family=family)
    # Bonferroni over the cells tested: a study of many cells is not alarmed by chance.
    cells = [
        f"{row.parameter} in {row.environment}" for row in rows if row.p_value * len(rows) < 0.05
    ]
    if cells:
        yield (
            f"Shapiro–Wilk tests reject the {family} family, which classical intervals"
            f" assume, for {_first_of(cells)}."
        )
    if checks.loo:
        yield from checks.loo.messages
        unusual = matching(checks.statistics, unusual=True)
        found = []
        for check in unusual:
            # Where the data have too little of it, most new studies have more.
            side = "low" if check.above > 0.5 else "high"
            what = _UNEXPECTED[check.statistic, side].format(
                subject=words.subject, subjects=words.subjects, quantity=check.parameter
            )
            found.append(f"in {check.environment} {what}")
        if found:
            of_all = f"{len(found)} of {counted(len(checks.statistics), 'check')}"
            yield f"{capitalised('; '.join(found))} than the model expects ({of_all})."


def _first_of(names: Sequence[str]) -> str:
    """List names; of more than ten, the first ten and the number of the others."""
    if len(names) <= MOST_OPEN:
        return listed(names)
    return f"{', '.join(names[:MOST_OPEN])} and {len(names) - MOST_OPEN} more"


def _warnings(warnings: Sequence[Note]) -> Iterator[str]:
    for warning in warnings[:_WARNINGS]:
        where = f"{warning.file}:{warning.row}: " if warning.file else ""
        stop = "" if warning.text.endswith(("?", ".")) else "."
        yield f"{where}{warning.text}{stop}"
    if len(warnings) > _WARNINGS:
        yield f"Data lists {len(warnings) - _WARNINGS} more to look at."
