"""What cells say of the locations, pattern by pattern, before any scale is known.

Subjects with the same trials in the same environments share a pattern. Cells of one environment
with equal numbers of trials have equal noise: they are of one kind. Each precision is computed once
for a kind, and summed over the patterns of subjects that have it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.statistics import Pattern

__all__ = ["InformationProblem"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Draws of a pass at the most: more put temporaries out of the processor's cache.
_MOST_DRAWS = 128
#: Draws of a pass at the least: fewer cost more in calls of numpy than in arithmetic.
_FEWEST_DRAWS = 8
#: Numbers in a temporary over cells: 1 MB of doubles, which a core's own cache holds.
_NUMBERS_OVER_CELLS = 1 << 17
#: Numbers in the matrices of the locations: 32 MB of doubles. They are factored one by one, so
#: memory limits them, and not the cache.
_NUMBERS_OF_MATRICES = 1 << 22


class InformationProblem:
    """Cells of P quantities, J environments, G patterns, K kinds of cells and R rows of scatter.

    Parameters
    ----------
    patterns : tuple of Pattern
        Subjects with the same environments and trials, and their mean responses.
    prior_columns : ndarray
        Columns X of alpha and gamma, times their prior SDs, (A, P, J).

    Attributes
    ----------
    trend : ndarray
        Columns X over all locations, quantity by quantity, (A, P J).
    subjects : ndarray
        Subjects of each pattern, (G,).
    environment, trials : ndarray
        Environment and trials of each kind of cells, (K,).
    kind_of_cell : ndarray of int
        Kind of each cell, (J, G); K where a pattern has no cell.
    has_kind : ndarray
        One where a pattern has a kind, else zero, (K, G).
    subjects_of_kind : ndarray
        Subjects who have each kind, (K,).
    in_environment : ndarray
        One where a kind is of the environment, else zero, (J, K).
    centre : ndarray
        Mean response of each environment over its subjects, (P, J).
    mean : ndarray
        Mean response of each pattern less the centre, (P, J, G); zero where it has no cell.
    mean_of_kind : ndarray
        The same by kind, (P, K, G).
    rows : ndarray
        Rows of scatter within patterns, (P, J, R); zero where a pattern has no cell.
    row_pattern : ndarray of int
        Pattern of each row, (R,).
    constant : float
        Part of the log density that no scale enters: powers of the numbers of subjects.
    """

    def __init__(self, patterns: tuple[Pattern, ...], prior_columns: Array) -> None:
        self.quantities, self.environments = prior_columns.shape[1:]
        self.trend = prior_columns.reshape(len(prior_columns), -1)
        subjects = [pattern.subjects for pattern in patterns]
        self.subjects = np.array(subjects, dtype=float)
        self._set_kinds(patterns)
        self._set_means(patterns)
        self._set_scatter(patterns)
        # Treats each pattern's mean as the observation, with covariances V_g / n_g of n_g subjects.
        kinds_of_pattern = self.has_kind.sum(axis=0)
        log_subjects = np.log(self.subjects) @ kinds_of_pattern
        self.constant = 0.5 * self.quantities * float(log_subjects)

    def _set_kinds(self, patterns: tuple[Pattern, ...]) -> None:
        """Store the kinds of cells, in order, and the patterns that have each."""
        distinct = set[tuple[int, float]]()
        for pattern in patterns:
            distinct.update(_kinds_of(pattern))
        kinds = sorted(distinct)
        self.environment = np.array([environment for environment, _ in kinds])
        self.trials = np.array([trials for _, trials in kinds])
        absent = len(kinds)
        shape = (self.environments, len(patterns))
        self.kind_of_cell = np.full(shape, absent)
        for g, pattern in enumerate(patterns):
            numbers = [kinds.index(kind) for kind in _kinds_of(pattern)]
            self.kind_of_cell[pattern.environments, g] = numbers
        kind = np.arange(len(kinds))[:, None, None]
        is_of_kind = self.kind_of_cell == kind  # (K, J, G)
        self.has_kind = is_of_kind.any(axis=1).astype(float)
        self.subjects_of_kind = self.has_kind @ self.subjects
        environment = np.arange(self.environments)[:, None]
        is_in_environment = self.environment == environment
        self.in_environment = is_in_environment.astype(float)

    def _set_means(self, patterns: tuple[Pattern, ...]) -> None:
        """Store means about each environment's centre: a common offset stays out of products."""
        shape = (self.quantities, self.environments, len(patterns))
        mean = np.zeros(shape)
        for g, pattern in enumerate(patterns):
            mean[:, pattern.environments, g] = pattern.mean
        present = self.kind_of_cell < len(self.trials)
        weight = np.where(present, self.subjects, 0.0)
        sums = np.einsum("jg,pjg->pj", weight, mean)
        self.centre = sums / weight.sum(axis=1)
        departure = mean - self.centre[..., None]
        self.mean = np.where(present, departure, 0.0)
        self.mean_of_kind = self.mean[:, self.environment] * self.has_kind

    def _set_scatter(self, patterns: tuple[Pattern, ...]) -> None:
        """Store the rows of scatter of patterns with several subjects."""
        rows = [np.zeros((self.quantities, self.environments, 0))]
        row_pattern: list[int] = []
        for g, pattern in enumerate(patterns):
            if pattern.subjects == 1:
                continue
            count = pattern.rows.shape[1]
            of_pattern = np.zeros((self.quantities, self.environments, count))
            of_pattern[:, pattern.environments] = pattern.rows.transpose(0, 2, 1)
            rows.append(of_pattern)
            row_pattern += [g] * count
        self.rows = np.concatenate(rows, axis=2)
        self.row_pattern: Indices = np.array(row_pattern, dtype=np.intp)

    @property
    def draws_per_pass(self) -> int:
        """Draws worked on at once."""
        locations = self.quantities * self.environments
        vectors = len(self.subjects) + len(self.row_pattern)
        by_cells = _NUMBERS_OVER_CELLS // (self.environments * vectors)
        by_matrices = _NUMBERS_OF_MATRICES // locations**2
        draws = min(by_cells, by_matrices, _MOST_DRAWS)
        return max(draws, _FEWEST_DRAWS)


def _kinds_of(pattern: Pattern) -> list[tuple[int, float]]:
    """Kind of each cell of a pattern: its environment and its number of trials."""
    environments = pattern.environments.tolist()
    return list(zip(environments, pattern.trials, strict=True))
