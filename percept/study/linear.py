"""The model of a study with factors, groups or covariates, and the contrasts it estimates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.model.design import Cells, Options, design_of
from percept.inference.model.design import Factors as CellFactors
from percept.inference.model.limits import Combinations, Limits
from percept.inference.model.model import LinearModel, Resolution
from percept.inference.model.product import Product
from percept.inference.model.statistics import Statistics
from percept.inference.model.trials import by_subject
from percept.scene import InferenceTable, ModelTable
from percept.sessions import Sessions
from percept.sessions.formula import TRIAL_REFERENCE
from percept.study.basics import Array, claim_of, priors_of
from percept.study.conditions import (
    CellKey,
    Comparison,
    Conditions,
    comparisons,
    covariate_values,
    level_means,
)
from percept.study.data import Data
from percept.study.responses import Trials


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


def side_by_side(plans: Sequence[ContrastPlan]) -> ContrastPlan:
    """Put the contrasts of models of different quantities together."""
    model = Product([plan.model for plan in plans])
    widths = [plan.model.cell_rows.shape[1] for plan in plans]
    users: list[Compared] = []
    groups: list[Compared] = []
    spreads: list[Compared] = []
    before = 0
    for plan, width in zip(plans, widths, strict=True):
        after = sum(widths) - before - width
        users += [compared.padded(before, after) for compared in plan.users]
        groups += [compared.padded(before, after) for compared in plan.groups]
        spreads += [compared.padded(before, after) for compared in plan.spreads]
        before += width
    return ContrastPlan(
        model=model,
        users=tuple(users),
        groups=tuple(groups),
        spreads=tuple(spreads),
    )


def linear_study(
    trials: Trials, data: Data, resolution: Resolution, *, own_trial_sds: bool
) -> ContrastPlan:
    """Build the model of one or two quantities over all cells.

    Parameters
    ----------
    trials : Trials
        Of these quantities.
    data : Data
        Of the study, with its conditions, and the scene's priors and options.
    resolution : Resolution
        Variance that the adjustment's resolution adds.
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
        A factor with one level left.
    """
    scene = data.scene
    sessions = data.sessions
    conditions = data.conditions
    _refuse_options(scene.model)
    statistics, sizes = _reduced(trials, sessions, conditions, own_trial_sds)
    keys = tuple(_key(sessions, cell) for cell in trials.environments)
    priors = priors_of(scene, trials.statistics.parameters)
    own_slopes = scene.model.subjects_slope
    cells, factors = _design(keys, statistics, sessions, conditions, own_slopes)
    design = design_of(cells, factors, priors, Options(weber=scene.model.weber))
    model = LinearModel(statistics, design, priors, resolution)
    found: list[Comparison] = []
    if sessions.factors is not None:
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
    )


def _refuse_options(table: ModelTable) -> None:
    """Refuse the simpler models that a model of factors does not have."""
    reasons = []
    if table.common_spread:
        reasons.append(("common_spread", True, "the spread of each cell is estimated"))
    if not table.subject_effect:
        reasons.append(("subject_effect", False, "comparisons within subjects rest on it"))
    for key, value, why in reasons:
        message = f"does not go with factors, groups, covariates or subjects' trial SDs: {why}."
        hint = "Leave it out, or leave out [model] bias and subjects_trial_sd, and [study] factor."
        raise UsageError(message, key=f"model.{key}", value=value, hint=hint)


def _reduced(
    data: Trials, sessions: Sessions, conditions: Conditions, own_trial_sds: bool
) -> tuple[Statistics, Array]:
    """Statistics of the trials with their covariates, and the covariates' SDs."""
    names = conditions.covariates
    values = None
    sizes = np.ones(0)
    if names:
        table = sessions.table.loc[data.rows]
        sizes = table[list(names)].astype(float).std(ddof=0).to_numpy()
        values = covariate_values(table, names)
    elif not own_trial_sds:
        return data.statistics, sizes
    statistics = by_subject(
        data.statistics,
        (data.response, data.subject, data.environment),
        own_trial_sds=own_trial_sds,
        covariates=names,
        values=values,
    )
    return statistics, sizes


def _key(sessions: Sessions, cell: str) -> CellKey:
    """Environment and levels of a cell."""
    return (cell, ()) if sessions.factors is None else sessions.factors.cells[cell]


def _design(
    keys: Sequence[CellKey],
    statistics: Statistics,
    sessions: Sessions,
    conditions: Conditions,
    subjects_slope: bool,
) -> tuple[Cells, CellFactors]:
    """Cells and factors by number."""
    environments = list(dict.fromkeys(environment for environment, _ in keys))
    cells = Cells(
        names=statistics.environments,
        environment=np.array([environments.index(environment) for environment, _ in keys]),
        environments=tuple(environments),
        x=statistics.x,
    )
    levels: dict[str, tuple[str, ...]] = {}
    level: dict[str, NDArray[np.intp]] = {}
    if sessions.factors is not None:
        for place, (factor, names) in enumerate(sessions.factors.levels.items()):
            # Levels of which no trial is left have no column.
            used = {own[place] for _, own in keys}
            present = tuple(name for name in names if name in used)
            levels[factor] = present
            level[factor] = np.array([present.index(own[place]) for _, own in keys])
    if any(len(present) < 2 for present in levels.values()):
        raise RefusalError("a factor has one level left in the data.")
    factors = CellFactors(
        levels=levels,
        level=level,
        terms=conditions.terms,
        between_subjects=conditions.between,
        spread=conditions.spread,
        slopes=subjects_slope,
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
