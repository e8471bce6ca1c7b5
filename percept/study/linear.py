"""The model of a study with factors, groups or covariates, and the contrasts it estimates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.model.design import Cells, Options, design_of
from percept.inference.model.design import Factors as CellFactors
from percept.inference.model.limits import Combinations, Limits
from percept.inference.model.model import LinearModel
from percept.inference.model.priors import Priors
from percept.inference.model.product import Product
from percept.inference.model.statistics import Statistics
from percept.inference.model.trials import by_subject
from percept.scene import InferenceTable, Scene
from percept.sessions.formula import TRIAL_REFERENCE
from percept.study.basics import Array, claim_of
from percept.study.conditions import (
    CellKey,
    Comparison,
    Conditions,
    comparisons,
    covariate_values,
    level_means,
)
from percept.study.data import Data
from percept.study.responses import Trials, resolution_of
from percept.study.subject_cells import repeated_cells

#: A setting lies near its reference, but a mean may lie anywhere: priors of locations, in which
#: means differ, are so many times as wide.
_WIDER_FOR_MEANS = 10.0
_LOCATIONS = ("alpha_sd", "gamma_sd", "tau_scale", "lambda_sd", "covariate_sd")


@dataclasses.dataclass(frozen=True, eq=False)
class Compared:
    """A contrast of one quantity, as weights of a model's locations."""

    parameter: str
    comparison: Comparison
    row: Array  # (R,) Weights
    subjects: int  # That it rests on

    @property
    def name(self) -> str:
        """The contrast in messages of the sampler."""
        comparison = self.comparison
        where = comparison.environment or "overall"
        versus = f"{comparison.second} against {comparison.first}"
        return f"{self.parameter}, {comparison.factor}: {versus}, {where}"

    @property
    def place(self) -> tuple[str, str]:
        """The contrast among the names of limits."""
        return ("contrast", self.name)

    def padded(self, before: int, after: int) -> Compared:
        """Weigh the locations of a model that has others before and after these."""
        row = np.pad(self.row, (before, after))
        return dataclasses.replace(self, row=row)


@dataclasses.dataclass(frozen=True, eq=False)
class ContrastPlan:
    """What a model of R locations estimates beside its cells."""

    model: LinearModel | Product
    users: tuple[Compared, ...]  # Contrasts that each user has too
    groups: tuple[Compared, ...]  # Contrasts of different users, and slopes
    spreads: tuple[Compared, ...]  # Ratios of SDs between users
    precisions: tuple[Compared, ...]  # Ratios of SDs between trials, of cells' geometric means

    def estimands(self, asked: InferenceTable) -> Limits:
        """Limits of the cells' intervals and of all contrasts, to one tolerance."""
        of_users = tuple(compared.place for compared in self.users)
        of_groups = tuple(compared.place for compared in self.groups)
        further = (
            Combinations(of_users, self.rows(self.users), asked.kinds),
            Combinations(of_groups, self.rows(self.groups), ("mean",)),
        )
        return Limits(self.model, kinds=asked.kinds, **claim_of(asked), further=further)

    @property
    def slopes(self) -> bool:
        """Whether the model has covariates."""
        return any(compared.comparison.of == "slope" for compared in self.groups)

    def rows(self, compared: Sequence[Compared]) -> Array:
        """Weights of contrasts, (L, R)."""
        rows = [own.row for own in compared]
        return np.reshape(rows, (-1, self.model.cell_rows.shape[1]))

    def log_ratio(self, compared: Compared) -> Callable[[Array], Array]:
        """Log ratio of the SDs of one of `spreads`, of coordinates (W, d)."""
        second_row = np.maximum(compared.row, 0.0)
        first_row = np.maximum(-compared.row, 0.0)
        rows = np.stack([second_row, first_row])

        def ratio(points: Array) -> Array:
            second, first = self.model.user_sds(points, rows).T
            return np.log(second / first)

        return ratio

    def log_precision(self, compared: Compared) -> Callable[[Array], Array]:
        """Log ratio of the SDs of one of `precisions`, of coordinates (W, d)."""

        def ratio(points: Array) -> Array:
            log_sds = []
            for model, own in self.model.split(points):
                of_locations = np.zeros((len(points), model.locations))
                scales = model.scales(own)
                if "sigma_e" in scales:
                    _, sd = scales["sigma_e"]
                    of_locations[:, : len(model.cells)] = np.log(sd).reshape(len(points), -1)
                log_sds.append(of_locations)
            return np.hstack(log_sds) @ compared.row

        return ratio


