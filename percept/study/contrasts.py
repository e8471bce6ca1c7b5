"""Contrasts of factors, groups and covariates: of bias and of spread, per reference and overall."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, counted
from percept.inference.classical.contrasts import (
    group_contrast,
    group_spread_ratio,
    paired_contrast,
    spread_ratio,
)
from percept.inference.classical.moments import Moments
from percept.results import ContrastRow, Skipped
from percept.sessions.records import Factors
from percept.study.basics import claim_of
from percept.study.comparisons import Comparison, averaged, comparisons, level_means
from percept.study.conditions import Conditions
from percept.study.contrast_table import ContrastTable
from percept.study.data import Data
from percept.study.subject_cells import SubjectCells, log_trial_sds, subject_cells

# The classical contrasts do without the model.
if TYPE_CHECKING:
    from percept.study.fit import Fit

_Rows = Iterator[ContrastRow | Skipped]


def contrast_rows(data: Data, fit: Fit | None) -> _Rows:
    """Yield the contrasts of every method that was asked for; of the Bayesian one from its fit."""
    factors = data.sessions.factors
    tables = {parameter: ContrastTable(data, parameter) for parameter in data.parameters}
    if data.asked.method != "bayesian":
        for table, column in itertools.product(tables.values(), data.conditions.covariates):
            what = f"classical slope of {table.label} on {column}"
            yield Skipped(what, "only the hierarchical model estimates slopes")
        for table in tables.values():
            if factors is not None:
                yield from _classical(table, factors)
    if fit is not None:
        # The classical method does without the model.
        from percept.study.posterior_contrasts import posterior_contrasts

        yield from posterior_contrasts(fit, tables)


def _classical(table: ContrastTable, factors: Factors) -> _Rows:
    """Yield intervals of subjects' own contrasts, and of groups of subjects."""
    data = table.data
    conditions = data.conditions
    try:
        own = data.subject_cells(table.parameter)
    except RefusalError as refused:
        yield Skipped(f"contrasts of {table.label}", str(refused))
        return
    yield from _within_subjects(own, conditions, factors, table)
    for *_, level in level_means(conditions, factors, list(factors.cells.values())):
        yield from _paired(own, own.own(level), np.isfinite(own.at_level(level)), table)
    yield from _between_subjects(own, conditions, factors, table)
    if conditions.precision:
        yield from _precision(table.of_trials, factors)


def _precision(table: ContrastTable, factors: Factors) -> _Rows:
    """Yield ratios of SDs between trials, by subjects' log SDs in place of their means."""
    conditions = table.data.conditions
    trials = table.data.trials(table.parameter)
    log_sds = log_trial_sds(trials)
    for i, cell in np.argwhere(np.isneginf(log_sds)).tolist():
        what = f"{trials.subjects[i]} in the {table.label}"
        why = f"all trials in {trials.environments[cell]} are equal, and zero has no logarithm"
        yield Skipped(what, why)
        log_sds[i] = np.nan
    own = subject_cells(log_sds, trials, factors, conditions.between)
    if not own.values:
        yield Skipped(table.label, "no subject repeats a trial in a cell")
        return
    yield from _within_subjects(own, conditions.precise, factors, table)
    yield from _between_subjects(own, conditions.precise, factors, table)


def _within_subjects(
    own: SubjectCells, conditions: Conditions, factors: Factors, table: ContrastTable
) -> _Rows:
    """Yield the contrasts that subjects have of their own."""
    of_subjects = conditions.only(
        [factor for factor in conditions.factors if factor not in conditions.between]
    )
    cells = list(own.values)
    names = list(factors.levels)
    levels = {names[place]: factors.levels[names[place]] for place in own.within}
    factors_within = Factors(levels, {str(cell): cell for cell in cells})
    for family in comparisons(of_subjects, factors_within, cells, table.label, table.lacking):
        if isinstance(family, Skipped):
            yield family
        else:
            yield from _of_subjects(own, family, table)


def _between_subjects(
    own: SubjectCells, conditions: Conditions, factors: Factors, table: ContrastTable
) -> _Rows:
    """Yield the contrasts of groups of subjects."""
    columns = tuple(factor for factor in conditions.factors if factor in conditions.between)
    if columns and len(conditions.between) > 1:
        what = f"classical contrasts of groups in {table.label}"
        yield Skipped(what, "Welch's test compares the groups of one column only")
        return
    terms = tuple(term for term in conditions.terms if set(term) & conditions.between)
    groups = dataclasses.replace(conditions, factors=columns, terms=terms)
    cells = list(factors.cells.values())
    for family in comparisons(groups, factors, cells, table.label, table.lacking):
        if isinstance(family, Skipped):
            yield family
            continue
        for comparison in family:
            yield from _of_groups(own, factors, comparison, table)


