"""What the data and the design of a study say of its locations, before any scale is known.

The locations of all cells are B xi. The columns B hold the deviations that environments have of
their own, then the fixed terms. Slopes of covariates are locations beside them, not in B. xi is
standard normal, once the columns of own deviations are multiplied by their SDs. The matrices here
are sparse: a column of an own deviation reaches one environment, and a quantity's effects do not
reach the other quantity.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.model.covariates import Covariates
from percept.inference.model.design import Design, columns_by_quantity
from percept.inference.model.one_row import OneRow, is_one_row
from percept.inference.model.statistics import Pattern, Statistics
from percept.inference.model.trial_scatter import TrialScatter

__all__ = ["CellProblem", "PatternScatter"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Numbers in the largest temporary of a pass, 1 MB of doubles: more leave the processor's cache.
_NUMBERS = 1 << 17
#: Draws of a pass at the least: fewer cost more in calls of numpy than in arithmetic.
_FEWEST_DRAWS = 32
#: Draws of a pass at the most: calls cost little by then, and small designs need no more memory.
_MOST_DRAWS = 1024


@dataclasses.dataclass(frozen=True, eq=False)
class PatternScatter:
    """Scatter between the subjects of one pattern, as rows without a mean."""

    pattern: int
    cells: Indices  # (E,)
    rows: Array  # (n, P, E) Of responses
    slopes: Array  # (M P, n, P, E) Of what a slope of each covariate and quantity adds to them


class CellProblem:
    """Cells, patterns and columns of a study: P quantities, C cells, G patterns, J environments.

    Parameters
    ----------
    statistics : Statistics
        Cell means by pattern; its environments are the C cells.
    design : Design
        The columns.
    scatter : TrialScatter
        Scatter between trials, in T groups.
    covariate_sd : float
        Prior SD of the slopes of covariates.
    covariates : Covariates, optional
        Covariates of trials or subjects: M of them.

    Raises
    ------
    ValueError
        If the scatter is by subject, and several subjects share a pattern.

    Attributes
    ----------
    size, cells, environments : int
        Numbers P, C and J.
    subjects : ndarray
        Subjects of each pattern, (G,).
    present : ndarray
        One where a pattern has the cell, else zero, (C, G).
    trials : ndarray
        Trials of a cell, one where a pattern has none, (C, G).
    kind_of_cell : ndarray of int
        Kind of each cell of a pattern, (C, G): equal cells, groups of trials and numbers of them.
    cell_of_kind, group_of_kind, trials_of_kind, subjects_of_kind : ndarray
        Of each kind; the last is the number of subjects who have one.
    mean : ndarray
        Mean response of each pattern, (P, C, G); zero where it has no cell.
    covariate_mean : ndarray
        Mean of each covariate, (M, C, G); zero where a pattern has no cell.
    own_columns, fixed_columns : int
        Numbers of columns of own deviations, a in one environment, and of fixed terms, f.
    basis, sparse_basis : ndarray, csr_array
        Columns B of the cells, (P C, Q), and their transpose, (Q, P C), with Q = a J + f.
    own_products, mixed_products, fixed_products : csr_array
        Products of own columns with own ones, (a a J, P P C), of own with fixed ones,
        (a f J, P P C), and of fixed with fixed ones, (f f, P P C). Times the precisions
        (P P C, W) of cells, these give the precision of xi.
    one_row : OneRow or None
        The study as one row, if it is one.
    scatter : list of PatternScatter
        Scatter within the patterns of several subjects.
    constant : float
        Part of the log density that no scale enters: powers of the numbers of subjects.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        scatter: TrialScatter,
        covariate_sd: float,
        covariates: Covariates | None = None,
    ) -> None:
        patterns = statistics.patterns
        self.size, self.cells = statistics.x.shape
        self.environments = len(design.cells.environments)
        self.trial_scatter = scatter
        self.covariate_sd = covariate_sd
        counts = [pattern.subjects for pattern in patterns]
        self.subjects = np.array(counts, dtype=float)  # (G,)
        grid = (self.cells, len(patterns))
        self.present = np.zeros(grid)  # One where a pattern has the cell
        self.trials = np.ones(grid)  # Trials of a cell, one where there is none
        self.mean = np.zeros((self.size, *grid))
        for g, pattern in enumerate(patterns):
            self.present[pattern.environments, g] = 1.0
            self.trials[pattern.environments, g] = pattern.trials
            self.mean[:, pattern.environments, g] = pattern.mean
        #: (C, G) Group of trials that each cell of a pattern belongs to, or (C, 1) for all.
        self.trial_group = _trial_groups(scatter, patterns, self.cells)
        self._set_kinds()
        count = 0 if covariates is None else len(covariates.names)
        self.covariate_mean = np.zeros((count, *grid))
        if covariates is not None:
            self.covariate_mean = covariates.mean * self.present
        self._set_columns(design)
        self.one_row: OneRow | None = None
        if covariates is None and is_one_row(statistics, design):
            self.one_row = OneRow(statistics, design, self.own, self.fixed)
        self.scatter = [
            _pattern_scatter(g, pattern, covariates)
            for g, pattern in enumerate(patterns)
            if pattern.subjects > 1
        ]
        # Treats each pattern's mean as the observation, with covariances V/N.
        cells_of_pattern = self.present.sum(axis=0)
        log_counts = np.log(self.subjects)
        self.constant = 0.5 * self.size * float(log_counts @ cells_of_pattern)

    def _set_kinds(self) -> None:
        """Give every kind of cells a number."""
        grid = self.present.shape
        cell = np.broadcast_to(np.arange(self.cells)[:, None], grid)
        group = np.broadcast_to(self.trial_group, grid)
        labels = np.stack([cell.ravel(), group.ravel(), self.trials.ravel()])
        kinds, number = np.unique(labels, axis=1, return_inverse=True)
        self.kind_of_cell = number.reshape(grid)
        self.cell_of_kind = kinds[0].astype(np.intp)
        self.group_of_kind = kinds[1].astype(np.intp)
        self.trials_of_kind = kinds[2]
        weights = self.present * self.subjects
        self.subjects_of_kind = np.bincount(number.ravel(), weights=weights.ravel())

    @property
    def slopes(self) -> int:
        """Number of slopes of covariates, one for each quantity."""
        return len(self.covariate_mean) * self.size

    @property
    def deviations(self) -> int:
        """Number of own deviations: one for each of their columns and environment."""
        return self.own_columns * self.environments

    @property
    def locations(self) -> int:
        """Number R of locations: cells, quantity by quantity, and slopes of covariates."""
        return self.size * self.cells + self.slopes

    def _set_columns(self, design: Design) -> None:
        """Store the columns of cells: own deviations first, environment by environment."""
        own = columns_by_quantity(design.deviation, self.size, self.cells)
        fixed = columns_by_quantity(design.fixed, self.size, self.cells)
        #: Columns of own deviations, (a, P, C), and of fixed terms, (f, P, C).
        self.own = own
        self.fixed = fixed
        #: (J, C) One where a cell is of the environment.
        number = np.arange(self.environments)[:, None]
        in_environment = number == design.cells.environment
        self.own_columns = len(own)
        self.fixed_columns = len(fixed)
        spread = own[:, None] * in_environment[:, None]  # (o P, J, P, C)
        count = len(own) * self.environments
        deviations = spread.reshape(count, self.size, self.cells)
        columns = np.concatenate([deviations, fixed])
        flat = columns.reshape(len(columns), self.size * self.cells)
        #: (P C, Q) Columns of the cells.
        self.basis = flat.T
        self.sparse_basis = sparse.csr_array(flat)  # (Q, P C)
        # Products of columns, as they weigh the entries (P, P, C) of the cells' information.
        by_environment = in_environment.astype(float)
        everywhere = np.ones((1, self.cells))
        self.own_products = _products(own, own, by_environment)
        self.mixed_products = _products(own, fixed, by_environment)
        self.fixed_products = _products(fixed, fixed, everywhere)

    def own_sd(self, tau: Array) -> Array:
        """SDs (o P, W) of own deviations, in the order of their columns, from (o, P, W)."""
        return tau.reshape(self.own_columns, tau.shape[-1])

    def eliminates_environments(self, effects: int) -> bool:
        """Whether the subjects' effects are fewer than the environments' own deviations."""
        of_subjects = effects * len(self.subjects)
        return of_subjects < self.deviations

    def draws_per_pass(self, effects: int) -> int:
        """Draws worked on at once, for so many columns of subjects' effects."""
        if self.one_row is not None:
            return self.one_row.draws_per_pass(effects)
        columns = max(self.size * self.cells, self.deviations)
        numbers = columns * len(self.subjects) * max(effects, 1)
        draws = max(_NUMBERS // numbers, _FEWEST_DRAWS)
        return min(draws, _MOST_DRAWS)


def _products(
    first: Array,
    second: Array,
    groups: Array,
) -> sparse.csr_array:
    """Products of columns (a, P, C) and (b, P, C) by group of cells: (a b groups, P P C)."""
    products = np.einsum("apc,bqc,jc->abjpqc", first, second, groups)
    *of_columns, size, _, cells = products.shape
    rows = math.prod(of_columns)
    flat = products.reshape(rows, size * size * cells)
    return sparse.csr_array(flat)


def _trial_groups(
    scatter: TrialScatter,
    patterns: tuple[Pattern, ...],
    cells: int,
) -> Indices:
    """Return the group of trials of each cell and pattern, zero where there is none."""
    if scatter.subject is None:
        groups = np.zeros((cells, 1), dtype=np.intp)
        count = len(scatter.cell)
        groups[scatter.cell, 0] = np.arange(count)
        return groups
    pattern_of = np.zeros(len(patterns), dtype=np.intp)
    for g, pattern in enumerate(patterns):
        if pattern.subjects > 1:
            raise ValueError(
                "Subjects with trial SDs of their own need a pattern each: "
                f"pattern {g} has {pattern.subjects} subjects. See statistics.apart_by_subject."
            )
        pattern_of[pattern.members] = g
    groups = np.zeros((cells, len(patterns)), dtype=np.intp)
    count = len(scatter.cell)
    groups[scatter.cell, pattern_of[scatter.subject]] = np.arange(count)
    return groups


def _pattern_scatter(
    number: int, pattern: Pattern, covariates: Covariates | None
) -> PatternScatter:
    """Rows of one pattern, and what slopes of covariates add to them."""
    subjects_first = pattern.rows.transpose(1, 0, 2)
    rows = np.ascontiguousarray(subjects_first)
    size = rows.shape[1]
    slopes = np.zeros((0, *rows.shape))
    if covariates is not None:
        of_covariates = covariates.between[number]
        count = of_covariates.shape[1]
        slopes = np.zeros((count, size, *rows.shape))
        for p in range(size):
            slopes[:, p, :, p] = of_covariates.swapaxes(0, 1)
        slopes = slopes.reshape(-1, *rows.shape)
    return PatternScatter(number, pattern.environments, rows, slopes)