def side_by_side(plans: Sequence[ContrastPlan]) -> ContrastPlan:
    """Put the contrasts of models of different quantities together."""
    model = Product([plan.model for plan in plans])
    widths = [plan.model.cell_rows.shape[1] for plan in plans]
    users: list[Compared] = []
    groups: list[Compared] = []
    spreads: list[Compared] = []
    precisions: list[Compared] = []
    before = 0
    for plan, width in zip(plans, widths, strict=True):
        after = sum(widths) - before - width
        users += [compared.padded(before, after) for compared in plan.users]
        groups += [compared.padded(before, after) for compared in plan.groups]
        spreads += [compared.padded(before, after) for compared in plan.spreads]
        precisions += [compared.padded(before, after) for compared in plan.precisions]
        before += width
    return ContrastPlan(
        model=model,
        users=tuple(users),
        groups=tuple(groups),
        spreads=tuple(spreads),
        precisions=tuple(precisions),
    )


def priors_of(scene: Scene, parameters: Collection[str]) -> Priors:
    """Return the scene's priors for a model of these parameters."""
    in_force = dict(scene.model.priors)
    if not any(scene.quantities[parameter].is_matched for parameter in parameters):
        for name in _LOCATIONS:
            in_force.setdefault(name, _WIDER_FOR_MEANS * getattr(Priors, name))
    return Priors(**in_force)


def options_of(scene: Scene) -> Options:
    """Return the simpler models that the scene asks for."""
    table = scene.model
    return Options(
        subject_effect=table.subject_effect, weber=table.weber, common_spread=table.common_spread
    )


