"""Contrasts of factors and groups, levels, and the analysis of variance, by the classical method.

A subject's value in a cell is the mean of their trials there, on the response scale. Rows of
contrasts by any method are made here.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from percept.errors import RefusalError
from percept.inference.classical.anova import Effect, anova
from percept.inference.classical.contrasts import (
    TwoSamples,
    group_contrast,
    group_spread_ratio,
    paired_contrast,
    spread_ratio,
)
from percept.inference.classical.moments import Moments
from percept.inference.record import Interval, Kind, Method
from percept.results import AnovaRow, ContrastRow, LevelValues, Skipped
from percept.sessions.records import Factors
from percept.study.basics import Array, claim_of, known
from percept.study.comparisons import Comparison, comparisons, level_means
from percept.study.conditions import CellKey, Conditions
from percept.study.data import Data
from percept.study.responses import Trials
from percept.study.subject_cells import (
    SubjectCells,
    log_trial_sds,
    repeated_cells,
    subject_cells,
)

_Rows = Iterator[ContrastRow | Skipped]
#: What the references are called as a factor: the column of the sessions.
ENVIRONMENT = "environment"


def classical_contrasts(data: Data) -> _Rows:
    """Yield intervals of subjects' own contrasts, and of groups of subjects."""
    factors = data.sessions.factors
    for parameter in data.parameters:
        label = data.quantities[parameter].label
        for column in data.conditions.covariates:
            why = "only the hierarchical model estimates slopes"
            yield Skipped(f"classical slope of {label} on {column}", why)
        if factors is None:
            continue
        try:
            means = _Values(data, parameter, label, data.subject_cells(parameter))
        except RefusalError as refused:
            yield Skipped(f"contrasts of {label}", str(refused))
            continue
        keys = [factors.cells[name] for name in data.trials(parameter).environments]
        yield from means.contrasts(data.conditions, factors, keys)
        for *_, level in level_means(data.conditions, factors, keys):
            yield from means.paired(level)
        if data.conditions.precision:
            yield from _precision(data, parameter, factors)


def _precision(data: Data, parameter: str, factors: Factors) -> _Rows:
    """Yield ratios of SDs between trials, by subjects' log SDs in place of their means."""
    label = f"precision of {data.quantities[parameter].label}"
    trials = data.trials(parameter)
    log_sds = log_trial_sds(trials)
    for i, cell in np.argwhere(np.isneginf(log_sds)).tolist():
        why = f"all trials in {trials.environments[cell]} are equal, and zero has no logarithm"
        yield Skipped(f"{trials.subjects[i]} in the {label}", why)
        log_sds[i] = np.nan
    of_subjects = subject_cells(log_sds, trials, factors, data.conditions.between)
    if not of_subjects.values:
        yield Skipped(label, "no subject repeats a trial in a cell")
        return
    values = _Values(data, parameter, label, of_subjects, is_of_trials=True)
    keys = repeated_cells(trials, factors)
    yield from values.contrasts(data.conditions.precise, factors, keys)


