"""The model of a study with factors, groups or covariates, and the contrasts it estimates."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.model.design import Cells, Options, design_of, shows_subject_trends
from percept.inference.model.design import Factors as CellFactors
from percept.inference.model.model import LinearModel
from percept.inference.model.priors import Priors
from percept.inference.model.statistics import Statistics
from percept.inference.model.trials import by_subject
from percept.results import Skipped
from percept.scene import Scene
from percept.sessions.options import TRIAL_REFERENCE
from percept.study.basics import Array
from percept.study.comparisons import Comparison
from percept.study.conditions import CellKey, in_sds
from percept.study.contrasts import compared
from percept.study.data import Data
from percept.study.responses import Trials, resolution_of

#: A setting lies near its reference, but a mean may lie anywhere: priors of locations, in which
#: means differ, are so many times as wide.
_WIDER_FOR_MEANS = 10.0
_LOCATION_PRIORS = ("alpha_sd", "gamma_sd", "tau_scale", "lambda_sd", "covariate_sd")


@dataclasses.dataclass(frozen=True, eq=False)
class Contrast:
    """A comparison of one quantity, as weights of a model's locations or of its cells' SDs."""

    parameter: str
    comparison: Comparison
    row: Array  # (R,) Weights
    subjects: int  # That it rests on

    @property
    def name(self) -> tuple[str, str]:
        """Its name among those of limits."""
        made = self.comparison
        return ("contrast", f"{self.parameter}, {made.factor}: {made.versus}, {made.where}")


def rows_of(contrasts: Sequence[Contrast]) -> Array:
    """Weights of contrasts, (L, R)."""
    return np.array([contrast.row for contrast in contrasts])


def priors_of(scene: Scene, parameters: Collection[str]) -> Priors:
    """Return the scene's priors for a model of these parameters."""
    in_force = dict(scene.model.priors)
    if not any(scene.quantities[parameter].is_matched for parameter in parameters):
        for name in _LOCATION_PRIORS:
            in_force.setdefault(name, _WIDER_FOR_MEANS * getattr(Priors, name))
    return Priors(**in_force)


def options_of(scene: Scene) -> Options:
    """Return the simpler models that the scene asks for."""
    table = scene.model
    return Options(
        subject_effect=table.subject_effect, weber=table.weber, common_spread=table.common_spread
    )


def linear_model(
    trials: Trials,
    data: Data,
    *,
    own_trial_sds: bool,
) -> tuple[LinearModel, list[Contrast | Skipped]]:
    """Build the model of one or two quantities over all cells.

    Parameters
    ----------
    trials : Trials
        Of these quantities.
    data : Data
        Of the study, with its conditions, and the scene's priors and options.
    own_trial_sds : bool
        Whether each subject has a trial SD of its own.

    Returns
    -------
    LinearModel
    list of Contrast and Skipped
        What it compares, quantity by quantity, and what it cannot.

    Raises
    ------
    UsageError
        A term that the data cannot carry, or an option that is not of this model.
    RefusalError
        A factor with one level left, or a cell without scatter.
    """
    scene = data.scene
    if scene.terms or own_trial_sds:
        _refuse_options(scene)
    names = list(data.conditions.covariates)
    statistics = trials.statistics
    covariates = data.sessions.table.loc[trials.rows, names].astype(float)
    if names or own_trial_sds:
        statistics = by_subject(
            statistics,
            (trials.response, trials.subject, trials.environment),
            own_trial_sds=own_trial_sds,
            covariates=tuple(names),
            values=in_sds(covariates) if names else None,
        )
    cells, factors = _cells(statistics, data)
    priors = priors_of(scene, statistics.parameters)
    design = design_of(cells, factors, priors, options_of(scene))
    model = LinearModel(statistics, design, priors, resolution_of(trials, scene))
    sds = dict(zip(names, covariates.std(ddof=0).tolist(), strict=True))
    contrasts: list[Contrast | Skipped] = []
    for p in range(len(trials.parameters)):
        contrasts += _contrasts(model, data, trials, p, sds)
    return model, contrasts


