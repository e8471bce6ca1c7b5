"""Contrasts of factors and groups, levels, and the analysis of variance, by the classical method.

A subject's value in a cell is the mean of their trials there, on the response scale. What is
compared, and the rows of contrasts, are made here for both methods.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from percept.errors import RefusalError
from percept.inference.classical.contrasts import (
    Effect,
    anova,
    group_contrast,
    group_spread_ratio,
    paired_contrast,
    spread_ratio,
)
from percept.inference.classical.moments import Moments
from percept.inference.record import Kind, Method
from percept.results import AnovaRow, ContrastRow, LevelValues, Skipped
from percept.sessions.records import Factors
from percept.study.basics import Array, claim_of, known
from percept.study.comparisons import (
    Comparison,
    SubjectCells,
    comparisons,
    level_means,
    log_trial_sds,
    subject_cells,
)
from percept.study.conditions import Conditions
from percept.study.data import Data
from percept.study.responses import Trials

#: What the references are called as a factor: the column of the sessions.
ENVIRONMENT = "environment"


def compared(data: Data, trials: Trials, parameter: str) -> Iterator[Comparison | Skipped]:
    """Yield what is compared of a quantity in the cells of its trials."""
    factors = data.sessions.factors
    if factors is None:
        return
    conditions = data.conditions
    label = data.quantities[parameter].label
    cells = [factors.cells[name] for name in trials.environments]
    for found in comparisons(conditions, factors, cells, label):
        yield found
        if isinstance(found, Comparison) and found.of == "bias":
            yield dataclasses.replace(found, of="spread")
    for *_, mean in level_means(conditions, factors, cells):
        yield mean
    dfs = trials.statistics.trial_df
    repeated = [cell for cell, df in zip(cells, dfs, strict=True) if df > 0.0]
    precision = f"precision of {label}"
    precise = conditions.precise
    for found in comparisons(precise, factors, repeated, precision, "repeated trials"):
        if isinstance(found, Comparison):
            found = dataclasses.replace(found, of="precision")
        yield found


def classical_contrasts(data: Data) -> Iterator[ContrastRow | Skipped]:
    """Yield intervals of subjects' own contrasts, and of groups of subjects."""
    factors = data.sessions.factors
    conditions = data.conditions
    for parameter in data.parameters:
        label = data.quantities[parameter].label
        for column in conditions.covariates:
            why = "only the hierarchical model estimates slopes"
            yield Skipped(f"classical slope of {label} on {column}", why)
        if factors is None:
            continue
        try:
            trials = data.trials(parameter)
        except RefusalError as refused:
            yield Skipped(f"contrasts of {label}", str(refused))
            continue
        means = _means(data, trials, factors)
        log_sds = means
        if conditions.precision:
            values, equal = _log_sds(trials, label)
            yield from equal
            log_sds = subject_cells(values, trials, factors, conditions.between)
        for found in compared(data, trials, parameter):
            if isinstance(found, Skipped):
                yield found
                continue
            if found.of == "precision":
                yield from _rows(data, parameter, f"precision of {label}", found, log_sds)
            else:
                yield from _rows(data, parameter, label, found, means)


def _means(data: Data, trials: Trials, factors: Factors) -> SubjectCells:
    """Each subject's means of one quantity in the cells of all factors, as responses."""
    means = trials.statistics.cell_means[:, 0]
    return subject_cells(means, trials, factors, data.conditions.between)


def _with_means(data: Data, factors: Factors) -> Iterator[tuple[str, Trials, SubjectCells]]:
    """Yield the quantities with trials and subjects' means; the contrasts say why others lack."""
    for parameter in data.parameters:
        with suppress(RefusalError):
            trials = data.trials(parameter)
            yield parameter, trials, _means(data, trials, factors)


def _log_sds(trials: Trials, label: str) -> tuple[Array, list[Skipped]]:
    """Log SDs between each subject's trials in each cell, (N, C), and those there are none of."""
    log_sds = log_trial_sds(trials)
    skipped = []
    for i, cell in np.argwhere(np.isneginf(log_sds)).tolist():
        what = f"{trials.subjects[i]} in the precision of {label}"
        why = f"all trials in {trials.environments[cell]} are equal, and zero has no logarithm"
        skipped.append(Skipped(what, why))
        log_sds[i, cell] = np.nan
    return log_sds, skipped


