"""One row of data for all subjects: the density and locations of a study with one pattern.

Where all N subjects have equal cells and trials, their cell means are one row, the mean over
subjects, and N - 1 contrasts of subjects. Given the scales, with D the noise of a subject's cells
and Z the columns of a subject's effects,

    contrasts    N(0, D + ZZ')
    mean × √N    N(√N X c + Z b, D + N OT²O')

X holds the columns of fixed terms. O holds the columns of the environments' own deviations, whose
SDs are T. c and b are standard normal. Own deviations count as noise of the mean: blocks by
environment. Whitened
by it, Z, √N X and √N times the mean itself are few columns A, and all that is asked follows from a
small Cholesky factor of I + A'A. No large precisions are subtracted, so that no digits are lost
where noise is small.

An environment of one cell has a small `Block` of noise. With several cells, columns are whitened by
D, own deviations U too, and the others are regressed on these: with B the coefficients of the
regression, the rows of A are A - UB and T⁻¹B.

Published limits are a row as well: without effects of subjects each cell has its own N.

Arrays have P quantities, C cells, J environments with L cells at most, a own columns, W sets of
scales, and K columns of effects and fixed terms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import (
    Block,
    add_to_diagonal,
    draws_at_once,
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
)
from percept.inference.model.design import Basis, Design
from percept.inference.model.gaussian import Eliminated, SubjectCovariance
from percept.inference.model.scales import CellScales
from percept.inference.model.statistics import Statistics

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def is_one_row(statistics: Statistics, design: Design) -> bool:
    """Whether the cell means of all subjects are one row and contrasts."""
    patterns = statistics.patterns
    if design.subject or len(patterns) == 1:
        return len(patterns) == 1
    cells = np.concatenate([pattern.environments for pattern in patterns])
    return len(np.unique(cells)) == len(cells)


class OneRow:
    """Cell means of a study whose subjects share one pattern, or whose cells share no subject.

    Parameters
    ----------
    statistics : Statistics
        Its environments are the design's cells.
    design : Design
        Whose cells these are.
    basis : Basis
        Columns of the locations.

    Attributes
    ----------
    draws_per_pass : int
        Draws worked on at once.
    matrix : ndarray
        Weights of the unknowns that `solve` gives in the R locations.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        basis: Basis,
    ) -> None:
        quantities, cells = design.cells.x.shape
        subjects = np.zeros(cells)
        trials = np.ones(cells)
        mean = np.zeros((quantities, cells))
        triangles = np.zeros((quantities, quantities, cells))
        for pattern in statistics.patterns:
            present = pattern.environments
            subjects[present] = pattern.subjects
            trials[present] = pattern.trials
            mean[:, present] = pattern.mean
            triangles[..., present] = pattern.triangles
        #: (C,) Contrasts of subjects in each cell: all the same if subjects have effects.
        self._contrasts = subjects - 1.0
        self._trials = trials[:, None]
        #: The pattern of all subjects; published limits have more.
        self._pattern = statistics.patterns[0]
        #: (P, P, C) Rows whose products sum to the scatter between subjects, cell by cell.
        self._triangles = triangles
        root_subjects = np.sqrt(subjects)
        #: (a, P, C) Own deviations' columns in the mean times √N.
        self._own = root_subjects * basis.own
        self.matrix = basis.with_effects(design.effects, basis.deviations)
        #: (f + 1, P, C) Fixed columns, and the subjects' mean, times √N.
        self._fixed_and_mean = root_subjects * np.concatenate([basis.fixed, mean[None]])
        #: (L, J) Cells of each environment.
        self._cells_of_environment = _cells_of_environment(design)
        most_cells, environments = self._cells_of_environment.shape
        row_count = (quantities * most_cells + len(basis.own)) * environments
        numbers = (design.effects + len(self._fixed_and_mean)) * row_count
        self.draws_per_pass = draws_at_once(numbers)

    def log_density(self, scales: CellScales) -> Array:
        """Log density of all cell means, (W,), without `Statistics.constant`."""
        noise = self._noise(scales)
        minus_twice = self._minus_twice_of_contrasts(noise, scales)
        if len(self._cells_of_environment) == 1:
            rows, log_determinant = self._rows_of_single_cells(noise, scales)
        else:
            factor, _, rows = self._regressed(noise, scales)
            log_determinant = noise.log_determinant().sum(axis=0)
            log_determinant += 2.0 * log_diagonal(factor).sum(axis=0)
            environments = self._cells_of_environment.shape[1]
            log_determinant += 2.0 * environments * np.log(scales.tau).sum(axis=0)
        joint = _joint_precision(rows)
        latents = len(joint) - 1
        factor = lower_factor(joint[:, :latents])
        solution = solve_upper(factor[:latents], factor[latents])
        fitted = np.einsum("kmw,kw->mw", rows[:-1], solution)
        residual = rows[-1] - fitted
        minus_twice += log_determinant + 2.0 * log_diagonal(factor[:latents])
        minus_twice += np.einsum("mw,mw->w", residual, residual)
        minus_twice += np.einsum("kw,kw->w", solution, solution)
        return -0.5 * minus_twice

    def solve(self, scales: CellScales) -> Eliminated:
        """Own deviations, effects and fixed columns' coefficients that fit best, and their law."""
        factor, explained, rows = self._regressed(self._noise(scales), scales)
        return Eliminated(factor, explained, _joint_precision(rows))

    def _noise(self, scales: CellScales) -> Block:
        """D, entries (C, W)."""
        if scales.trial is None:
            return scales.between
        return scales.between + scales.trial.scaled(1.0 / self._trials)

    def _minus_twice_of_contrasts(
        self,
        noise: Block,
        scales: CellScales,
    ) -> Array:
        """Log determinants and squares of the contrasts of subjects, summed over these: (W,)."""
        if not len(scales.effects):
            squares = noise.distance(tuple(self._triangles[..., None])).sum(axis=0)
            return np.asarray(squares + self._contrasts @ noise.log_determinant())
        covariance = SubjectCovariance(noise, scales.effects)
        squares = covariance.scatter_distance(self._pattern)
        return np.asarray(squares + self._contrasts[0] * covariance.log_determinant)

    def _rows_of_single_cells(
        self,
        noise: Block,
        scales: CellScales,
    ) -> tuple[Array, Array]:
        """Whitened columns (K + 1, P C, W), and log det of their noise (W,): a cell is a block."""
        variances = np.einsum("apc,aw->pcw", self._own**2, scales.tau**2)
        covariance = noise + Block(tuple(variances))
        rows = _whitened(covariance, scales.effects, self._fixed_and_mean)
        log_determinant = covariance.log_determinant().sum(axis=0)
        return rows.reshape(len(rows), -1, rows.shape[-1]), log_determinant

    def _regressed(
        self,
        noise: Block,
        scales: CellScales,
    ) -> tuple[Array, Array, Array]:
        """Columns A regressed on own deviations U with SDs T, environment by environment.

        Returned are F with FF' = T⁻² + U'U, (a, a, J, W); S = F⁻¹U'A, (a, K + 1, J, W); and with
        B = F'⁻¹S the rows of A - UB and T⁻¹B, (K + 1, (P L + a) J, W).
        """
        of_all_draws = np.concatenate([self._fixed_and_mean, self._own])
        whitened = self._by_environment(_whitened(noise, scales.effects, of_all_draws))
        other_count = len(whitened) - len(self._own)
        columns, own = np.split(whitened, [other_count])
        sd = scales.tau[:, None]
        precision = np.einsum("amjw,bmjw->abjw", own, own)
        factor = lower_factor(add_to_diagonal(precision, sd**-2.0))
        for_columns = factor[:, :, None]
        products = np.einsum("amjw,kmjw->akjw", own, columns)
        explained = solve_lower(for_columns, products)
        coefficients = solve_upper(for_columns, explained)
        unexplained = columns - np.einsum("amjw,akjw->kmjw", own, coefficients)
        over_sd = (coefficients / sd[:, None]).swapaxes(0, 1)
        rows = np.concatenate([unexplained, over_sd], axis=1)
        return factor, explained, rows.reshape(other_count, -1, rows.shape[-1])

    def _by_environment(self, columns: Array) -> Array:
        """Columns (k, P, C, W), the cells of each environment apart: (k, P L, J, W)."""
        no_cell = np.zeros_like(columns[:, :, :1])
        padded = np.concatenate([columns, no_cell], axis=2)
        apart = padded[:, :, self._cells_of_environment]
        count, quantities, most_cells, environments, width = apart.shape
        return apart.reshape(count, quantities * most_cells, environments, width)


