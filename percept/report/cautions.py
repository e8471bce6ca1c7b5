"""What to know before relying on the numbers: cautions of the first screen, from the results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from percept.errors import counted
from percept.report.select import (
    METHODS,
    MOST_OPEN,
    STATISTICS,
    Words,
    distinct,
    listed,
    matching,
    words_of,
)
from percept.results import (
    Checks,
    ContrastRow,
    Data,
    IntervalRow,
    Note,
    Passivity,
    Results,
    Skipped,
)

__all__ = ["cautions", "misfits"]

_FEW = 5  # fewer subjects than this are called few
_WARNINGS = 4  # the summary repeats the reader's first warnings


def cautions(results: Results) -> list[str]:
    """Return the cautions of results, those that change their meaning first."""
    diagnostics = results.diagnostics
    words = words_of(results)
    said = [*_levels(results.contrast, words), *_left_out(results.skipped)]
    if diagnostics and diagnostics.gate.passed and not diagnostics.gate.tolerance_met:
        said.append(diagnostics.gate.error_reached)
    if diagnostics:
        said += diagnostics.pull
    if results.checks:
        said += results.checks.pull
    said += _at_limits(results.intervals, results.data)
    said += _few(results.intervals, words)
    said += _below_zero(results.intervals, results.data)
    said += _active(results.passivity or (), words)
    if results.checks:
        said += misfits(results.checks, words)
    said += _warnings(results.data.doubts)
    # The pull of priors is a misfit of the model, too.
    return list(dict.fromkeys(said))


def _levels(contrast: Sequence[ContrastRow], words: Words) -> Iterator[str]:
    """Say what the levels of factors are to everything but the contrasts."""
    if contrast:
        factors = distinct(contrast, "factor")
        its = "its" if len(factors) == 1 else "their"
        alone = "Outside"
        if matching(contrast, method="bayesian"):
            of_all = "One model of all levels gives every Bayesian result."
            alone = f"{of_all} In classical results, outside"
        within = matching(contrast, within=True)
        how = f"levels within {words.subjects}" if within else f"{its} levels"
        yield (
            f"{alone} the section on {listed(factors)} each of {its} levels stands by itself. "
            f"Only that section compares {how}."
        )


def _left_out(skipped: Sequence[Skipped]) -> Iterator[str]:
    """Say what the hierarchical model is missing, or that there is none."""
    for row in skipped:
        if row.what.endswith(", in the hierarchical model"):
            yield f"The hierarchical model leaves out {row.what.partition(',')[0]}: {row.why}."
        elif row.what == "Bayesian intervals":
            yield f"There are no Bayesian intervals: {row.why}"


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
        if row.lower is None or row.parameter in signed:
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


def _active(passivity: Sequence[Passivity], words: Words) -> Iterator[str]:
    names = [row.environment for row in passivity if not row.passive]
    if names:
        yield (
            f"Without a coupling this device has too little damping to render {_first_of(names)}"
            f" passively (Colgate and Schenkel). They may chatter, and {words.users} may then"
            " set them wrongly."
        )


def misfits(checks: Checks, words: Words) -> Iterator[str]:
    """Say what the checks of the model found."""
    for family in distinct(checks.normality, "family"):
        rows = matching(checks.normality, family=family)
        # Bonferroni over the cells tested: a study of many cells is not alarmed by chance.
        cells = [
            f"{row.parameter} in {row.environment}"
            for row in rows
            if row.p_value * len(rows) < 0.05
        ]
        if cells:
            yield (
                f"Shapiro–Wilk tests reject the {family} family, which classical intervals"
                f" assume, for {_first_of(cells)}."
            )
    if checks.loo:
        yield from checks.loo.messages
        unusual = []
        for check in matching(checks.statistics, unusual=True):
            statistic = STATISTICS[check.statistic].format(subject=words.subject)
            unusual.append(f"{statistic} of {check.parameter} in {check.environment}")
        if unusual:
            yield f"The hierarchical model does not reproduce the {'; '.join(unusual)}."
        yield from checks.pull


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