def _rows(
    data: Data, parameter: str, label: str, comparison: Comparison, cells: SubjectCells
) -> Iterator[ContrastRow | Skipped]:
    """Yield the intervals of a comparison; or say why it has none."""
    is_paired = comparison.within or comparison.of == "level"
    if not is_paired and len(cells.groups) > 1:
        what = f"classical contrasts of groups in {label}"
        yield Skipped(what, "Welch's test compares the groups of one column only")
        return
    try:
        yield from (_paired if is_paired else _of_groups)(data, parameter, comparison, cells)
    except RefusalError as refused:
        where = f"in {comparison.environment}" if comparison.environment else "overall"
        what = f"contrast of {label}, {comparison.versus}, {where}"
        yield Skipped(what, str(refused))


def _paired(
    data: Data, parameter: str, comparison: Comparison, cells: SubjectCells
) -> Iterator[ContrastRow]:
    """Yield intervals of subjects' own contrasts, of subjects who have every cell."""
    values = cells.at_level(comparison)
    is_complete = np.isfinite(values)
    n = int(is_complete.sum())
    if n < 2:
        raise RefusalError("fewer than two subjects have all its levels")
    asked = data.asked
    if comparison.of == "spread":
        weights = comparison.weights
        second = cells.weighed({cell: weight for cell, weight in weights.items() if weight > 0.0})
        first = cells.weighed({cell: -weight for cell, weight in weights.items() if weight < 0.0})
        ratio = spread_ratio(first[is_complete], second[is_complete], level=asked.level)
        ends = np.array([ratio.lower, ratio.upper, ratio.estimate])
        yield contrast_row(
            data, parameter, comparison, ends, n, method="classical", p_value=ratio.p_value
        )
        return
    for kind in ("mean",) if comparison.is_ratio else asked.kinds:
        interval, p_value, d_z = paired_contrast(values[is_complete], kind, **claim_of(asked))
        evidence = {"p_value": p_value, "d_z": d_z} if kind == "mean" else {}
        ends = np.array([interval.lower, interval.upper, interval.estimate])
        # Values that are log SDs differ by the logarithm of a ratio.
        ends = np.exp(ends) if comparison.is_ratio else ends
        yield contrast_row(
            data, parameter, comparison, ends, n, kind=kind, method="classical", **evidence
        )


def _of_groups(
    data: Data, parameter: str, comparison: Comparison, cells: SubjectCells
) -> Iterator[ContrastRow]:
    """Yield Welch's interval, or the F interval, of subjects' values in two groups."""
    assert data.sessions.factors is not None
    ((column, groups),) = cells.groups.items()
    place = list(data.sessions.factors.levels).index(column)
    # Both groups' values weigh the same cells, which the second one's part of the contrast tells.
    *_, second = comparison.groups
    of_second = {
        cell: weight for cell, weight in comparison.weights.items() if cell[1][place] == second
    }
    values = cells.weighed(of_second)
    samples = [values[np.isfinite(values) & (groups == group)] for group in comparison.groups]
    if min(map(len, samples)) < 2:
        raise RefusalError("a group has fewer than two subjects with all cells")
    moments = [Moments.from_values(sample) for sample in samples]
    if min(float(group.sd) for group in moments) == 0.0:
        raise RefusalError("all subjects of a group have one value")
    test = group_spread_ratio if comparison.of == "spread" else group_contrast
    found = test(*moments, level=data.asked.level)
    ends = np.array([found.lower, found.upper, found.estimate])
    ends = np.exp(ends) if comparison.of == "precision" else ends
    yield contrast_row(
        data, parameter, comparison, ends, found.n, method="classical", p_value=found.p_value
    )


def contrast_row(
    data: Data,
    parameter: str,
    comparison: Comparison,
    ends: ArrayLike,
    n: int,
    *,
    kind: Kind = "mean",
    method: Method,
    together: ArrayLike | None = None,
    **evidence: float | None,
) -> ContrastRow:
    """Make a row of lower limit, upper limit and estimate, and of limits that hold together.

    They are differences of responses, or ratios of SDs. `evidence` are p-value, probability,
    d_z and error by their names in the row.
    """
    asked = data.asked
    unit = ""
    if not comparison.is_ratio:
        ends = data.differences(parameter, ends)
        unit = data.unit_of_differences(parameter)
    lower, upper, estimate = np.asarray(ends).tolist()
    lower_together, upper_together = None, None
    if together is not None:
        lower_together, upper_together = data.differences(parameter, together).tolist()
    return ContrastRow(
        factor=comparison.factor,
        first=comparison.first,
        second=comparison.second,
        environment=comparison.environment,
        references=comparison.references,
        parameter=parameter,
        of=comparison.of,
        kind=None if comparison.is_ratio else kind,
        method=method,
        family=asked.family,
        level=asked.level,
        share=asked.share if kind == "share" else None,
        confidence=asked.confidence if kind == "share" else None,
        lower=lower,
        upper=upper,
        estimate=estimate,
        lower_together=lower_together,
        upper_together=upper_together,
        unit=unit,
        within=comparison.within,
        n=n,
        **evidence,
    )