def _whitened(
    covariance: Block,
    varying: Array,
    constant: Array,
) -> Array:
    """Columns (k, P, C, W), then columns (m, P, C) that all draws share: over unit noise."""
    count, quantities, cells, width = varying.shape
    rows = np.empty((count + len(constant), quantities, cells, width))
    # What is equal in all draws is not repeated for each.
    of_varying = covariance.whiten(tuple(varying.swapaxes(0, 1)))
    of_constant = covariance.whiten(tuple(constant[..., None].swapaxes(0, 1)))
    for p in range(quantities):
        rows[:count, p] = of_varying[p]
        rows[count:, p] = of_constant[p]
    return rows


def _joint_precision(rows: Array) -> Array:
    """Lower triangle of I + A'A for columns (K + 1, M, W), the data last: (K + 1, K + 1, W)."""
    count, _, width = rows.shape
    joint = np.zeros((count, count, width))
    for row in range(count):
        end = row + 1
        target = joint[row, :end]
        np.einsum("mw,kmw->kw", rows[row], rows[:end], out=target)
    return add_to_diagonal(joint, 1.0)


def _cells_of_environment(design: Design) -> Indices:
    """Cells of each environment, (L, J); C, which is no cell, where one has fewer than L."""
    environment = design.cells.environment
    environments = len(design.cells.environments)
    most_cells = np.bincount(environment).max()
    cells = np.full((most_cells, environments), len(environment))
    for j in range(environments):
        of_environment = np.flatnonzero(environment == j)
        cells[: len(of_environment), j] = of_environment
    return cells
