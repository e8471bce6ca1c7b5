"""Density of a linear design where all subjects have equal cells and trials: blocks by environment.

Given the scales, the cell means of one subject have the covariance V = D + ZZ', with D a small
block per cell and Z the columns of the subject's effects. Their mean over N subjects has the
covariance

    (D + ZZ')/N + K + XX'

where K holds the environments' own deviations, within blocks of an environment, and X the columns
of the fixed terms. D is whitened cell by cell, K is absorbed environment by environment, and the
few columns of Z and X are left to one regression. Everything is done by modified Gram-Schmidt with
the data carried along, so no digits are lost at scales of any size.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector
from percept.inference.hierarchy.design import Design
from percept.inference.hierarchy.regression import factor
from percept.inference.hierarchy.small_cholesky import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
    with_prior,
)
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["CellScales", "OnePattern", "SubjectCovariance", "absorb"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class CellScales:
    """What the locations depend on, for W draws."""

    between: Block  # (C, W) Covariance between subjects within a cell
    trial: Block | None  # (T, W) Covariance between trials, of each group of their scatter
    effects: Array  # (q, P, C, W) Columns Z of the subjects' effects
    tau: Array  # (o, P, W) SDs of the environments' own deviations, one for each column

    def at(self, draws: NDArray[np.intp]) -> CellScales:
        """Scales of some of the draws."""
        return CellScales(
            between=self.between[..., draws],
            trial=None if self.trial is None else self.trial[..., draws],
            effects=self.effects[..., draws],
            tau=self.tau[..., draws],
        )


class SubjectCovariance:
    """V = D + ZZ' over the cells of a subject, never formed.

    Parameters
    ----------
    noise : Block
        D, entries (E, W).
    effects : ndarray
        Z, shape (q, P, E, W).
    """

    def __init__(self, noise: Block, effects: Array) -> None:
        self._noise = noise
        self._effects = effects
        by_quantity = np.moveaxis(effects, 1, 0)
        precision = noise.inverse()
        weighted = precision.apply(tuple(by_quantity))
        self._weighted_effects = np.stack(weighted, axis=1)  # (q, P, E, W) H = D⁻¹Z
        products = np.einsum("apew,bpew->abw", effects, self._weighted_effects)
        #: (q, q, W) L of LL' = I + Z'H.
        self._factor = lower_factor(with_prior(products))
        #: (q, q, 1, W) The same for several rows.
        self._factor_of_rows = self._factor[:, :, None]

    def log_determinant(self) -> Array:
        """Return log det V, shape (W,)."""
        of_cells = self._noise.log_determinant()
        of_effects = 2.0 * log_diagonal(self._factor)
        return of_cells.sum(axis=0) + of_effects

    def whitened_effects(self, rows: Array) -> Array:
        """L⁻¹H'r of constant rows r (n, P, E), where LL' = I + Z'H: shape (q, n, W)."""
        effects, *_, width = self._weighted_effects.shape
        by_cell = self._weighted_effects.reshape(effects, -1, width)
        flat_rows = rows.reshape(len(rows), -1)
        products = flat_rows @ by_cell
        return solve_lower(self._factor_of_rows, products)

    def scatter_distance(self, rows: Array) -> Array:
        """Sum of r'V⁻¹r over rows (n, P, E, W or 1), as squares: shape (W,).

        With b the subject's effect that fits r best, r'V⁻¹r is the distance of r - Zb by D, plus
        b'b.
        """
        width = self._weighted_effects.shape[-1]
        if rows.shape[-1] == 1:
            whitened = self.whitened_effects(rows[..., 0])
        else:
            whitened = self._whitened_draws(rows)
        effect = solve_upper(self._factor_of_rows, whitened)  # (q, n, W)
        every_draw = (*rows.shape[:-1], width)
        repeated = np.broadcast_to(rows, every_draw)
        unexplained = self._unexplained(repeated, effect)
        by_cell = self._noise.distance(unexplained)
        of_effects = np.einsum("qnw,qnw->w", effect, effect)
        return np.asarray(by_cell.sum(axis=0) + of_effects)

    def draw_effects(self, rows: Array, rng: np.random.Generator) -> Array:
        """Draw subjects' effects (q, n, W) given rows r (n, P, E, W), cell means less locations.

        The effects are standard normal before any data, so that given r their mean is L'⁻¹L⁻¹H'r
        and their covariance L'⁻¹L⁻¹.
        """
        whitened = self._whitened_draws(rows)
        normals = rng.standard_normal(whitened.shape)
        return solve_upper(self._factor_of_rows, whitened + normals)

    def _whitened_draws(self, rows: Array) -> Array:
        """L⁻¹H'r of rows r (n, P, E, W) that differ between draws: shape (q, n, W)."""
        weighted = np.einsum("npew,qpew->qnw", rows, self._weighted_effects)
        return solve_lower(self._factor_of_rows, weighted)

    def _unexplained(self, rows: Array, effect: Array) -> Vector:
        """Rows (n, P, E, W) less what the subject's effect (q, n, W) explains."""
        unexplained = []
        for p in range(rows.shape[1]):
            residual = np.array(rows[:, p])
            for column, multiple in zip(self._effects[:, p], effect, strict=True):
                residual -= column * multiple[:, None]
            unexplained.append(residual)
        return tuple(unexplained)

    def whiten(self, r: Vector) -> list[Vector]:
        """Split vectors (n, E, W) into pieces whose squares sum to r'V⁻¹r."""
        rows = np.stack(r, axis=1)
        whitened = self._whitened_draws(rows)
        effect = solve_upper(self._factor_of_rows, whitened)
        unexplained = self._unexplained(rows, effect)
        return [self._noise.whiten(unexplained), tuple(effect)]