@dataclasses.dataclass(frozen=True, eq=False)
class _Values:
    """One number of each subject in each cell: the mean of the trials, or their log SD."""

    data: Data
    parameter: str
    label: str  # What is compared, in words
    cells: SubjectCells
    is_of_trials: bool = False  # Whether they are log SDs

    def contrasts(self, conditions: Conditions, factors: Factors, keys: Sequence[CellKey]) -> _Rows:
        """Yield the rows of every pair of levels and every interaction."""
        lacking = "repeated trials" if self.is_of_trials else "data"
        for comparison in comparisons(conditions, factors, keys, self.label, lacking):
            if isinstance(comparison, Skipped):
                yield comparison
            elif comparison.within:
                yield from self.paired(comparison)
            elif len(conditions.between) == 1:
                yield from self._of_groups(comparison, factors)
        if len(conditions.between) > 1:
            what = f"classical contrasts of groups in {self.label}"
            yield Skipped(what, "Welch's test compares the groups of one column only")

    def paired(self, comparison: Comparison) -> _Rows:
        """Yield paired intervals and ratios of SDs, of subjects who have every cell."""
        what = self._named(comparison)
        is_complete = np.isfinite(self.cells.at_level(comparison))
        n = int(is_complete.sum())
        if n < 2:
            yield Skipped(what, "fewer than two subjects have all its levels")
            return
        weights = self.cells.own(comparison).weights
        weight = np.array(list(weights.values()))
        values = self.cells.in_cells(list(weights))[is_complete]
        second = values @ np.maximum(weight, 0.0)
        first = values @ np.maximum(-weight, 0.0)
        asked = self.data.asked
        try:
            for kind in ("mean",) if self.is_of_trials else asked.kinds:
                interval, *evidence = paired_contrast(second - first, kind, **claim_of(asked))
                p_value, d_z = evidence if kind == "mean" else (None, None)
                yield self._row(comparison, interval, comparison.of, n, p_value, kind, d_z)
            if comparison.of == "bias" and not self.is_of_trials:
                ratio = spread_ratio(first, second, level=asked.level)
                yield self._row(comparison, ratio, "spread", ratio.n, ratio.p_value)
        except RefusalError as refused:
            yield Skipped(what, str(refused))

    def _of_groups(self, comparison: Comparison, factors: Factors) -> _Rows:
        """Yield Welch's interval and the F interval of subjects' values in two groups."""
        ((column, levels),) = self.cells.groups.items()
        factor_number = list(factors.levels).index(column)
        first, second = comparison.groups
        # Both groups' values weigh the same cells, which the second one's part of the contrast
        # tells.
        of_second = {
            cell: weight
            for cell, weight in comparison.weights.items()
            if cell[1][factor_number] == second
        }
        one_sided = dataclasses.replace(comparison, weights=of_second)
        values = self.cells.weighed(self.cells.own(one_sided).weights)
        samples = [values[np.isfinite(values) & (levels == level)] for level in (first, second)]
        what = self._named(comparison)
        if min(map(len, samples)) < 2:
            yield Skipped(what, "a group has fewer than two subjects with all cells")
            return
        moments = [Moments.from_values(sample) for sample in samples]
        if min(float(group.sd) for group in moments) == 0.0:
            yield Skipped(what, "all subjects of a group have one value")
            return
        level = self.data.asked.level
        difference = group_contrast(*moments, level=level)
        yield self._row(
            comparison, difference, comparison.of, difference.n, difference.p_value, "mean"
        )
        if comparison.of == "bias" and not self.is_of_trials:
            ratio = group_spread_ratio(*moments, level=level)
            yield self._row(comparison, ratio, "spread", ratio.n, ratio.p_value)

    def _named(self, comparison: Comparison) -> str:
        """Name a comparison in words."""
        where = f"in {comparison.environment}" if comparison.environment else "overall"
        return f"contrast of {self.label}, {comparison.versus}, {where}"

    def _row(
        self,
        comparison: Comparison,
        interval: Interval | TwoSamples,
        of: str,
        n: int,
        p_value: float | None,
        kind: Kind | None = None,
        d_z: float | None = None,
    ) -> ContrastRow:
        """Make a row; values that are log SDs differ by the logarithm of a ratio."""
        ends = np.array([interval.lower, interval.upper, interval.estimate])
        if self.is_of_trials:
            of, kind = "precision", None
            ends = np.exp(ends)
        evidence = {"p_value": p_value, "d_z": d_z}
        return contrast_row(
            self.data, self.parameter, comparison, of, ends, n, "classical", evidence, kind
        )


def contrast_row(
    data: Data,
    parameter: str,
    comparison: Comparison,
    of: str,
    ends: Array,
    n: int,
    method: Method,
    evidence: Mapping[str, float | None],
    kind: Kind | None = None,
    together: Array | None = None,
) -> ContrastRow:
    """Make a row of lower limit, upper limit and estimate, and of limits that hold together.

    They are differences of responses if there is a kind, else ratios of SDs. `evidence` are
    p-value, probability and d_z by their names in the row.
    """
    asked = data.asked
    lower, upper, estimate = (data.differences(parameter, ends) if kind else ends).tolist()
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
        of=of,
        kind=kind,
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
        unit=data.unit_of_differences(parameter) if kind else "",
        within=comparison.within,
        n=n,
        **evidence,
    )


