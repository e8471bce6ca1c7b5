"""The model of a study with factors, groups or covariates, and the contrasts it estimates."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Sequence

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
from percept.sessions.formula import TRIAL_REFERENCE
from percept.study.basics import Array
from percept.study.comparisons import Comparison, comparisons, level_means
from percept.study.conditions import CellKey, covariate_values
from percept.study.data import Data
from percept.study.responses import Trials, resolution_of
from percept.study.subject_cells import repeated_cells

#: A setting lies near its reference, but a mean may lie anywhere: priors of locations, in which
#: means differ, are so many times as wide.
_WIDER_FOR_MEANS = 10.0
_LOCATION_PRIORS = ("alpha_sd", "gamma_sd", "tau_scale", "lambda_sd", "covariate_sd")


@dataclasses.dataclass(frozen=True, eq=False)
class Contrast:
    """A contrast of one quantity, as weights of a model's locations or of its cells' SDs."""

    parameter: str
    comparison: Comparison
    of: str  # That of the comparison; "spread" and "precision" for ratios of SDs
    row: Array  # (R,) Weights
    subjects: int  # That it rests on

    @property
    def is_ratio(self) -> bool:
        """Whether it is a ratio of SDs, and not a combination of locations."""
        return self.of in ("spread", "precision")

    @property
    def is_of_users(self) -> bool:
        """Whether each user has it too, so that it has intervals of all kinds."""
        return self.comparison.of_users and not self.is_ratio

    @property
    def is_of_groups(self) -> bool:
        """Whether it is of different users or a slope, with intervals of the average alone."""
        return not (self.is_ratio or self.comparison.of_users)

    @property
    def place(self) -> tuple[str, str]:
        """The contrast among the names of limits."""
        comparison = self.comparison
        where = comparison.environment or "overall"
        name = f"{self.parameter}, {comparison.factor}: {comparison.versus}, {where}"
        return ("contrast", name)


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
    statistics, covariate_sds = _reduced(trials, data, own_trial_sds)
    cells, factors = _cells(statistics, data)
    priors = priors_of(scene, statistics.parameters)
    design = design_of(cells, factors, priors, options_of(scene))
    model = LinearModel(statistics, design, priors, resolution_of(trials, scene))
    contrasts: list[Contrast | Skipped] = []
    for p, parameter in enumerate(trials.parameters):
        for compared in _compared(data, trials, parameter):
            if isinstance(compared, Skipped):
                contrasts.append(compared)
            else:
                comparison, of = compared
                contrasts.append(_weighed(model, data, p, comparison, of))
        contrasts += _slopes(model, data, p, covariate_sds)
    return model, contrasts


def _compared(
    data: Data, trials: Trials, parameter: str
) -> Iterator[tuple[Comparison, str] | Skipped]:
    """Yield what is compared in a quantity's cells, and of what: bias, spread or precision."""
    factors = data.sessions.factors
    if factors is None:
        return
    conditions = data.conditions
    cells = _keys(data, trials.environments)
    label = data.quantities[parameter].label
    for comparison in comparisons(conditions, factors, cells, label):
        if isinstance(comparison, Skipped):
            yield comparison
            continue
        yield comparison, comparison.of
        # Where the spread of subjects' effects is one for all levels, a ratio would be falsely
        # certain.
        if comparison.of == "bias" and comparison.factor in conditions.spread:
            yield comparison, "spread"
    for *_, mean in level_means(conditions, factors, cells):
        yield mean, mean.of
    repeated = repeated_cells(trials, factors)
    precision = f"precision of {label}"
    for comparison in comparisons(
        conditions.precise, factors, repeated, precision, "repeated trials"
    ):
        yield comparison if isinstance(comparison, Skipped) else (comparison, "precision")


def _slopes(model: LinearModel, data: Data, p: int, covariate_sds: Array) -> Iterator[Contrast]:
    """Yield the slopes of quantity p on covariates, whose SDs are given."""
    covariates = model.statistics.covariates
    environments = model.design.cells.environments
    for name, covariate_sd in zip(data.conditions.covariates, covariate_sds.tolist(), strict=True):
        slope = Comparison(
            factor=name,
            first="the same",
            second="1 decade more" if name == TRIAL_REFERENCE else "1 more",
            of="slope",
            within=covariates is not None and name in covariates.within,
            references=environments,
            unit=covariate_sd,
        )
        yield _weighed(model, data, p, slope, "slope")


def _weighed(model: LinearModel, data: Data, p: int, comparison: Comparison, of: str) -> Contrast:
    """Weigh the locations of quantity p by a comparison, and count its subjects."""
    keys = _keys(data, model.design.cells.names)
    quantities = model.statistics.parameters
    present = np.isfinite(model.statistics.cell_means[:, 0])
    # Locations are cells quantity by quantity, then slopes of all quantities by covariate.
    row = np.zeros(model.locations)
    if of == "slope":
        covariate = data.conditions.covariates.index(comparison.factor)
        row[(len(keys) + covariate) * len(quantities) + p] = 1.0
        return Contrast(quantities[p], comparison, of, row, len(present))
    weights = comparison.row(keys)
    row[p * len(keys) : (p + 1) * len(keys)] = weights
    subjects = _subjects_behind(comparison, keys, weights, present)
    return Contrast(quantities[p], comparison, of, row, subjects)


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


def _reduced(trials: Trials, data: Data, own_trial_sds: bool) -> tuple[Statistics, Array]:
    """Statistics of the trials with their covariates, and the covariates' SDs."""
    names = data.conditions.covariates
    values = None
    covariate_sds = np.ones(0)
    if names:
        table = data.sessions.table.loc[trials.rows]
        covariate_sds = table[list(names)].astype(float).std(ddof=0).to_numpy()
        values = covariate_values(table, names)
    elif not own_trial_sds:
        return trials.statistics, covariate_sds
    statistics = by_subject(
        trials.statistics,
        (trials.response, trials.subject, trials.environment),
        own_trial_sds=own_trial_sds,
        covariates=names,
        values=values,
    )
    return statistics, covariate_sds


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