def _of_subjects(cells: SubjectCells, family: Sequence[Comparison], table: ContrastTable) -> _Rows:
    """Yield paired intervals and ratios of SDs, of each reference and of subjects' averages."""
    label = f"{table.label}, {family[0].versus}"
    each = [comparison for comparison in family if comparison.environment is not None]
    complete = np.array([np.isfinite(cells.weighed(one.weights)) for one in each])
    paired = np.any(complete, axis=0)
    unpaired = int((~paired).sum())
    if unpaired:
        who = counted(unpaired, "subject")
        yield Skipped(f"{who} in contrasts of {label}", "no reference has both levels")
    for comparison, subjects in zip(each, complete, strict=True):
        yield from _paired(cells, comparison, subjects, table)
    if len(cells.references) == 1:
        return
    of_all = [one for one, has in zip(each, complete[:, paired], strict=True) if has.all()]
    shared = [str(comparison.environment) for comparison in of_all]
    if not shared or not paired.any():
        why = "no reference has both levels for every subject"
        yield Skipped(f"overall contrast of {label}", why)
        return
    left = [name for name in cells.references if name not in shared]
    if left:
        what = f"{', '.join(left)} in the overall contrast of {label}"
        yield Skipped(what, "some subjects lack a level there")
    yield from _paired(cells, averaged(of_all), paired, table)


def _paired(
    cells: SubjectCells, comparison: Comparison, subjects: NDArray[np.bool_], table: ContrastTable
) -> _Rows:
    """Yield the rows of subjects who have every cell of a contrast."""
    asked = table.data.asked
    what = f"contrast of {table.label}, {comparison.versus}"
    if comparison.of != "level":
        what += f", in {comparison.environment}" if comparison.environment else ", overall"
    n = int(subjects.sum())
    if n < 2:
        yield Skipped(what, "fewer than two subjects have both levels")
        return
    weights = np.array(list(comparison.weights.values()))
    values = cells.in_cells(list(comparison.weights))[subjects]
    second = values @ np.maximum(weights, 0.0)
    first = values @ np.maximum(-weights, 0.0)
    try:
        for kind in table.kinds:
            interval, *of_mean = paired_contrast(second - first, kind, **claim_of(asked))
            p_value, d_z = of_mean if kind == "mean" else (None, None)
            ends = [interval.lower, interval.upper, interval.estimate]
            yield table.row(comparison, ends, n, "classical", kind, p_value=p_value, d_z=d_z)
        if comparison.of == "bias" and not table.is_of_trials:
            ratio = spread_ratio(first, second, level=asked.level)
            ends = [ratio.lower, ratio.upper, ratio.estimate]
            yield table.row(comparison, ends, ratio.n, "classical", p_value=ratio.p_value)
    except RefusalError as refused:
        yield Skipped(what, str(refused))


def _of_groups(
    cells: SubjectCells, factors: Factors, comparison: Comparison, table: ContrastTable
) -> _Rows:
    """Yield Welch's interval and the F interval of subjects' values in two groups."""
    ((column, levels),) = cells.groups.items()
    place = list(factors.levels).index(column)
    first, second = comparison.groups
    # Both groups' values weigh the same cells, which the second one's part of the contrast tells.
    of_second = {
        cell: weight for cell, weight in comparison.weights.items() if cell[1][place] == second
    }
    part = dataclasses.replace(comparison, weights=of_second)
    weighed = cells.weighed(cells.own(part).weights)
    samples = [weighed[np.isfinite(weighed) & (levels == level)] for level in (first, second)]
    where = comparison.environment or "overall"
    what = f"contrast of {table.label}, {comparison.versus}, {where}"
    if min(len(sample) for sample in samples) < 2:
        yield Skipped(what, "a group has fewer than two subjects with all cells")
        return
    moments = [Moments.from_values(sample) for sample in samples]
    if min(float(part.sd) for part in moments) == 0.0:
        yield Skipped(what, "all subjects of a group have one value")
        return
    n = sum(len(sample) for sample in samples)
    level = table.data.asked.level
    found = group_contrast(*moments, level=level)
    ends = [found.lower, found.upper, found.estimate]
    yield table.row(comparison, ends, n, "classical", "mean", p_value=found.p_value)
    if comparison.of == "bias" and not table.is_of_trials:
        ratio = group_spread_ratio(*moments, level=level)
        ends = [ratio.lower, ratio.upper, ratio.estimate]
        yield table.row(comparison, ends, n, "classical", p_value=ratio.p_value)
