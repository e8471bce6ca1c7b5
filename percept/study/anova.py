"""Analysis of variance of a study: the classical test of every term of the model.

A subject's value in a cell is their mean over the cell's trials, on the response scale. The values
of N subjects are an array with an axis for the references and one for each factor within subjects.
At most one factor may be between subjects: it puts each subject into a group.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from percept.errors import RefusalError
from percept.inference.classical.anova import anova
from percept.results import AnovaRow, Skipped
from percept.sessions.records import Factors
from percept.study.basics import Array
from percept.study.conditions import Conditions
from percept.study.data import Data
from percept.study.responses import Trials
from percept.study.subject_cells import SubjectCells

#: What the references are called as a factor: the column of the sessions.
ENVIRONMENT = "environment"


def anova_rows(data: Data) -> Iterator[AnovaRow | Skipped]:
    """Yield the tests of the model's terms, unless the method is Bayesian alone."""
    factors = data.sessions.factors
    if factors is None or not data.conditions.factors or data.asked.method == "bayesian":
        return
    for parameter in data.parameters:
        try:
            cells = data.subject_cells(parameter)
        except RefusalError:
            # The contrasts say why.
            continue
        what = f"analysis of variance of {data.quantities[parameter].label}"
        yield from _tests(cells, data.trials(parameter), factors, data.conditions, what)


def _tests(
    cells: SubjectCells, data: Trials, factors: Factors, conditions: Conditions, what: str
) -> Iterator[AnovaRow | Skipped]:
    """Yield the tests of the references, of the model's terms, and of their interactions."""
    if len(conditions.between) > 1:
        yield Skipped(what, "it compares the groups of one column only")
        return
    axes: dict[str, Sequence[str]] = {}
    if len(factors.environments) > 1:
        axes[ENVIRONMENT] = tuple(factors.environments)
    within = {
        name: labels for name, labels in factors.levels.items() if name not in conditions.between
    }
    axes |= within
    between = next(iter(conditions.between), "")
    group = pd.factorize(cells.groups[between])[0] if between else None
    try:
        values = _values(cells, data.subjects, factors, list(within.values()))
        values = values.reshape(len(values), *(len(labels) for labels in axes.values()))
        effects = anova(values, tuple(axes), group=group, between=between)
    except RefusalError as refused:
        yield Skipped(what, str(refused))
        return
    # As sets: a:b and b:a are one term.
    terms = {frozenset(term) for term in conditions.terms}
    for effect in effects:
        # Every term is tested by itself, and as it differs between references.
        of_model = frozenset(effect.factors) - {ENVIRONMENT}
        if not of_model or of_model in terms:
            yield AnovaRow(
                factor=":".join(effect.factors),
                parameter=data.parameters[0],
                family="lognormal" if data.scale.log else "normal",
                n=len(values),
                **{name: value for name, value in vars(effect).items() if name != "factors"},
            )


def _values(
    cells: SubjectCells,
    subjects: Sequence[str],
    factors: Factors,
    within: Sequence[Sequence[str]],
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
        subject = subjects[row]
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
