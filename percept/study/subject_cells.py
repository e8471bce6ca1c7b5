"""Subjects' own means in every cell of a study with factors, on the model's scale."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.sessions.records import Factors
from percept.study.basics import Array
from percept.study.conditions import CellKey, Comparison
from percept.study.responses import Trials


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectCells:
    """Means of N subjects over their trials, of one quantity; groups of subjects are no cells."""

    #: (N,) by environment and levels of the factors within subjects; NaN without a trial.
    values: dict[CellKey, Array]
    groups: dict[str, NDArray[np.object_]]  # (N,) Level of each factor between subjects
    within: tuple[int, ...]  # Indices of the factors within subjects among all factors

    @property
    def references(self) -> list[str]:
        """Environments of the cells."""
        return list(dict.fromkeys(environment for environment, _ in self.values))

    def in_cells(self, cells: Sequence[CellKey]) -> Array:
        """Values in these cells, (N, cells); NaN in a cell that the study lacks."""
        lacking = np.full_like(next(iter(self.values.values())), np.nan)
        return np.stack([self.values.get(cell, lacking) for cell in cells], axis=1)

    def own(self, comparison: Comparison) -> Comparison:
        """Add up the weights of cells that differ in their groups alone."""
        sums: dict[CellKey, float] = {}
        for (environment, levels), weight in comparison.weights.items():
            cell = (environment, tuple(levels[factor] for factor in self.within))
            sums[cell] = sums.get(cell, 0.0) + weight
        return dataclasses.replace(comparison, weights=sums)

    def weighed(self, weights: Mapping[CellKey, float]) -> Array:
        """Sum each subject's weighted cells, (N,); NaN for subjects who lack a cell."""
        return np.asarray(self.in_cells(list(weights)) @ np.array(list(weights.values())))

    def at_level(self, comparison: Comparison) -> Array:
        """Each subject's mean at one level; NaN in other groups, and where a cell is lacking."""
        means = self.weighed(self.own(comparison).weights)
        if comparison.factor in self.groups:
            means[self.groups[comparison.factor] != comparison.second] = np.nan
        return means


def subject_cells(data: Trials, factors: Factors, between: frozenset[str]) -> SubjectCells:
    """Lay out the mean of each subject in each cell, of trials of one quantity.

    Every subject has one level only of the factors `between`.
    """
    within = tuple(place for place, name in enumerate(factors.levels) if name not in between)
    means = data.statistics.cell_means[:, 0]
    values: dict[CellKey, Array] = {}
    groups = {name: np.full(len(means), "", dtype=object) for name in between}
    for column, name in zip(means.T, data.environments, strict=True):
        environment, levels = factors.cells[name]
        cell = (environment, tuple(levels[place] for place in within))
        present = np.isfinite(column)
        # Each subject is in one group, so that the parts of a cell have no subject twice.
        values.setdefault(cell, np.full(len(means), np.nan))[present] = column[present]
        for group, level in groups.items():
            level[present] = factors.level(name, group)
    return SubjectCells(values, groups, within)