def level_values(data: Data) -> Iterator[LevelValues]:
    """Yield subjects' means at every level of the factors, over all references and at each one."""
    factors = data.sessions.factors
    if factors is None or not data.scene.terms:
        return
    by_level = list(level_means(data.conditions, factors, list(factors.cells.values())))
    at_levels: list[tuple[Comparison, str | None]] = [(overall, None) for *_, overall in by_level]
    for *by_environment, _ in by_level:
        at_levels += [(mean, mean.environment) for mean in by_environment]
    for parameter, _, cells in _with_means(data, factors):
        for mean, environment in at_levels:
            values = data.differences(parameter, cells.at_level(mean))
            yield LevelValues(
                factor=mean.factor,
                level=mean.second,
                parameter=parameter,
                environment=environment,
                within=mean.within,
                values=tuple(map(known, values.tolist())),
            )


def anova_rows(data: Data) -> Iterator[AnovaRow | Skipped]:
    """Yield the analysis of variance of the model's terms, unless the method is Bayesian alone.

    Each term is tested by itself, and as it differs between references.
    """
    factors = data.sessions.factors
    conditions = data.conditions
    if factors is None or not conditions.factors or data.asked.method == "bayesian":
        return
    # As sets: a:b and b:a are one term.
    terms = {frozenset(term) for term in conditions.terms}
    for parameter, trials, cells in _with_means(data, factors):
        try:
            effects = _effects(cells, trials, factors, conditions)
        except RefusalError as refused:
            what = f"analysis of variance of {data.quantities[parameter].label}"
            yield Skipped(what, str(refused))
            continue
        for effect in effects:
            model_term = frozenset(effect.factors) - {ENVIRONMENT}
            if not model_term or model_term in terms:
                numbers = {**vars(effect), "factor": ":".join(effect.factors)}
                del numbers["factors"]
                n = len(trials.subjects)
                yield AnovaRow(parameter=parameter, family=data.asked.family, n=n, **numbers)


def _effects(
    cells: SubjectCells, trials: Trials, factors: Factors, conditions: Conditions
) -> Sequence[Effect]:
    """Test subjects' means: an axis for the references, and one for each factor within subjects.

    The factor between subjects, of which there is one at most, puts each into a group.
    """
    if len(conditions.between) > 1:
        raise RefusalError("it compares the groups of one column only")
    axes: dict[str, Sequence[str]] = {ENVIRONMENT: tuple(factors.environments)}
    for name, levels in factors.levels.items():
        if name not in conditions.between:
            axes[name] = levels
    environments, *within = axes.values()
    keys = list(itertools.product(environments, itertools.product(*within)))
    values = np.stack([cells.values.get(key, cells.lacking) for key in keys], axis=1)
    missing = np.argwhere(np.isnan(values))
    if len(missing):
        row, column = missing[0].tolist()
        environment, at_levels = keys[column]
        subject = trials.subjects[row]
        count = len(np.unique(missing[:, 0]))
        more = f" Cells are missing for {count} subjects in all." if count > 1 else ""
        cell = factors.cell(environment, at_levels) if at_levels else environment
        name = json.dumps(subject, ensure_ascii=False)  # JSON's texts are TOML's, too
        rule = f'{{ column = "subject", equals = {name}, why = "incomplete" }}'
        raise RefusalError(
            f"{subject} has no trial in {cell}, and the analysis needs complete cells.{more}",
            hint=f"To leave {subject} out: [sessions] exclude = [{rule}]. The contrasts use all"
            " data.",
        )
    if len(environments) == 1:
        del axes[ENVIRONMENT]
    values = values.reshape(len(values), *(len(levels) for levels in axes.values()))
    between = next(iter(conditions.between), "")
    group = pd.factorize(cells.groups[between])[0] if between else None
    return anova(values, tuple(axes), group=group, between=between)
