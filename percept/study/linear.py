"""The hierarchical model of studies with factors, groups or covariates, and its contrasts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.contrasts import ContrastEstimands, ContrastRows
from percept.inference.hierarchy.covariates import Covariates, with_covariates
from percept.inference.hierarchy.design import Cells, design_of
from percept.inference.hierarchy.design import Factors as CellFactors
from percept.inference.hierarchy.linear import LinearModel
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import Statistics
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import Array, claim_of
from percept.study.conditions import (
    CellKey,
    Comparison,
    Conditions,
    comparisons,
    covariate_values,
    level_means,
)
from percept.study.responses import Trials, by_difference, lacking_scatter, trials

__all__ = ["LinearStudy", "linear_study"]

#: A quantity, and what is compared in it.
Compared = tuple[str, Comparison]


@dataclasses.dataclass(frozen=True, eq=False)
class LinearStudy:
    """A model of all cells together, and its contrasts."""

    model: LinearModel
    estimands: ContrastEstimands
    cells: tuple[CellKey, ...]  # Environment and levels of each cell
    users: tuple[Compared, ...]  # Contrasts that each user has too
    groups: tuple[Compared, ...]  # Contrasts of different users, and slopes
    spreads: tuple[Compared, ...]  # Ratios of SDs between users
    spread_rows: Array  # (L, R) Positive at the cells of the second SD, negative at the first's

    def log_ratio(self, number: int) -> Callable[[Array], Array]:
        """Log ratio of SDs of one of `spreads`, of coordinates (W, d)."""
        row = self.spread_rows[number]
        rows = np.stack([np.maximum(row, 0.0), np.maximum(-row, 0.0)])

        def ratio(points: Array) -> Array:
            second, first = self.model.log_user_sds(rows, points).T
            return np.asarray(second - first)

        return ratio

    def subjects_of(self, comparison: Comparison, parameter: str) -> int:
        """Count the subjects that a contrast rests on."""
        statistics = self.model.statistics
        present = np.isfinite(statistics.cell_means[:, 0])  # (N, C)
        if not comparison.weights:
            return len(present)
        if not comparison.within:
            weighed = [cell in comparison.weights for cell in self.cells]
            return int(present[:, weighed].any(axis=1).sum())
        complete = np.zeros(len(present), dtype=bool)
        for environment in comparison.references:
            own = [cell for cell in comparison.weights if cell[0] == environment]
            complete |= self._at_all_levels(present, own, comparison)
        return int(complete.sum())

    def _at_all_levels(
        self, present: NDArray[np.bool_], own: Sequence[CellKey], comparison: Comparison
    ) -> NDArray[np.bool_]:
        """Subjects with a cell of either sign."""
        complete = np.ones(len(present), dtype=bool)
        for sign in (-1.0, 1.0):
            side = [cell in own and comparison.weights[cell] * sign > 0 for cell in self.cells]
            if any(side):
                complete &= present[:, side].any(axis=1)
        return complete


def linear_study(
    sessions: Sessions, scene: Scene, parameters: tuple[str, ...], conditions: Conditions
) -> LinearStudy:
    """Build the model of one or two quantities over all cells.

    Parameters
    ----------
    sessions : Sessions
        Whose environments are told apart by the factors' levels.
    scene : Scene
        With priors and claims.
    parameters : tuple of str
        One quantity or two.
    conditions : Conditions
        Factors, groups and covariates.

    Returns
    -------
    LinearStudy

    Raises
    ------
    RefusalError
        A model without pooling, a single cell, or data without scatter.
    """
    if scene.model.pooling == "none":
        raise RefusalError('they need [model] pooling = "partial".')
    scaled = [p for p in parameters if by_difference(sessions, p)]
    data = trials(sessions, scene, parameters, scaled=scaled)
    lacking_scatter(data.statistics, (), sessions.quantities)
    statistics, covariates, sizes = _with_covariates(data, sessions, conditions)
    keys = tuple(_key(sessions, cell) for cell in data.environments)
    priors = Priors(**scene.model.priors)
    design = design_of(*_design(keys, statistics, sessions, conditions), priors)
    model = LinearModel(statistics, design, priors, covariates)
    found: list[Comparison] = []
    if sessions.factors is not None:
        found = list(comparisons(conditions, sessions.factors, keys))
        found += level_means(conditions, sessions.factors, keys)
    slopes = [
        Comparison(
            name, "the same", "1 more", None, tuple(_environments(keys)), {}, True, unit=size
        )
        for name, size in zip(conditions.covariates, sizes, strict=True)
    ]
    users = [(p, own) for p in parameters for own in found if own.of_users]
    groups = [(p, own) for p in parameters for own in found if not own.of_users]
    groups += [(p, own) for p in parameters for own in slopes]
    contrasts = [own for own in found if own.of == "bias"]
    # Where the spread of subjects' effects is one for all levels, a ratio would be falsely certain.
    spreads = [(p, own) for p in parameters for own in contrasts if own.factor in conditions.spread]
    rows = ContrastRows(
        users=_stacked(users, parameters, keys, conditions),
        groups=_stacked(groups, parameters, keys, conditions),
    )
    claims = IntervalEstimands(model, kinds=scene.inference.kinds, **claim_of(scene.inference))
    names = tuple(_named(*compared) for compared in (*users, *groups))
    return LinearStudy(
        model=model,
        estimands=ContrastEstimands(model, rows, names, claims),
        cells=keys,
        users=tuple(users),
        groups=tuple(groups),
        spreads=tuple(spreads),
        spread_rows=_stacked(spreads, parameters, keys, conditions),
    )


def _with_covariates(
    data: Trials, sessions: Sessions, conditions: Conditions
) -> tuple[Statistics, Covariates | None, Array]:
    """Statistics of the trials, their covariates, and the covariates' SDs."""
    names = conditions.covariates
    if not names:
        return data.statistics, None, np.ones(0)
    table = sessions.table.loc[data.rows]
    values = covariate_values(table, names)
    sizes = table[list(names)].astype(float).std(ddof=0).to_numpy()
    statistics, covariates = with_covariates(
        data.response, data.subject, data.environment, values, names, data.statistics
    )
    return statistics, covariates, sizes


