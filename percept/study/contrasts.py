"""Contrasts of factors, groups and covariates: of bias and of spread, per reference and overall."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from percept.errors import RefusalError, counted
from percept.inference.classical.contrasts import (
    group_contrast,
    group_spread_ratio,
    paired_contrast,
    spread_ratio,
)
from percept.inference.classical.moments import Moments
from percept.results import ContrastRow
from percept.sessions.records import Factors
from percept.study.basics import Skipped, claim_of
from percept.study.conditions import (
    CellKey,
    Comparison,
    Conditions,
    comparisons,
    level_means,
    without_data,
)
from percept.study.contrast_table import ContrastTable
from percept.study.data import Data
from percept.study.subject_cells import SubjectCells

# The classical contrasts do without the model.
if TYPE_CHECKING:
    from percept.study.fit import Fit

__all__ = ["contrast_rows"]


def contrast_rows(data: Data, fit: Fit | None) -> Iterator[ContrastRow | Skipped]:
    """Yield the contrasts of every method that was asked for; of the Bayesian one from its fit."""
    conditions = data.conditions
    factors = data.sessions.factors
    tables = {parameter: ContrastTable(data, parameter) for parameter in data.parameters}
    if data.asked.method != "bayesian":
        for table, column in itertools.product(tables.values(), conditions.covariates):
            what = f"classical slope of {table.quantity.label} on {column}"
            yield Skipped(what, "only the hierarchical model estimates slopes")
    if data.asked.method != "bayesian" and factors is not None:
        for parameter, table in tables.items():
            try:
                own = data.subject_cells(parameter)
            except RefusalError as refused:
                yield Skipped(f"contrasts of {table.quantity.label}", str(refused))
                continue
            yield from _classical(own, conditions, factors, table)
    if fit is not None:
        # The classical method does without the model.
        from percept.study.posterior_contrasts import posterior_contrasts

        if factors is not None and fit.contrasts is not None:
            cells = [factors.cells[name] for name in fit.environments]
            for table in tables.values():
                yield from without_data(conditions, factors, cells, table.quantity.label)
        yield from posterior_contrasts(fit, tables)


def _classical(
    own: SubjectCells, conditions: Conditions, factors: Factors, table: ContrastTable
) -> Iterator[ContrastRow | Skipped]:
    """Yield intervals of subjects' own contrasts, and of groups of subjects."""
    within = [factor for factor in conditions.factors if factor not in conditions.between]
    reduced = dataclasses.replace(
        conditions,
        factors=tuple(within),
        terms=tuple(term for term in conditions.terms if set(term) <= set(within)),
    )
    levels = {factor: factors.levels[factor] for factor in within}
    cells = {str(cell): cell for cell in own.cells}
    factors_within = Factors(levels, cells)
    of_subjects = comparisons(reduced, factors_within, own.cells)
    yield from without_data(reduced, factors_within, own.cells, table.quantity.label)
    for _, family in itertools.groupby(of_subjects, _told_together):
        yield from _of_subjects(own, list(family), table)
    cells_of_all = list(factors.cells.values())
    for comparison in level_means(conditions, factors, cells_of_all):
        yield from _of_level(own, comparison, table)
    if len(conditions.between) > 1:
        what = f"classical contrasts of groups in {table.quantity.label}"
        yield Skipped(what, "Welch's test compares the groups of one column only")
        return
    groups = dataclasses.replace(
        conditions,
        factors=tuple(conditions.between),
        terms=tuple(term for term in conditions.terms if set(term) & conditions.between),
    )
    yield from without_data(groups, factors, cells_of_all, table.quantity.label)
    for comparison in comparisons(groups, factors, cells_of_all):
        yield from _of_groups(own, factors, comparison, table)


def _told_together(comparison: Comparison) -> tuple[str, str, str]:
    """Name what the contrasts of all references, and of their average, have in common."""
    return comparison.factor, comparison.first, comparison.second


