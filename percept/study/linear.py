"""The model of a study's trials: cells, contrasts, and whether subjects have own trial SDs."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping

import numpy as np
import pandas as pd
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
from percept.study.comparisons import ENVIRONMENT, Contrast, cells_of, compared
from percept.study.conditions import in_sds
from percept.study.data import Data
from percept.study.responses import Trials, resolution_of

#: A setting lies near its reference, but a mean may lie anywhere: priors of locations, in which
#: means differ, are so many times as wide.
_WIDER_FOR_MEANS = 10.0
_LOCATION_PRIORS = ("alpha_sd", "gamma_sd", "tau_scale", "lambda_sd", "covariate_sd")
#: Subjects beyond which their own trial SDs take the sampler too long to be the default.
_MOST_SUBJECTS = 60
#: Trial degrees of freedom of the median subject: with fewer, one SD is known to a quarter at best.
_LEAST_TRIAL_DF = 8


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
    return model, list(_contrasts(model, data, trials, sds))


def _contrasts(
    model: LinearModel, data: Data, trials: Trials, covariate_sds: Mapping[str, float]
) -> Iterator[Contrast | Skipped]:
    """Yield what is compared of each quantity, and slopes on covariates, whose SDs are given."""
    references = model.design.cells.environments
    covariates = model.statistics.covariates
    present = np.isfinite(model.statistics.cell_means[:, 0])
    quantities = len(trials.parameters)
    rows = np.split(model.cell_rows, quantities)
    for p, parameter in enumerate(trials.parameters):
        for found in compared(data, trials, parameter):
            if isinstance(found, Skipped):
                yield found
            elif found.of != "spread" or found.factor in data.conditions.spread:
                # Elsewhere the spread of subjects' effects is one for all levels: a ratio would be
                # falsely certain.
                subjects = _subjects_behind(found, model.design.cells, present)
                yield dataclasses.replace(found, row=found.weights @ rows[p], subjects=subjects)
        for number, (name, sd) in enumerate(covariate_sds.items()):
            row = np.zeros(model.locations)
            # Slopes stand after the cells, those of all quantities by covariate. One of the model
            # is for one SD of its covariate; this one is for one unit.
            row[len(model.cells) + number * quantities + p] = 1.0 / sd
            yield Contrast(
                parameter=parameter,
                factor=name,
                first="the same",
                second="1 decade more" if name == TRIAL_REFERENCE else "1 more",
                of="slope",
                within=covariates is not None and name in covariates.within,
                references=references,
                row=row,
                subjects=len(present),
            )


def _subjects_behind(contrast: Contrast, cells: Cells, present: NDArray[np.bool_]) -> int:
    """Count the subjects of a contrast, given who has trials in which cell, (N, C).

    Any weighed cell will do, but a contrast within subjects needs both its sides at some reference.
    """
    weighed = [contrast.weights > 0.0, contrast.weights < 0.0]
    if not contrast.within:
        return int(present[:, np.any(weighed, axis=0)].any(axis=1).sum())
    at_reference = cells.environment[:, None] == np.arange(len(cells.environments))
    # A level's mean has one side.
    sides = [side[:, None] & at_reference for side in weighed if side.any()]
    has_sides = np.all([present @ side for side in sides], axis=0)
    return int(has_sides.any(axis=1).sum())


def _refuse_options(scene: Scene) -> None:
    """Refuse the simpler models that a model of factors does not have."""
    for key, value, why in (
        ("common_spread", True, "the spread of each cell is estimated"),
        ("subject_effect", False, "comparisons within subjects rest on it"),
    ):
        if getattr(scene.model, key) is value:
            raise UsageError(
                f"does not go with factors, groups, covariates or subjects' trial SDs: {why}.",
                key=f"model.{key}",
                value=value,
                hint="Leave it out, or leave out [model] bias and subjects_trial_sd, and [study]"
                " factor.",
            )


def _cells(statistics: Statistics, data: Data) -> tuple[Cells, CellFactors]:
    """Cells and factors by number."""
    conditions = data.conditions
    table = cells_of(data.sessions, statistics.environments)
    environment, environments = pd.factorize(table[ENVIRONMENT])
    cells = Cells(
        names=statistics.environments,
        environment=environment,
        environments=tuple(environments),
        x=statistics.x,
    )
    levels: dict[str, tuple[str, ...]] = {}
    level: dict[str, NDArray[np.intp]] = {}
    for factor in conditions.factors:
        assert data.sessions.factors is not None
        # Levels of which no trial is left have no column.
        there = set(table[factor])
        present = [name for name in data.sessions.factors.levels[factor] if name in there]
        if len(present) < 2:
            raise RefusalError("a factor has one level left in the data.")
        levels[factor] = tuple(present)
        level[factor] = pd.Index(present).get_indexer(pd.Index(table[factor]))
    factors = CellFactors(
        levels=levels,
        level=level,
        terms=conditions.terms,
        between_subjects=conditions.between,
        spread=conditions.spread,
        subject_trends=shows_subject_trends(np.isfinite(statistics.cell_means[:, 0]), cells.x),
    )
    return cells, factors


def why_one_trial_sd(trials: Trials, scene: Scene) -> str:
    """Say why all subjects share one trial SD; empty where each has one of their own."""
    table = scene.model
    setting = table.subjects_trial_sd
    if not trials.statistics.repeats:
        return "no trials are repeated"
    if setting is False:
        return "[model] subjects_trial_sd = false"
    if setting == "auto" and (table.common_spread or not table.subject_effect):
        return "they do not go with [model] common_spread, nor with subject_effect = false"
    if len(trials.environments) == 1:
        return "the study has one environment"
    why = _alike(trials)
    if why or setting is True or table.precision:
        return why
    repeats = np.maximum(trials.statistics.counts - 1.0, 0.0).sum(axis=1)
    if len(repeats) > _MOST_SUBJECTS:
        why = f"the study has more than {_MOST_SUBJECTS} subjects"
    elif np.median(repeats) < _LEAST_TRIAL_DF:
        why = f"half of the subjects repeat a trial fewer than {_LEAST_TRIAL_DF} times"
    return why and f"{why}; [model] subjects_trial_sd = true computes them"


def _alike(trials: Trials) -> str:
    """Say where repeats are so much alike that a trial SD has no proper posterior, or nothing."""
    responses = pd.DataFrame(trials.response)
    cells = responses.groupby([trials.subject, trials.environment])
    # Values, not squares about their mean: rounding of the mean is no scatter.
    scatters = cells.max() > cells.min()
    # A cell in which no repeats differ is refused, unless the resolution stands in for scatter.
    scatters |= ~scatters.groupby(level=1).transform("any")
    df = cells.size() - 1
    repeated = (df > 0).to_numpy()
    repeats = np.asarray(df[repeated], dtype=float)
    scatters = scatters[repeated]
    subject = scatters.index.get_level_values(0)
    cell = scatters.index.get_level_values(1)
    for _, of_quantity in scatters.items():
        vanishes = _vanishing(repeats, subject, cell, of_quantity.to_numpy())
        if vanishes.any():
            who = ", ".join(trials.subjects[i] for i in np.unique(subject[vanishes]))
            where = ", ".join(trials.environments[j] for j in np.unique(cell[vanishes]))
            alike = f"the repeats of {who} in {where} are alike"
            return f"{alike}, and a trial SD of zero has no posterior"
    return ""


def _vanishing(
    df: Array, subject: pd.Index[int], cell: pd.Index[int], scatter: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Tell the groups of trials whose SDs the likelihood drives to zero; none if it is bounded.

    The log SD of subject i in cell j is a_j + phi_i, and n trials beyond the first that do not
    scatter have the log likelihood -n (a_j + phi_i). It grows without bound along a direction in
    which no sum falls where trials scatter, and the sum over all trials does.
    """
    from scipy import optimize  # slow to import, and rarely needed

    sums = np.hstack([pd.get_dummies(subject, dtype=float), pd.get_dummies(cell, dtype=float)])
    bound = np.zeros(scatter.sum())
    steepest = optimize.linprog(df @ sums, A_ub=-sums[scatter], b_ub=bound, bounds=(-1.0, 1.0))
    moves = sums @ np.asarray(steepest.x)
    # The steepest direction has whole components: one half tells them from zero.
    return (moves < -0.5) & (df @ moves <= -0.5)
