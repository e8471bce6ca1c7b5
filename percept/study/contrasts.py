"""Contrasts of factors, groups and covariates: of bias and of spread, per reference and overall."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

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
from percept.inference.classical.trials import subject_means
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.records import Factors
from percept.study.basics import Skipped, claim_of
from percept.study.conditions import (
    CellKey,
    Comparison,
    Conditions,
    comparisons,
    conditions_of,
    level_means,
)
from percept.study.contrast_table import ContrastTable
from percept.study.intervals import Row
from percept.study.responses import Trials, by_difference, trials

# The classical contrasts do without the model.
if TYPE_CHECKING:
    from percept.inference.hierarchy.contrasts import ContrastLimits
    from percept.inference.sampling.gate import Run
    from percept.study.linear import LinearStudy

__all__ = ["contrast_rows"]


def contrast_rows(
    sessions: Sessions, parameters: tuple[str, ...], scene: Scene, **how: Any
) -> Iterator[Row | Skipped]:
    """Yield the contrasts of every method asked for; `how` is the sampler's progress and store."""
    asked = scene.inference
    conditions = conditions_of(sessions, scene)
    factors = sessions.factors
    told: dict[str, ContrastTable] = {}
    for p in parameters:
        told[p] = ContrastTable(
            quantity=sessions.quantities[p],
            asked=asked,
            alone=len(parameters) == 1,
            scale=scene.model.scale.get(p) if by_difference(sessions, p) else None,
            subjects=len(sessions.subjects),
            references=len(factors.environments if factors else sessions.environments),
            users=scene.user_noun,
        )
    if asked.method != "bayesian" and factors is not None:
        for p in parameters:
            try:
                data = trials(sessions, scene, (p,))
            except RefusalError as refused:
                yield Skipped(f"contrasts of {sessions.quantities[p].label}", str(refused))
                continue
            yield from _classical(data, conditions, factors, told[p])
    if asked.method != "classical":
        # The classical method does without the model.
        from percept.study.fit import modelled_together

        for group in modelled_together(parameters, asked.together):
            yield from _bayesian(sessions, scene, conditions, group, told, **how)


def _classical(
    data: Trials, conditions: Conditions, factors: Factors, told: ContrastTable
) -> Iterator[Row | Skipped]:
    """Yield intervals of subjects' own contrasts, and of groups of subjects."""
    own = _subject_means(data, factors, conditions.between)
    within = [factor for factor in conditions.factors if factor not in conditions.between]
    reduced = dataclasses.replace(
        conditions,
        factors=tuple(within),
        terms=tuple(term for term in conditions.terms if set(term) <= set(within)),
    )
    levels = {factor: factors.levels[factor] for factor in within}
    cells = {str(cell): cell for cell in _keys(own)}
    of_subjects = comparisons(reduced, Factors(levels, cells), _keys(own))
    for _, family in itertools.groupby(of_subjects, _told_together):
        yield from _of_subjects(own, list(family), told)
    cells_of_all = list(factors.cells.values())
    for comparison in level_means(conditions, factors, cells_of_all):
        yield from _of_level(own, data, conditions, factors, comparison, told)
    if len(conditions.between) > 1:
        what = f"classical contrasts of groups in {told.quantity.label}"
        yield Skipped(what, "two columns of groups are more than Welch's test takes")
        return
    for comparison in comparisons(conditions, factors, cells_of_all):
        if not comparison.within:
            yield from _of_groups(own, data, conditions, factors, comparison, told)


def _told_together(comparison: Comparison) -> tuple[str, str, str]:
    """Name what the contrasts of all references, and of their average, have in common."""
    return comparison.factor, comparison.first, comparison.second


def _subject_means(data: Trials, factors: Factors, without: frozenset[str]) -> pd.DataFrame:
    """Subjects' means on the model's scale, a column per cell; levels of some factors left out."""
    kept = [number for number, name in enumerate(factors.levels) if name not in without]
    means: dict[CellKey, list[pd.Series[float]]] = {}
    for code, cell in enumerate(data.environments):
        environment, levels = factors.cells[cell]
        rows = data.environment == code
        subjects = data.subject[rows]
        values = subject_means(data.response[rows, 0], subjects).values
        series = pd.Series(values, index=list(dict.fromkeys(subjects.tolist())))
        key = (environment, tuple(levels[number] for number in kept))
        means.setdefault(key, []).append(series)
    table = pd.DataFrame({number: pd.concat(parts) for number, parts in enumerate(means.values())})
    table.columns = pd.Index(list(means), tupleize_cols=False)
    return table


