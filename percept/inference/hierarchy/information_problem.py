"""What cells say of the locations, pattern by pattern, before any scale is known.

Cells of one environment with equal numbers of trials have equal noise: they are of one kind. Each
precision is computed once for a kind, and summed over the patterns of subjects that have it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.statistics import Pattern

__all__ = ["InformationProblem"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Draws of a pass: more cost the processor's cache, fewer cost calls.
_MOST_DRAWS = 128
_FEWEST_DRAWS = 8
#: Numbers in a temporary of a pass over cells.
_CELLS = 1 << 17
#: Numbers in a temporary of a pass over the matrix of the locations.
_MATRIX = 1 << 22


class InformationProblem:
    """Cells of J environments, G patterns and K kinds of cells.

    Parameters
    ----------
    patterns : tuple of Pattern
        Subjects with the same environments and trials, and their mean responses.
    prior_columns : ndarray
        Columns of alpha and gamma, times their prior SDs, (Q, P, J).
    """

    def __init__(self, patterns: tuple[Pattern, ...], prior_columns: Array) -> None:
        self.prior_columns = prior_columns
        self.size, self.environments = prior_columns.shape[1:]
        subjects = [pattern.subjects for pattern in patterns]
        self.subjects = np.array(subjects, dtype=float)  # (G,)
        self._set_kinds(patterns)
        self._set_means(patterns)
        # Treats each pattern's mean as the observation, with covariances V_g over the subjects.
        kinds_of_pattern = self.has_kind.sum(axis=0)
        self.constant = 0.5 * self.size * float(np.log(self.subjects) @ kinds_of_pattern)
        self._set_scatter(patterns)

    def _set_kinds(self, patterns: tuple[Pattern, ...]) -> None:
        """Store the kinds of cells, in order, and the patterns that have each."""
        distinct = set[tuple[int, float]]()
        for pattern in patterns:
            distinct.update(_cells(pattern))
        kinds = sorted(distinct)
        index = {kind: k for k, kind in enumerate(kinds)}
        self.environment = np.array([environment for environment, _ in kinds])  # (K,)
        self.trials = np.array([trials for _, trials in kinds])  # (K,)
        #: (J, G) Kind of each cell; K where there is none.
        self.kind = np.full((self.environments, len(patterns)), len(kinds))
        for g, pattern in enumerate(patterns):
            self.kind[pattern.environments, g] = [index[cell] for cell in _cells(pattern)]
        kind_numbers = np.arange(len(kinds))[:, None, None]
        #: (K, G) One where a pattern has a kind.
        self.has_kind = (self.kind == kind_numbers).any(axis=1) * 1.0
        #: (K,) Subjects who have a kind.
        self.subjects_of_kind = self.has_kind @ self.subjects
        environment_numbers = np.arange(self.environments)[:, None]
        #: (J, K) One where a kind is of the environment.
        self.in_environment = (self.environment == environment_numbers) * 1.0

    def _set_means(self, patterns: tuple[Pattern, ...]) -> None:
        """Store means about those of environments: a common offset stays out of products."""
        mean = np.zeros((self.size, self.environments, len(patterns)))
        for g, pattern in enumerate(patterns):
            mean[:, pattern.environments, g] = pattern.mean
        present = self.kind < len(self.trials)
        weight = np.where(present, self.subjects, 0.0)
        sums = np.einsum("jg,pjg->pj", weight, mean)
        self.centre = sums / weight.sum(axis=1)  # (P, J)
        self.mean = np.where(present, mean - self.centre[..., None], 0.0)  # (P, J, G)
        self.mean_of_kind = self.mean[:, self.environment] * self.has_kind  # (P, K, G)

    def _set_scatter(self, patterns: tuple[Pattern, ...]) -> None:
        """Store rows of scatter within patterns, (P, J, R), zero where unmeasured."""
        rows = []
        row_pattern: list[int] = []
        for g, pattern in enumerate(patterns):
            if pattern.subjects > 1:
                count = pattern.rows.shape[1]
                of_pattern = np.zeros((self.size, self.environments, count))
                of_pattern[:, pattern.environments] = pattern.rows.transpose(0, 2, 1)
                rows.append(of_pattern)
                row_pattern += [g] * count
        nothing = np.zeros((self.size, self.environments, 0))
        self.rows = np.concatenate([nothing, *rows], axis=2)
        #: (R,) Pattern of each row.
        self.row_pattern: Indices = np.array(row_pattern, dtype=np.intp)

    @property
    def draws_per_pass(self) -> int:
        """Draws worked on at once."""
        locations = self.size * self.environments
        columns = len(self.subjects) + len(self.row_pattern)
        by_cells = _CELLS // (self.environments * columns)
        by_matrix = _MATRIX // locations**2
        return max(min(by_cells, by_matrix, _MOST_DRAWS), _FEWEST_DRAWS)


def _cells(pattern: Pattern) -> list[tuple[int, float]]:
    """Environment and trials of each cell of a pattern."""
    return list(zip(pattern.environments.tolist(), pattern.trials, strict=True))
