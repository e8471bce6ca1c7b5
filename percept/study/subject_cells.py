"""Subjects' means and trial SDs in every cell of a study with factors, on the model's scale."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.classical.variability import log_sd
from percept.sessions.records import Factors
from percept.study.basics import Array
from percept.study.comparisons import Comparison
from percept.study.conditions import CellKey
from percept.study.responses import Trials


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectCells:
    """One number of each of N subjects in a cell, such as the mean of the trials.

    Groups of subjects are no cells.
    """

    #: (N,) by environment and levels of the factors within subjects; NaN where there is none.
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


def log_trial_sds(data: Trials) -> Array:
    """Log SDs between trials of one quantity, by subject and cell (N, C).

    −∞ where trials are all equal, NaN without repeats.
    """
    found = np.full(data.statistics.cell_means[:, 0].shape, np.nan)
    cells = np.stack([data.subject, data.environment])
    pairs, group = np.unique(cells, axis=1, return_inverse=True)
    for number, (i, c) in enumerate(pairs.T):
        trials = data.response[group == number, 0]
        if len(trials) > 1:
            # Rounding of the mean is no scatter.
            sd = trials.std(ddof=1) if np.ptp(trials) > 0.0 else 0.0
            found[i, c] = log_sd(sd, len(trials) - 1.0)
    return found


def repeated_cells(data: Trials, factors: Factors) -> list[CellKey]:
    """Return the cells in which subjects repeat trials."""
    counts = zip(data.environments, data.statistics.trial_df, strict=True)
    return [factors.cells[name] for name, df in counts if df > 0.0]


def subject_cells(
    means: Array, data: Trials, factors: Factors, between: frozenset[str]
) -> SubjectCells:
    """Lay out a number of each subject in each cell (N, C), of trials of one quantity.

    Every subject has one level only of the factors `between`.
    """
    within = tuple(place for place, name in enumerate(factors.levels) if name not in between)
    values: dict[CellKey, Array] = {}
    groups = {name: np.full(len(means), "", dtype=object) for name in between}
    for column, name in zip(means.T, data.environments, strict=True):
        environment, levels = factors.cells[name]
        cell = (environment, tuple(levels[place] for place in within))
        present = np.isfinite(column)
        if not present.any():
            continue
        # Each subject is in one group, so that the parts of a cell have no subject twice.
        values.setdefault(cell, np.full(len(means), np.nan))[present] = column[present]
        for group, level in groups.items():
            level[present] = factors.level(name, group)
    return SubjectCells(values, groups, within)