def _key(sessions: Sessions, cell: str) -> CellKey:
    """Environment and levels of a cell."""
    return (cell, ()) if sessions.factors is None else sessions.factors.cells[cell]


def _environments(keys: Sequence[CellKey]) -> list[str]:
    return list(dict.fromkeys(environment for environment, _ in keys))


def _design(
    keys: Sequence[CellKey], statistics: Statistics, sessions: Sessions, conditions: Conditions
) -> tuple[Cells, CellFactors]:
    """Cells and factors by number."""
    environments = _environments(keys)
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
            present = tuple(name for name in names if any(own[place] == name for _, own in keys))
            levels[factor] = present
            level[factor] = np.array([present.index(own[place]) for _, own in keys])
    if any(len(present) < 2 for present in levels.values()):
        raise RefusalError("a factor has one level left in the data.")
    factors = CellFactors(
        levels=levels,
        level=level,
        terms=conditions.terms,
        between=conditions.between,
        spread=conditions.spread,
    )
    return cells, factors


def _stacked(
    compared: Sequence[Compared],
    parameters: tuple[str, ...],
    keys: Sequence[CellKey],
    conditions: Conditions,
) -> Array:
    """Weights of the model's locations: cells quantity by quantity, then slopes."""
    size = len(parameters)
    cells = len(keys)
    rows = np.zeros((len(compared), size * (cells + len(conditions.covariates))))
    for number, (parameter, comparison) in enumerate(compared):
        p = parameters.index(parameter)
        if comparison.weights:
            rows[number, p * cells : (p + 1) * cells] = comparison.row(keys)
        else:
            m = conditions.covariates.index(comparison.factor)
            rows[number, size * cells + m * size + p] = 1.0
    return rows


def _named(parameter: str, comparison: Comparison) -> str:
    """Name a contrast in messages of the sampler."""
    where = comparison.environment or "overall"
    versus = f"{comparison.second} against {comparison.first}"
    return f"{parameter}, {comparison.factor}: {versus}, {where}"