def _contrasts(
    model: LinearModel, data: Data, trials: Trials, p: int, covariate_sds: Mapping[str, float]
) -> Iterator[Contrast | Skipped]:
    """Yield what is compared of quantity p, and its slopes on covariates, whose SDs are given."""
    parameter = trials.parameters[p]
    keys = _keys(data, model.design.cells.names)
    present = np.isfinite(model.statistics.cell_means[:, 0])
    for found in compared(data, trials, parameter):
        if isinstance(found, Skipped):
            yield found
            continue
        if found.of == "spread" and found.factor not in data.conditions.spread:
            # The spread of subjects' effects is one for all levels: a ratio would be falsely
            # certain.
            continue
        weights = np.array([found.weights.get(key, 0.0) for key in keys])
        # Locations are cells quantity by quantity, then slopes of all quantities by covariate.
        row = np.zeros(model.locations)
        row[p * len(keys) : (p + 1) * len(keys)] = weights
        yield Contrast(parameter, found, row, _subjects_behind(found, keys, weights, present))
    for number, (name, sd) in enumerate(covariate_sds.items(), start=len(keys)):
        covariates = model.statistics.covariates
        slope = Comparison(
            factor=name,
            first="the same",
            second="1 decade more" if name == TRIAL_REFERENCE else "1 more",
            of="slope",
            within=covariates is not None and name in covariates.within,
            references=model.design.cells.environments,
        )
        row = np.zeros(model.locations)
        # A slope of the model is for one SD of its covariate; this one is for one unit.
        row[number * len(trials.parameters) + p] = 1.0 / sd
        yield Contrast(parameter, slope, row, len(present))


def _subjects_behind(
    comparison: Comparison, keys: Sequence[CellKey], weights: Array, present: NDArray[np.bool_]
) -> int:
    """Count the subjects of a comparison, given who has trials in which cell, (N, C).

    Any weighed cell will do, but a comparison within subjects needs both its sides at some
    reference.
    """
    if not comparison.within:
        return int(present[:, weights != 0.0].any(axis=1).sum())
    subjects = np.zeros(len(present), dtype=bool)
    for environment in comparison.references:
        here = np.array([name == environment for name, _ in keys])
        sides = [side for side in (here & (weights > 0.0), here & (weights < 0.0)) if side.any()]
        subjects |= np.all([present[:, side].any(axis=1) for side in sides], axis=0)
    return int(subjects.sum())


def _refuse_options(scene: Scene) -> None:
    """Refuse the simpler models that a model of factors does not have."""
    reasons = []
    if scene.model.common_spread:
        reasons.append(("common_spread", True, "the spread of each cell is estimated"))
    if not scene.model.subject_effect:
        reasons.append(("subject_effect", False, "comparisons within subjects rest on it"))
    for key, value, why in reasons:
        message = f"does not go with factors, groups, covariates or subjects' trial SDs: {why}."
        hint = "Leave it out, or leave out [model] bias and subjects_trial_sd, and [study] factor."
        raise UsageError(message, key=f"model.{key}", value=value, hint=hint)


def _keys(data: Data, cells: Sequence[str]) -> tuple[CellKey, ...]:
    """Environment and levels of cells."""
    factors = data.sessions.factors
    if factors is None:
        return tuple((cell, ()) for cell in cells)
    return tuple(factors.cells[cell] for cell in cells)


def _cells(statistics: Statistics, data: Data) -> tuple[Cells, CellFactors]:
    """Cells and factors by number."""
    conditions = data.conditions
    keys = _keys(data, statistics.environments)
    environments = list(dict.fromkeys(environment for environment, _ in keys))
    cells = Cells(
        names=statistics.environments,
        environment=np.array([environments.index(environment) for environment, _ in keys]),
        environments=tuple(environments),
        x=statistics.x,
    )
    levels: dict[str, tuple[str, ...]] = {}
    level: dict[str, NDArray[np.intp]] = {}
    all_levels = data.sessions.factors.levels if data.sessions.factors is not None else {}
    for factor_number, (factor, names) in enumerate(all_levels.items()):
        if factor not in conditions.factors:
            continue
        # Levels of which no trial is left have no column.
        used = {levels_of_cell[factor_number] for _, levels_of_cell in keys}
        present = tuple(name for name in names if name in used)
        if len(present) < 2:
            raise RefusalError("a factor has one level left in the data.")
        levels[factor] = present
        level[factor] = np.array(
            [present.index(levels_of_cell[factor_number]) for _, levels_of_cell in keys]
        )
    factors = CellFactors(
        levels=levels,
        level=level,
        terms=conditions.terms,
        between_subjects=conditions.between,
        spread=conditions.spread,
        subject_trends=shows_subject_trends(np.isfinite(statistics.cell_means[:, 0]), cells.x),
    )
    return cells, factors