def _of_subjects(
    cells: SubjectCells, family: Sequence[Comparison], table: ContrastTable
) -> Iterator[ContrastRow | Skipped]:
    """Yield paired intervals and ratios of SDs, of each reference and of subjects' averages."""
    values = cells.values
    label = f"{table.quantity.label}, {family[0].second} against {family[0].first}"
    each = [comparison for comparison in family if comparison.environment is not None]
    complete = pd.DataFrame(
        {
            comparison.environment: values[list(comparison.weights)].notna().all(axis=1)
            for comparison in each
        }
    )
    paired = complete.any(axis=1)
    unpaired = int((~paired).sum())
    if unpaired:
        who = counted(unpaired, "subject")
        yield Skipped(f"{who} in contrasts of {label}", "no reference has both levels")
    for comparison in each:
        own = values[complete[comparison.environment]]
        what = f"{label}, in {comparison.environment}"
        yield from _paired(own, comparison, table, what)
    if len(cells.references) == 1:
        return
    shared = [str(name) for name in complete.columns[complete[paired].all(axis=0)]]
    if not shared or not paired.any():
        why = "no reference has both levels for every subject"
        yield Skipped(f"overall contrast of {label}", why)
        return
    left = [name for name in cells.references if name not in shared]
    if left:
        what = f"{', '.join(left)} in the overall contrast of {label}"
        yield Skipped(what, "some subjects lack a level there")
    weights: dict[CellKey, float] = {}
    for comparison in each:
        if comparison.environment in shared:
            for cell, weight in comparison.weights.items():
                weights[cell] = weight / len(shared)
    overall = dataclasses.replace(
        each[0], environment=None, references=tuple(shared), weights=weights
    )
    yield from _paired(values[paired], overall, table, f"{label}, overall")


def _paired(
    values: pd.DataFrame, comparison: Comparison, table: ContrastTable, what: str
) -> Iterator[ContrastRow | Skipped]:
    """Yield the rows of subjects who have every cell of a contrast."""
    inference = table.inference
    n = len(values)
    if n < 2:
        yield Skipped(f"contrast of {what}", "fewer than two subjects have both levels")
        return
    cells = list(comparison.weights)
    weights = np.array([comparison.weights[cell] for cell in cells])
    subject_values = values[cells].to_numpy(dtype=float)
    second = subject_values @ np.maximum(weights, 0.0)
    first = subject_values @ np.maximum(-weights, 0.0)
    try:
        for kind in inference.kinds:
            interval, p_value = paired_contrast(second - first, kind, **claim_of(inference))
            limits = np.array([interval.lower, interval.upper, interval.estimate], dtype=float)
            yield table.row(
                comparison,
                limits,
                n,
                method="classical",
                kind=kind,
                p_value=p_value if kind == "mean" else None,
            )
        if comparison.of != "bias":
            return
        ratio = spread_ratio(first, second, level=inference.level)
    except RefusalError as refused:
        yield Skipped(f"contrast of {what}", str(refused))
        return
    limits = np.array([ratio.lower, ratio.upper, ratio.estimate])
    yield table.row(comparison, limits, ratio.n, method="classical", p_value=ratio.p_value)


def _of_level(
    cells: SubjectCells, comparison: Comparison, table: ContrastTable
) -> Iterator[ContrastRow | Skipped]:
    """Yield intervals of subjects' means at one level, over all references."""
    subject_values = cells.values[cells.at_level(comparison).notna()]
    own = dataclasses.replace(comparison, weights=cells.weights(comparison.weights))
    what = f"{table.quantity.label}, {comparison.second} against {comparison.first}"
    yield from _paired(subject_values, own, table, what)


def _of_groups(
    cells: SubjectCells, factors: Factors, comparison: Comparison, table: ContrastTable
) -> Iterator[ContrastRow | Skipped]:
    """Yield Welch's interval and the F interval of subjects' values in two groups."""
    (column,) = map(str, cells.groups)
    place = list(factors.levels).index(column)
    first, second = comparison.groups
    # Both groups' values weigh the same cells, which the second one's part of the contrast tells.
    of_second = {
        cell: weight for cell, weight in comparison.weights.items() if cell[1][place] == second
    }
    weighed = cells.weighed(cells.weights(of_second)).dropna()
    own = cells.groups[column][weighed.index]
    samples = [weighed[own == level].to_numpy() for level in (first, second)]
    n = sum(len(sample) for sample in samples)
    where = comparison.environment or "overall"
    what = f"contrast of {table.quantity.label}, {comparison.second} against {comparison.first}"
    if min(len(sample) for sample in samples) < 2:
        yield Skipped(f"{what}, {where}", "a group has fewer than two subjects with all cells")
        return
    moments = [Moments.from_values(sample) for sample in samples]
    if min(float(part.sd) for part in moments) == 0.0:
        yield Skipped(f"{what}, {where}", "all subjects of a group have one value")
        return
    level = table.inference.level
    means = group_contrast(*moments, level=level)
    ends = [means.lower, means.upper, means.estimate]
    yield table.row(comparison, ends, n, method="classical", kind="mean", p_value=means.p_value)
    if comparison.interaction:
        return
    ratio = group_spread_ratio(*moments, level=level)
    ends = [ratio.lower, ratio.upper, ratio.estimate]
    yield table.row(comparison, ends, n, method="classical", p_value=ratio.p_value)