class OnePattern:
    """Density of the cell means of a study with one pattern of cells and trials.

    Parameters
    ----------
    statistics : Statistics
        With one pattern; its environments are the design's cells.
    design : Design
        The columns.
    """

    def __init__(self, statistics: Statistics, design: Design) -> None:
        (pattern,) = statistics.patterns
        self._subjects = pattern.subjects
        self._trials = pattern.trials[:, None]
        #: (n, P, C, 1) Rows of scatter between subjects
        subjects_first = pattern.rows.transpose(1, 0, 2)
        self._rows = np.ascontiguousarray(subjects_first)[..., None]
        size, cells = design.cells.x.shape
        self._own: Array | None = None
        if design.own:
            columns = [term.columns for term in design.own]
            self._own = np.concatenate(columns)
        fixed = []
        for term in design.fixed:
            for column in term.columns:
                for p in range(size):
                    alone = np.zeros((size, cells))
                    alone[p] = column[p]
                    fixed.append(alone)
        #: (f + 1, P, C) Columns of the fixed terms, and the means.
        self._constant = np.stack([*fixed, pattern.mean])
        environment = design.cells.environment
        number = len(design.cells.environments)
        most = int(np.bincount(environment).max())
        #: (L, J) Cells of each environment; one more than there are where it has fewer.
        self._cells = np.full((most, number), cells)
        for j in range(number):
            there = np.flatnonzero(environment == j)
            self._cells[: len(there), j] = there

    def log_density(self, scales: CellScales) -> Array:
        """Log density of all cell means, (W,), but for powers of 2 pi and counts."""
        noise = scales.between
        if scales.trial is not None:
            of_mean = scales.trial.scaled(1.0 / self._trials)
            noise = noise + of_mean
        noise_of_means = noise.scaled(1.0 / self._subjects)
        value = self._of_means(noise_of_means, scales)
        if self._subjects > 1:
            covariance = SubjectCovariance(noise, scales.effects)
            others = self._subjects - 1.0
            value += others * covariance.log_determinant()
            value += covariance.scatter_distance(self._rows)
        return -0.5 * value

    def _of_means(self, noise: Block, scales: CellScales) -> Array:
        """Log determinant and distance of the subjects' mean, of noise with covariance `noise`."""
        width = scales.effects.shape[-1]
        every_draw = (*self._constant.shape, width)
        constant = np.broadcast_to(self._constant[..., None], every_draw)
        columns = [scales.effects / np.sqrt(self._subjects), constant]
        size = self._constant.shape[1]
        own = 0
        if self._own is not None:
            own = len(self._own) * size
            columns.insert(0, self._own_columns(scales.tau))
        all_columns = np.concatenate(columns)
        by_quantity = np.moveaxis(all_columns, 1, 0)
        whitened = noise.whiten(tuple(by_quantity))
        rows = np.stack(whitened, axis=1)  # (columns, P, C, W)
        no_cell = np.zeros_like(rows[:, :, :1])
        padded = np.concatenate([rows, no_cell], axis=2)
        count = len(rows)
        environments = self._cells.shape[1]
        by_environment = padded[:, :, self._cells]
        by_environment = by_environment.reshape(count, -1, environments, width)
        by_cell = noise.log_determinant()
        determinant = by_cell.sum(axis=0)
        if own:
            absorbed, by_block = absorb(by_environment, own)
            determinant = determinant + by_block.sum(axis=0)
            by_environment = absorbed
        flat = by_environment.reshape(len(by_environment), -1, width)
        means = flat[-1]
        solved = factor(flat[:-1], means)
        of_columns = solved.log_determinant + solved.distance
        return np.asarray(determinant + of_columns)

    def _own_columns(self, tau: Array) -> Array:
        """Columns of the environments' own deviations, (o P, P, C, W)."""
        assert self._own is not None
        count, size, cells = self._own.shape
        width = tau.shape[-1]
        columns = np.zeros((count, size, size, cells, width))
        for p in range(size):
            of_cells = self._own[:, p, :, None]
            columns[:, p, p] = of_cells * tau[:, p, None]
        return columns.reshape(count * size, size, cells, -1)


def absorb(columns: Array, count: int) -> tuple[Array, Array]:
    """Integrate out the standard normal coefficients of the first columns.

    Parameters
    ----------
    columns : ndarray
        Columns over M rows of unit noise, shape (q, M, ...).
    count : int
        How many of them are integrated out.

    Returns
    -------
    rest : ndarray
        The other columns over count + M rows, whose products are those weighed by the inverse of
        I + AA', A the first columns; shape (q - count, count + M, ...).
    log_determinant : ndarray
        Of I + AA', shape (...).
    """
    total, rows, *draws = columns.shape
    work = np.zeros((total, count + rows, *draws))
    work[:, count:] = columns
    # The identity is flipped so that each column's nonzeros are contiguous.
    first = np.arange(count)
    work[first, count - 1 - first] = 1.0
    log_determinant = np.zeros(draws)
    for i in range(count):
        start = count - 1 - i
        column = work[i, start:]
        later = work[i + 1 :, start:]
        square = np.einsum("m...,m...->...", column, column)
        log_determinant += np.log(square)
        products = np.einsum("m...,km...->k...", column, later)
        shares = products / square
        later -= shares[:, None] * column
    return work[count:], log_determinant