def _groups(data: Trials, factors: Factors, column: str) -> pd.Series[str]:
    """Return the group of every subject in a column."""
    groups: dict[int, str] = {}
    for code, cell in enumerate(data.environments):
        level = factors.level(cell, column)
        for subject in np.unique(data.subject[data.environment == code]).tolist():
            groups[subject] = level
    return pd.Series(groups, dtype=object)


def _complete(values: pd.DataFrame, weights: Mapping[CellKey, float]) -> pd.DataFrame:
    """Subjects who have every cell that is weighed."""
    keys = pd.Index(list(weights), tupleize_cols=False)
    return values.reindex(columns=keys).dropna()


def _of_subjects(
    values: pd.DataFrame, family: Sequence[Comparison], told: ContrastTable
) -> Iterator[Row | Skipped]:
    """Yield paired intervals and ratios of SDs, of each reference and of subjects' averages."""
    label = f"{told.quantity.label}, {family[0].second} against {family[0].first}"
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
        yield from _paired(own, comparison, told, what)
    if len(_references_of(values)) == 1:
        return
    shared = [str(name) for name in complete.columns[complete[paired].all(axis=0)]]
    if not shared or not paired.any():
        why = "no reference has both levels for every subject"
        yield Skipped(f"overall contrast of {label}", why)
        return
    left = [name for name in _references_of(values) if name not in shared]
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
    yield from _paired(values[paired], overall, told, f"{label}, overall")


def _keys(values: pd.DataFrame) -> list[CellKey]:
    """Return the cells of a table."""
    return cast(list[CellKey], list(values.columns))


def _references_of(values: pd.DataFrame) -> list[str]:
    """Return the references that a table of cells has."""
    return list(dict.fromkeys(environment for environment, _ in _keys(values)))


def _paired(
    values: pd.DataFrame, comparison: Comparison, told: ContrastTable, what: str
) -> Iterator[Row | Skipped]:
    """Yield the rows of subjects who have every cell of a contrast."""
    asked = told.asked
    n = len(values)
    if n < 2:
        yield Skipped(f"contrast of {what}", "fewer than two subjects have both levels")
        return
    cells = list(comparison.weights)
    weights = np.array([comparison.weights[cell] for cell in cells])
    table = values[cells].to_numpy(dtype=float)
    second = table @ np.maximum(weights, 0.0)
    first = table @ np.maximum(-weights, 0.0)
    try:
        for kind in asked.kinds:
            interval, p_value = paired_contrast(second - first, kind, **claim_of(asked))
            limits = np.array([interval.lower, interval.upper, interval.estimate], dtype=float)
            yield told.row(
                comparison,
                limits,
                n,
                method="classical",
                kind=kind,
                p_value=p_value if kind == "mean" else None,
            )
        if comparison.of != "bias":
            return
        ratio = spread_ratio(first, second, level=asked.level)
    except RefusalError as refused:
        yield Skipped(f"contrast of {what}", str(refused))
        return
    limits = np.array([ratio.lower, ratio.upper, ratio.estimate])
    yield told.row(comparison, limits, ratio.n, method="classical", p_value=ratio.p_value)


def _of_level(
    values: pd.DataFrame,
    data: Trials,
    conditions: Conditions,
    factors: Factors,
    comparison: Comparison,
    told: ContrastTable,
) -> Iterator[Row | Skipped]:
    """Yield intervals of subjects' means at one level, over all references."""
    kept = [number for number, name in enumerate(factors.levels) if name not in conditions.between]
    weights: dict[CellKey, float] = {}
    for (environment, levels), weight in comparison.weights.items():
        key = (environment, tuple(levels[number] for number in kept))
        weights[key] = weights.get(key, 0.0) + weight
    table = _complete(values, weights)
    if comparison.factor in conditions.between:
        group = _groups(data, factors, comparison.factor)
        table = table[(group[table.index] == comparison.second).to_numpy()]
    own = dataclasses.replace(comparison, weights=weights)
    what = f"{told.quantity.label}, {comparison.second} against {comparison.first}"
    yield from _paired(table, own, told, what)