def linear_study(trials: Trials, data: Data, *, own_trial_sds: bool) -> ContrastPlan:
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
    ContrastPlan

    Raises
    ------
    UsageError
        A term that the data cannot carry, or an option that is not of this model.
    RefusalError
        A factor with one level left, or a cell without scatter.
    """
    scene = data.scene
    sessions = data.sessions
    conditions = data.conditions
    if scene.terms or scene.model.subjects_slope or own_trial_sds:
        _refuse_options(scene)
    statistics, sizes = _reduced(trials, data, own_trial_sds)
    keys = _keys(data, trials.environments)
    cells, factors = _cells(statistics, data)
    priors = priors_of(scene, statistics.parameters)
    design = design_of(cells, factors, priors, options_of(scene))
    model = LinearModel(statistics, design, priors, resolution_of(trials, scene))
    found: list[Comparison] = []
    precisions: list[Comparison] = []
    if sessions.factors is not None:
        repeated = repeated_cells(trials, sessions.factors)
        precisions += comparisons(conditions.precise, sessions.factors, repeated)
        found = list(comparisons(conditions, sessions.factors, keys))
        found += level_means(conditions, sessions.factors, keys)
    environments = tuple(dict.fromkeys(environment for environment, _ in keys))
    slopes = []
    for name, size in zip(conditions.covariates, sizes, strict=True):
        step = "1 decade more" if name == TRIAL_REFERENCE else "1 more"
        within = statistics.covariates is not None and name in statistics.covariates.within
        slope = Comparison(name, "the same", step, None, environments, {}, within, unit=size)
        slopes.append(slope)
    weigh = _Weights(keys, statistics, conditions, model.locations)
    users = [own for own in found if own.of_users]
    groups = [own for own in found if not own.of_users]
    # Where the spread of subjects' effects is one for all levels, a ratio would be falsely certain.
    contrasts = [own for own in found if own.of == "bias"]
    spreads = [own for own in contrasts if own.factor in conditions.spread]
    return ContrastPlan(
        model=model,
        users=tuple(weigh.all_quantities(users)),
        groups=tuple(weigh.all_quantities(groups + slopes)),
        spreads=tuple(weigh.all_quantities(spreads)),
        precisions=tuple(weigh.all_quantities(precisions)),
    )


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
    sizes = np.ones(0)
    if names:
        table = data.sessions.table.loc[trials.rows]
        sizes = table[list(names)].astype(float).std(ddof=0).to_numpy()
        values = covariate_values(table, names)
    elif not own_trial_sds:
        return trials.statistics, sizes
    statistics = by_subject(
        trials.statistics,
        (trials.response, trials.subject, trials.environment),
        own_trial_sds=own_trial_sds,
        covariates=names,
        values=values,
    )
    return statistics, sizes


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
    for place, (factor, names) in enumerate(all_levels.items()):
        if factor not in conditions.factors:
            continue
        # Levels of which no trial is left have no column.
        used = {own[place] for _, own in keys}
        present = tuple(name for name in names if name in used)
        if len(present) < 2:
            raise RefusalError("a factor has one level left in the data.")
        levels[factor] = present
        level[factor] = np.array([present.index(own[place]) for _, own in keys])
    factors = CellFactors(
        levels=levels,
        level=level,
        terms=conditions.terms,
        between_subjects=conditions.between,
        spread=conditions.spread,
        slopes=data.scene.model.subjects_slope,
    )
    return cells, factors


class _Weights:
    """Contrasts as weights of R locations: cells quantity by quantity, slopes, fixed terms."""

    def __init__(
        self,
        keys: tuple[CellKey, ...],
        statistics: Statistics,
        conditions: Conditions,
        locations: int,
    ) -> None:
        self._locations = locations
        self._keys = keys
        self._parameters = statistics.parameters
        self._covariates = conditions.covariates
        #: (N, C) Whether a subject has a cell
        self._present = np.isfinite(statistics.cell_means[:, 0])

    def all_quantities(self, found: Sequence[Comparison]) -> list[Compared]:
        """Weigh contrasts in every quantity."""
        weighed = []
        for p, parameter in enumerate(self._parameters):
            for comparison in found:
                row = self._row(p, comparison)
                weighed.append(Compared(parameter, comparison, row, self._subjects(comparison)))
        return weighed

    def _row(self, p: int, comparison: Comparison) -> Array:
        """Weights of all locations (R,)."""
        size = len(self._parameters)
        cells = len(self._keys)
        row = np.zeros(self._locations)
        if comparison.weights:
            row[p * cells : (p + 1) * cells] = comparison.row(self._keys)
        else:
            m = self._covariates.index(comparison.factor)
            row[size * cells + m * size + p] = 1.0
        return row

    def _subjects(self, comparison: Comparison) -> int:
        """Count the subjects that a contrast rests on."""
        if not comparison.weights:
            return len(self._present)
        if not comparison.within:
            weighed = [cell in comparison.weights for cell in self._keys]
            return int(self._present[:, weighed].any(axis=1).sum())
        complete = np.zeros(len(self._present), dtype=bool)
        for environment in comparison.references:
            complete |= self._at_all_levels(environment, comparison)
        return int(complete.sum())

    def _at_all_levels(self, environment: str, comparison: Comparison) -> NDArray[np.bool_]:
        """Subjects with a cell of either sign in an environment."""
        weights = [
            comparison.weights.get(cell, 0.0) if cell[0] == environment else 0.0
            for cell in self._keys
        ]
        complete = np.ones(len(self._present), dtype=bool)
        for side in (np.array(weights) > 0.0, np.array(weights) < 0.0):
            if side.any():
                complete &= self._present[:, side].any(axis=1)
        return complete
