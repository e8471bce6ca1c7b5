"""Subjects' own means in every cell of a study with factors, on the model's scale."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
import pandas as pd

from percept.inference.classical.trials import subject_means
from percept.sessions.records import Factors
from percept.study.basics import Array
from percept.study.conditions import CellKey, Comparison
from percept.study.responses import Trials

__all__ = ["SubjectCells", "subject_cells"]


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectCells:
    """Subjects' means of one quantity over their trials; groups of subjects are no cells."""

    values: pd.DataFrame  # A row per subject, a column per cell; NaN without a trial
    groups: pd.DataFrame  # A row per subject: its level of each factor between subjects
    within: tuple[int, ...]  # Indices of the factors within subjects among all factors

    @property
    def cells(self) -> list[CellKey]:
        """Environments, and levels of the factors within subjects."""
        return cast(list[CellKey], list(self.values.columns))

    @property
    def references(self) -> list[str]:
        """Environments of the cells."""
        return list(dict.fromkeys(environment for environment, _ in self.cells))

    def in_cells(self, cells: Sequence[CellKey]) -> Array:
        """Values in these cells, (subjects, cells); NaN in a cell that the study lacks."""
        columns = pd.Index(list(cells), tupleize_cols=False)
        return self.values.reindex(columns=columns).to_numpy(dtype=float)

    def weights(self, weights: Mapping[CellKey, float]) -> dict[CellKey, float]:
        """Add up the weights of cells that differ in their groups alone."""
        sums: dict[CellKey, float] = {}
        for (environment, levels), weight in weights.items():
            levels_within = tuple(levels[factor] for factor in self.within)
            cell = (environment, levels_within)
            sums[cell] = sums.get(cell, 0.0) + weight
        return sums

    def weighed(self, weights: Mapping[CellKey, float]) -> pd.Series[float]:
        """Sum each subject's weighted cells; NaN for subjects who lack a cell."""
        cells = list(weights)
        weight_of_cell = np.array(list(weights.values()))
        sums = self.in_cells(cells) @ weight_of_cell
        return pd.Series(sums, index=self.values.index)

    def at_level(self, comparison: Comparison) -> pd.Series[float]:
        """Each subject's mean at one level; NaN in other groups, and where a cell is lacking."""
        weights = self.weights(comparison.weights)
        means = self.weighed(weights)
        if comparison.factor in self.groups:
            is_in_group = self.groups[comparison.factor] == comparison.second
            means = means.where(is_in_group)
        return means


def subject_cells(data: Trials, factors: Factors, between: frozenset[str]) -> SubjectCells:
    """Average the trials of each subject in each cell.

    Parameters
    ----------
    data : Trials
        Of one quantity.
    factors : Factors
        Columns and their levels.
    between : frozenset of str
        Factors of which every subject has one level only.

    Returns
    -------
    SubjectCells
    """
    within = tuple(place for place, name in enumerate(factors.levels) if name not in between)
    means: dict[CellKey, list[pd.Series[float]]] = {}
    for code, name in enumerate(data.environments):
        environment, levels = factors.cells[name]
        rows = data.environment == code
        subjects = data.subject[rows]
        values = subject_means(data.response[rows, 0], subjects).values
        series = pd.Series(values, index=list(dict.fromkeys(subjects.tolist())))
        cell = (environment, tuple(levels[place] for place in within))
        means.setdefault(cell, []).append(series)
    # Each subject is in one group, so that the parts of a cell have no subject twice.
    columns = [pd.concat(parts) for parts in means.values()]
    table = pd.DataFrame(dict(enumerate(columns))).sort_index()
    table.columns = pd.Index(list(means), tupleize_cols=False)
    groups = pd.DataFrame(index=table.index)
    for column in between:
        of_cells = np.array([factors.level(name, column) for name in data.environments])
        of_rows = pd.Series(of_cells[data.environment], index=data.subject)
        groups[column] = of_rows.groupby(level=0).first()
    return SubjectCells(table, groups, within)
