"""Trials of a study as every sampler takes them, and percept's model of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.design import Cells, Factors, design_of
from percept.inference.model.model import LinearModel
from percept.inference.model.priors import Priors
from percept.inference.model.statistics import from_trials
from percept.inference.model.trials import by_subject

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Name of the covariate.
COVARIATE = "order"


@dataclasses.dataclass(frozen=True, eq=False)
class Observed:
    """M trials of P quantities in C cells, and what the cells are.

    No contrast comes from the model's own columns: every factor has two levels, whose contrast is
    minus or plus one half. An interaction's contrast is the product of those of its factors.
    """

    parameters: tuple[str, ...]
    response: Array  # (M, P)
    subject: Indices  # (M,)
    cell: Indices  # (M,)
    environment: Indices  # (C,)
    x: Array  # (P, C) Decades of references above their geometric mean
    priors: Priors = dataclasses.field(default_factory=Priors)
    contrast: Mapping[str, Array] = dataclasses.field(default_factory=dict)  # (C,) by term
    groups: tuple[str, ...] = ()  # Factors of which a subject has one level only
    spread: tuple[str, ...] = ()  # Factors whose levels differ in the spread of subjects' effects
    covariate: Array | None = None  # (M,) Centred within subjects, who have slopes of their own
    own_trial_sds: bool = False
    own_trends: bool = False  # Whether each subject has a trend over the references

    @property
    def subjects(self) -> int:
        """How many."""
        return int(self.subject.max()) + 1

    @property
    def factors(self) -> list[str]:
        """Terms that are no interaction."""
        return [term for term in self.contrast if ":" not in term]

    @property
    def own(self) -> dict[str, Array]:
        """Contrasts of which each subject has an own size."""
        own = {}
        for term, contrast in self.contrast.items():
            if not set(term.split(":")) & set(self.groups):
                own[term] = contrast
        return own

    @property
    def columns(self) -> dict[str, Array]:
        """Columns of the subjects' effects over the cells, by name."""
        ones = np.ones(len(self.environment))
        return {"u": ones} | {f"v_{term}": contrast for term, contrast in self.own.items()}


def model_of(study: Observed) -> LinearModel:
    """Return percept's model of a study.

    Parameters
    ----------
    study : Observed
        The study.

    Returns
    -------
    LinearModel
    """
    environments = tuple(f"VE{j + 1}" for j in range(int(study.environment.max()) + 1))
    levels = dict.fromkeys(study.factors, ("first", "second"))
    level = {factor: (study.contrast[factor] > 0).astype(np.intp) for factor in levels}
    names = []
    for c, environment in enumerate(study.environment):
        own = [levels[factor][level[factor][c]] for factor in levels]
        names.append(" ".join([environments[environment], *own]))
    statistics = from_trials(
        study.response,
        study.subject,
        study.cell,
        study.x,
        parameters=study.parameters,
        environments=tuple(names),
        subjects=tuple(f"S{i + 1}" for i in range(study.subjects)),
    )
    values = None if study.covariate is None else study.covariate[:, None]
    if study.own_trial_sds or values is not None:
        statistics = by_subject(
            statistics,
            (study.response, study.subject, study.cell),
            own_trial_sds=study.own_trial_sds,
            covariates=() if values is None else (COVARIATE,),
            values=values,
        )
    cells = Cells(tuple(names), study.environment, environments, study.x)
    factors = Factors(
        levels=levels,
        level=level,
        terms=tuple(tuple(term.split(":")) for term in study.contrast),
        between_subjects=frozenset(study.groups),
        spread=study.spread,
        subject_trends=study.own_trends,
    )
    design = design_of(cells, factors, study.priors)
    return LinearModel(statistics, design, study.priors)