def _of_groups(
    values: pd.DataFrame,
    data: Trials,
    conditions: Conditions,
    factors: Factors,
    comparison: Comparison,
    told: ContrastTable,
) -> Iterator[Row | Skipped]:
    """Yield Welch's interval and the F interval of subjects' values in two groups."""
    (column,) = conditions.between
    place = list(factors.levels).index(column)
    first, second = comparison.groups
    # Both groups' values weigh the same cells, which the second one's part of the contrast tells.
    weights: dict[CellKey, float] = {}
    for (environment, levels), weight in comparison.weights.items():
        if levels[place] == second:
            weights[environment, (*levels[:place], *levels[place + 1 :])] = weight
    table = _complete(values, weights)
    group = _groups(data, factors, column)
    weighed = table.to_numpy(dtype=float) @ np.array(list(weights.values()))
    own = group[table.index]
    samples = [weighed[(own == level).to_numpy()] for level in (first, second)]
    n = sum(len(sample) for sample in samples)
    where = comparison.environment or "overall"
    what = f"contrast of {told.quantity.label}, {comparison.second} against {comparison.first}"
    if min(len(sample) for sample in samples) < 2:
        yield Skipped(f"{what}, {where}", "a group has fewer than two subjects with all cells")
        return
    moments = [Moments.from_values(sample) for sample in samples]
    if min(float(part.sd) for part in moments) == 0.0:
        yield Skipped(f"{what}, {where}", "all subjects of a group have one value")
        return
    level = told.asked.level
    means = group_contrast(*moments, level=level)
    ends = [means.lower, means.upper, means.estimate]
    yield told.row(comparison, ends, n, method="classical", kind="mean", p_value=means.p_value)
    if comparison.interaction:
        return
    ratio = group_spread_ratio(*moments, level=level)
    ends = [ratio.lower, ratio.upper, ratio.estimate]
    yield told.row(comparison, ends, n, method="classical", p_value=ratio.p_value)


def _bayesian(
    sessions: Sessions,
    scene: Scene,
    conditions: Conditions,
    parameters: tuple[str, ...],
    told: Mapping[str, ContrastTable],
    **how: Any,
) -> Iterator[Row | Skipped]:
    """Yield every contrast from one posterior of all cells."""
    from percept.study.fit import sampled
    from percept.study.linear import linear_study

    what = " and ".join(sessions.quantities[p].label for p in parameters)
    try:
        study = linear_study(sessions, scene, parameters, conditions)
    except RefusalError as refused:
        yield Skipped(f"Bayesian contrasts of {what}", str(refused))
        return
    run = sampled(study.model, scene.inference, study.estimands, **how)
    if not run.gate.passed:
        yield Skipped(f"Bayesian contrasts of {what}", " ".join(run.gate.reasons))
        return
    components = run.components.reshape(-1, run.components.shape[-1])
    limits = study.estimands.limits(run.estimates.value, components)
    yield from _rows_of(study, limits, told)
    yield from _spread_rows(study, run, told)
    if run.gate.error_reached:
        yield Skipped(f"the tolerance in Bayesian contrasts of {what}", run.gate.error_reached)


def _rows_of(
    study: LinearStudy, limits: ContrastLimits, told: Mapping[str, ContrastTable]
) -> Iterator[Row]:
    """Yield the rows of a finished posterior."""
    method = "bayesian"
    for number, (p, comparison) in enumerate(study.users):
        n = study.subjects_of(comparison, p)
        for kind, (lower, upper) in limits.users.items():
            ends = [lower[number], upper[number], limits.users_estimate[number]]
            yield told[p].row(comparison, ends, n, method=method, kind=kind)
    for number, (p, comparison) in enumerate(study.groups):
        lower, upper = limits.groups[:, number] / comparison.unit
        ends = [lower, upper, limits.groups_estimate[number] / comparison.unit]
        n = study.subjects_of(comparison, p)
        yield told[p].row(comparison, ends, n, method=method, kind="mean")


def _spread_rows(
    study: LinearStudy, run: Run, told: Mapping[str, ContrastTable]
) -> Iterator[Row | Skipped]:
    """Yield the ratios of SDs between users of a finished posterior."""
    from percept.inference.sampling.lines import line_limits

    for number, (p, comparison) in enumerate(study.spreads):
        own = told[p]
        limits = line_limits(study.model, run, study.log_ratio(number), own.asked.level)
        ends = np.exp([limits.lower, limits.upper, limits.median])
        yield own.row(comparison, ends, study.subjects_of(comparison, p), method="bayesian")
        if limits.error > own.asked.tolerance:
            where = comparison.environment or "overall"
            what = f"{own.quantity.label}, {comparison.second} against {comparison.first}, {where}"
            error = f"{100.0 * limits.error:.2g} %"
            why = f"the Monte Carlo error of its limits is {error} of a half-width"
            yield Skipped(f"the tolerance in the ratio of SDs of {what}", why)
