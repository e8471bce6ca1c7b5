"""Density of a linear design where all subjects have equal cells and trials: blocks by environment.

Given the scales, the cell means of one subject have the covariance V = D + ZZ' about the locations.
D is the noise, a small block for each cell, and Z are the q columns of the subject's effects. The N
subjects' scatter about their mean has N - 1 times this law. Their mean has the covariance

    D/N + ZZ'/N + KK' + XX'

K are the columns of the environments' own deviations, each within the cells of one environment, and
X the columns of the fixed terms. The last three parts are columns times standard normal latents.
The latents are integrated out in this order, with the data carried along as one more column:

1. Every column is whitened by D/N, cell by cell.
2. `absorb` integrates out the own deviations, environment by environment.
3. `orthogonal.factor` integrates out the few columns of Z and X that are left, over all cells.

Steps 2 and 3 are modified Gram-Schmidt, so no digits are lost at scales of any size. Arrays have P
quantities, C cells, J environments with L cells at most, W sets of scales, and f fixed columns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block
from percept.inference.hierarchy.cell_problem import columns_by_quantity
from percept.inference.hierarchy.cell_scales import CellScales
from percept.inference.hierarchy.design import Design
from percept.inference.hierarchy.orthogonal import factor
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_covariance import SubjectCovariance

__all__ = ["OnePattern", "absorb"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class OnePattern:
    """Density of the cell means of a study with one pattern of cells and trials.

    Parameters
    ----------
    statistics : Statistics
        With one pattern, which has all cells; its environments are the design's cells.
    design : Design
        The columns.
    """

    def __init__(self, statistics: Statistics, design: Design) -> None:
        (pattern,) = statistics.patterns
        size, cells = design.cells.x.shape
        self._subjects = pattern.subjects
        #: (C, 1) Trials of each cell.
        self._trials = pattern.trials[:, None]
        rows_first = pattern.rows.swapaxes(0, 1)
        rows = np.ascontiguousarray(rows_first)
        #: (n, P, C, 1) Rows whose products sum to the scatter between subjects.
        self._scatter_rows = rows[..., None]
        #: (o P, P, C) K without its SDs, over the cells of all environments at once.
        self._own = columns_by_quantity(design.deviation, size, cells)
        fixed = columns_by_quantity(design.fixed, size, cells)
        #: (f + 1, P, C) X, and the subjects' mean.
        mean = pattern.mean[None]
        self._fixed_and_mean = np.concatenate([fixed, mean])
        #: (L, J) Cells of each environment.
        self._cells_of_environment = _cells_of_environment(design)

    def log_density(self, scales: CellScales) -> Array:
        """Log density of all cell means, (W,), without powers of 2 pi and `Statistics.constant`.

        Numbers of subjects are in it: `CellProblem.constant` is not to be added.
        """
        noise = scales.between
        if scales.trial is not None:
            of_mean = scales.trial.scaled(1.0 / self._trials)
            noise = noise + of_mean
        minus_twice = self._of_mean(noise, scales)
        if self._subjects > 1:
            covariance = SubjectCovariance(noise, scales.effects)
            others = self._subjects - 1.0
            minus_twice += others * covariance.log_determinant()
            minus_twice += covariance.scatter_distance(self._scatter_rows)
        return -0.5 * minus_twice

    def _of_mean(self, noise: Block, scales: CellScales) -> Array:
        """Log determinant and squared distance of the subjects' mean, summed: (W,)."""
        noise_of_mean = noise.scaled(1.0 / self._subjects)
        columns = self._columns(scales)
        by_quantity = np.moveaxis(columns, 1, 0)
        whitened = noise_of_mean.whiten(tuple(by_quantity))
        columns_first = np.stack(whitened, axis=1)
        by_environment = self._by_environment(columns_first)
        own = len(self._own)
        rest, by_block = absorb(by_environment, own)
        count, _, _, width = rest.shape
        over_cells = rest.reshape(count, -1, width)
        mean = over_cells[-1]
        solved = factor(over_cells[:-1], mean)
        by_cell = noise_of_mean.log_determinant()
        of_noise = by_cell.sum(axis=0)
        of_own = by_block.sum(axis=0)
        of_rest = solved.log_determinant + solved.distance
        return np.asarray(of_noise + of_own + of_rest)

    def _columns(self, scales: CellScales) -> Array:
        """K, Z/√N, X and the subjects' mean, side by side: (o P + q + f + 1, P, C, W)."""
        width = scales.effects.shape[-1]
        count = len(self._own)
        sd = scales.tau.reshape(count, 1, 1, width)
        own = self._own[..., None] * sd
        root_subjects = np.sqrt(self._subjects)
        effects = scales.effects / root_subjects
        constant = self._fixed_and_mean[..., None]
        every_draw = (*self._fixed_and_mean.shape, width)
        fixed_and_mean = np.broadcast_to(constant, every_draw)
        return np.concatenate([own, effects, fixed_and_mean])

    def _by_environment(self, columns: Array) -> Array:
        """Columns (k, P, C, W), the cells of each environment apart: (k, P L, J, W)."""
        no_cell = np.zeros_like(columns[:, :, :1])
        padded = np.concatenate([columns, no_cell], axis=2)
        apart = padded[:, :, self._cells_of_environment]
        count, size, most, environments, width = apart.shape
        return apart.reshape(count, size * most, environments, width)


def _cells_of_environment(design: Design) -> Indices:
    """Cells of each environment, (L, J); C, which is no cell, where one has fewer than L."""
    environment = design.cells.environment
    number = len(design.cells.environments)
    counts = np.bincount(environment)
    most = counts.max()
    no_cell = len(environment)
    cells = np.full((most, number), no_cell)
    for j in range(number):
        of_environment = np.flatnonzero(environment == j)
        cells[: len(of_environment), j] = of_environment
    return cells


def absorb(columns: Array, count: int) -> tuple[Array, Array]:
    """Integrate out the standard normal coefficients of the first columns.

    Parameters
    ----------
    columns : ndarray
        Columns over M rows of unit noise, shape (k, M, ...).
    count : int
        How many of them are integrated out.

    Returns
    -------
    rest : ndarray
        The other columns over count + M rows, whose products are those weighed by the inverse of
        I + AA', A the first columns; shape (k - count, count + M, ...).
    log_determinant : ndarray
        Of I + AA', shape (...).
    """
    total, rows, *draws = columns.shape
    # Each coefficient's prior is one more row, in which its column has a one. These rows are
    # flipped, so that the nonzeros of each column are contiguous.
    work = np.zeros((total, count + rows, *draws))
    work[:, count:] = columns
    absorbed = np.arange(count)
    rows_of_priors = count - 1 - absorbed
    work[absorbed, rows_of_priors] = 1.0
    log_determinant = np.zeros(draws)
    for i in range(count):
        first_nonzero = count - 1 - i
        column = work[i, first_nonzero:]
        later = work[i + 1 :, first_nonzero:]
        square = np.einsum("m...,m...->...", column, column)
        log_determinant += np.log(square)
        products = np.einsum("m...,km...->k...", column, later)
        shares = products / square
        later -= shares[:, None] * column
    return work[count:], log_determinant