def level_values(data: Data) -> Iterator[LevelValues]:
    """Yield subjects' means at every level of the factors, over all references and at each one.

    There are none of a quantity whose values have no logarithm in the lognormal family: the
    contrasts say why.
    """
    factors = data.sessions.factors
    if factors is None or not data.scene.terms:
        return
    means = list(level_means(data.conditions, factors, list(factors.cells.values())))
    compared: list[tuple[Comparison, str | None]] = [(overall, None) for *_, overall in means]
    compared += [
        (at_environment, at_environment.environment)
        for *by_environment, _ in means
        for at_environment in by_environment
    ]
    for parameter in data.parameters:
        try:
            cells = data.subject_cells(parameter)
        except RefusalError:
            continue
        for comparison, environment in compared:
            values = data.differences(parameter, cells.at_level(comparison))
            yield LevelValues(
                factor=comparison.factor,
                level=comparison.second,
                parameter=parameter,
                environment=environment,
                within=comparison.within,
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
    for parameter in data.parameters:
        what = f"analysis of variance of {data.quantities[parameter].label}"
        try:
            cells = data.subject_cells(parameter)
        except RefusalError:
            # The contrasts say why.
            continue
        if len(conditions.between) > 1:
            yield Skipped(what, "it compares the groups of one column only")
            continue
        trials = data.trials(parameter)
        try:
            effects = _effects(cells, trials, factors, conditions)
        except RefusalError as refused:
            yield Skipped(what, str(refused))
            continue
        for effect in effects:
            model_term = frozenset(effect.factors) - {ENVIRONMENT}
            if not model_term or model_term in terms:
                yield AnovaRow(
                    factor=":".join(effect.factors),
                    parameter=parameter,
                    family=data.asked.family,
                    n=len(trials.subjects),
                    **{name: value for name, value in vars(effect).items() if name != "factors"},
                )


def _effects(
    cells: SubjectCells, trials: Trials, factors: Factors, conditions: Conditions
) -> Sequence[Effect]:
    """Test subjects' means: an axis for the references, and one for each factor within subjects.

    The factor between subjects, of which there is one at most, puts each into a group.
    """
    within = {
        name: labels for name, labels in factors.levels.items() if name not in conditions.between
    }
    values = _complete(cells, trials, factors, list(within.values()))
    axes: dict[str, Sequence[str]] = {}
    if len(factors.environments) > 1:
        axes[ENVIRONMENT] = tuple(factors.environments)
    axes |= within
    between = next(iter(conditions.between), "")
    group = pd.factorize(cells.groups[between])[0] if between else None
    values = values.reshape(len(values), *(len(labels) for labels in axes.values()))
    return anova(values, tuple(axes), group=group, between=between)


def _complete(
    cells: SubjectCells, trials: Trials, factors: Factors, within: Sequence[Sequence[str]]
) -> Array:
    """Subjects' values in all cells, (N, cells), references slowest; refuse a missing one.

    `within` holds the levels of each factor within subjects.
    """
    keys = list(itertools.product(factors.environments, itertools.product(*within)))
    table = cells.in_cells(keys)
    missing = np.argwhere(np.isnan(table))
    if len(missing):
        row, column = missing[0].tolist()
        environment, levels = keys[column]
        subject = trials.subjects[row]
        count = len(np.unique(missing[:, 0]))
        more = f" Cells are missing for {count} subjects in all." if count > 1 else ""
        cell = factors.cell(environment, levels) if levels else environment
        name = json.dumps(subject, ensure_ascii=False)  # JSON's texts are TOML's, too
        rule = f'{{ column = "subject", equals = {name}, why = "incomplete" }}'
        raise RefusalError(
            f"{subject} has no trial in {cell}, and the analysis needs complete cells.{more}",
            hint=f"To leave {subject} out: [sessions] exclude = [{rule}]. The contrasts use all"
            " data.",
        )
    return table
