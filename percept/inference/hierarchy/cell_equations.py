"""Normal equations of a linear design: own deviations, coefficients, and subjects' effects.

Subject i has the cell means m_i = A_i B xi + Z b_i + noise. A_i picks the cells of the subject, B
holds the columns of the design, and Z the columns of the subject's effects. The noise has the
covariance D, a small block for each cell. xi and b_i are standard normal a priori. With H = D⁻¹Z
their joint precision has these parts:

    xi by xi     I + sum_i B'A_i'D⁻¹A_i B
    xi by b_i    B'A_i'H
    b_i by b_i   I + Z'H
    data         B'A_i'D⁻¹m_i for xi, and H'm_i for b_i

The latents xi are the own deviations of the environments and, after them, the coefficients of fixed
terms and the slopes of covariates, called the rest. No cell has own deviations of two environments,
and no cell has effects of two subjects. These parts of the precision are zero and are not stored.

N subjects may share a pattern of cells and trials. Their effects then enter as u = √N b̄, with b̄
the mean effect. u has the unit prior of one subject's effects, and sum_i H b_i = √N H u.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block
from percept.inference.hierarchy.cell_problem import CellProblem, PatternScatter
from percept.inference.hierarchy.cell_scales import CellScales
from percept.inference.hierarchy.information import precision_entries
from percept.inference.hierarchy.small_cholesky import with_prior
from percept.inference.hierarchy.subject_covariance import SubjectCovariance
from percept.inference.hierarchy.trial_scatter import TrialScatter

__all__ = ["CellEquations"]

Array = NDArray[np.float64]


class CellEquations:
    """Parts of the joint precision of latents and subjects' effects, at W sets of scales.

    Attributes
    ----------
    deviations : ndarray
        Precision of the own deviations of each environment, without the prior's one, (a, a, J, W).
    deviations_by_rest : ndarray
        Own deviations by the rest, and last by the data, (a, J, r + 1, W).
    rest_and_data : ndarray
        The rest, and last the data, by the same, (r + 1, r + 1, W). The last row has no meaning.
    deviations_by_effects : ndarray
        Own deviations by the subjects' effects of each pattern, (a, J, q, G, W).
    rest_by_effects : ndarray
        The rest, and last the data, by the subjects' effects, (r + 1, q, G, W).
    effects : ndarray
        Precision of the subjects' effects with the prior's one, (q, q, G, W).
    """

    def __init__(
        self,
        problem: CellProblem,
        scales: CellScales,
    ) -> None:
        self.problem = problem
        self.trial = scales.trial
        self.effect_columns = scales.effects  # (q, P, C, W) Z
        self.deviation_sd = problem.own_sd(scales.tau)  # (a, W)
        self._width = scales.effects.shape[-1]
        #: (C, G, W) D, of any value where a pattern has no cell.
        self.noise = self._cell_noise(scales.between)
        #: (C, G, W) D⁻¹, zero where a pattern has no cell.
        present = problem.present[..., None]
        self.precision = self.noise.inverse().scaled(present)
        self._set_effects()
        self._set_latents_by_effects()
        self._set_latents()
        if problem.slopes:
            self._add_slopes()

    def _cell_noise(self, between: Block) -> Block:
        """D: the covariance between subjects, and that of the mean of a cell's trials."""
        problem = self.problem
        noise = between[:, None]
        if self.trial is not None:
            per_trial = self.trial[problem.trial_group]
            share = 1.0 / problem.trials
            noise = noise + per_trial.scaled(share[..., None])
        grid = (*problem.present.shape, self._width)
        return noise.mapped(lambda part: np.broadcast_to(part, grid))

    def _set_effects(self) -> None:
        """Store H = D⁻¹Z, and the precision I + Z'H of the effects of each pattern."""
        # (P, C, q, W), so that products with columns of cells are products of matrices.
        effects_third = self.effect_columns.transpose(1, 2, 0, 3)
        columns = np.ascontiguousarray(effects_third)
        for_effects = self.precision.mapped(lambda part: part[:, None])
        for_patterns = columns[:, :, :, None]
        weighted = for_effects.apply(tuple(for_patterns))
        self.weighted_effects = np.stack(weighted)  # (P, C, q, G, W) H
        products = np.einsum("pcaw,pcbgw->abgw", columns, self.weighted_effects)
        self.effects = with_prior(products)

    def _set_latents_by_effects(self) -> None:
        """Store the products √N B'H of the latents, and √N m'H of the data."""
        problem = self.problem
        weighted = self.weighted_effects
        effect_shape = weighted.shape[2:]
        count = problem.size * problem.cells
        by_cell = weighted.reshape(count, -1)
        # A product with b_i is √N times one with u = √N b̄, once summed over N subjects.
        root_subjects = np.sqrt(problem.subjects)
        of_pattern = root_subjects[:, None]
        basis_by_effects = problem.sparse_basis @ by_cell
        basis_by_effects = basis_by_effects.reshape(-1, *effect_shape)
        basis_by_effects *= of_pattern
        own = basis_by_effects[: problem.deviations]
        deviations = self._by_environment(own)
        sd = self.deviation_sd[:, None, None, None]
        self.deviations_by_effects = deviations * sd
        fixed = basis_by_effects[problem.deviations :]
        slopes = np.einsum("pcqgw,mcg->mpqgw", weighted, problem.covariate_mean)
        slopes = slopes.reshape(-1, *effect_shape)
        slopes *= problem.covariate_sd
        data = np.einsum("pcqgw,pcg->qgw", weighted, problem.mean)
        slopes_and_data = np.concatenate([slopes, data[None]])
        slopes_and_data *= of_pattern
        self.rest_by_effects = np.concatenate([fixed, slopes_and_data])

    def _set_latents(self) -> None:
        """Store the products B'D⁻¹B of the latents, and B'D⁻¹m of the data."""
        problem = self.problem
        width = self._width
        own_columns = problem.own_columns
        fixed_columns = problem.fixed_columns
        environments = problem.environments
        #: (P, P, C, G, W) D⁻¹.
        self._entries = precision_entries(self.precision)
        over_subjects = np.einsum("pqcgw,g->pqcw", self._entries, problem.subjects)
        by_cell = over_subjects.reshape(-1, width)
        weighted_mean = problem.mean * problem.subjects
        data = np.einsum("pqcgw,qcg->pcw", self._entries, weighted_mean)
        data_by_cell = data.reshape(-1, width)
        basis_by_data = problem.sparse_basis @ data_by_cell

        sd = self.deviation_sd[:, None]
        own_products = problem.own_products @ by_cell
        own_products = own_products.reshape(own_columns, own_columns, environments, width)
        products_of_sd = sd[:, None] * sd
        self.deviations = own_products * products_of_sd

        rest_and_data = fixed_columns + problem.slopes + 1
        mixed_products = problem.mixed_products @ by_cell
        mixed_products = mixed_products.reshape(own_columns, fixed_columns, environments, width)
        by_rest = np.zeros((own_columns, environments, rest_and_data, width))
        by_rest[:, :, :fixed_columns] = mixed_products.swapaxes(1, 2)
        own_by_data = basis_by_data[: problem.deviations]
        by_rest[:, :, -1] = self._by_environment(own_by_data)
        self.deviations_by_rest = by_rest * sd[:, None]

        fixed_products = problem.fixed_products @ by_cell
        fixed_products = fixed_products.reshape(fixed_columns, fixed_columns, width)
        self.rest_and_data = np.zeros((rest_and_data, rest_and_data, width))
        fixed = slice(fixed_columns)
        self.rest_and_data[fixed, fixed] = fixed_products
        self.rest_and_data[fixed, -1] = basis_by_data[problem.deviations :]

    def _add_slopes(self) -> None:
        """Add the products of the slopes of covariates with the latents and the data."""
        problem = self.problem
        sd = problem.covariate_sd
        basis_by_slopes = sd * self._basis_by_slopes()
        own = basis_by_slopes[: problem.deviations]
        deviations = self._by_environment(own)
        slopes = slice(problem.fixed_columns, -1)
        deviation_sd = self.deviation_sd[:, None, None]
        self.deviations_by_rest[:, :, slopes] = deviations * deviation_sd
        fixed = slice(problem.fixed_columns)
        fixed_by_slopes = basis_by_slopes[problem.deviations :]
        self.rest_and_data[fixed, slopes] = fixed_by_slopes
        self.rest_and_data[slopes, fixed] = fixed_by_slopes.swapaxes(0, 1)

        products = _slopes_of_means(problem, self._entries)
        if self.trial is not None:
            of_trials = _slopes_of_trials(problem.trial_scatter, self.trial)
            products = products.plus(of_trials)
        covariances = self.covariances()
        for scatter, covariance in zip(problem.scatter, covariances, strict=True):
            cells = self.precision[scatter.cells, scatter.pattern]
            of_scatter = _slopes_of_scatter(scatter, covariance, cells)
            products = products.plus(of_scatter)
        information = sd * sd * products.information
        self.rest_and_data[slopes, slopes] = information
        self.rest_and_data[slopes, -1] = sd * products.by_data

    def _basis_by_slopes(self) -> Array:
        """Products B'D⁻¹x of the columns of cells and the covariates' means, (Q, M P, W)."""
        problem = self.problem
        weighted = problem.covariate_mean * problem.subjects
        # (P, C, M, P, W): the last P is the quantity of the slope.
        by_cell = np.einsum("pqcgw,mcg->pcmqw", self._entries, weighted)
        count = problem.size * problem.cells
        flat = by_cell.reshape(count, -1)
        products = problem.sparse_basis @ flat
        by_slope = products.reshape(-1, problem.slopes, self._width)
        return np.asarray(by_slope)

    def _by_environment(self, rows: Array) -> Array:
        """Rows of own deviations (a J, ...), by column and environment (a, J, ...)."""
        problem = self.problem
        counts = (problem.own_columns, problem.environments)
        return rows.reshape(*counts, *rows.shape[1:])

    def covariances(self) -> list[SubjectCovariance]:
        """Covariance of the subjects of each pattern with scatter."""
        covariances = []
        for scatter in self.problem.scatter:
            noise = self.noise[scatter.cells, scatter.pattern]
            effects = self.effect_columns[:, :, scatter.cells]
            covariances.append(SubjectCovariance(noise, effects))
        return covariances


@dataclasses.dataclass(frozen=True, eq=False)
class _SlopeProducts:
    """Products of the slopes of covariates over their prior SD, at W sets of scales."""

    information: Array  # (M P, M P, W) With one another
    by_data: Array  # (M P, W) With the data

    @classmethod
    def in_one_row(cls, information: Array, by_data: Array) -> _SlopeProducts:
        """Slopes in one row, from products (M, P, M, P, W) and (M, P, W)."""
        covariates, size, width = by_data.shape
        slopes = covariates * size
        return cls(
            information=information.reshape(slopes, slopes, width),
            by_data=by_data.reshape(slopes, width),
        )

    def plus(self, other: _SlopeProducts) -> _SlopeProducts:
        """Sum of two independent sources of information."""
        information = self.information + other.information
        return _SlopeProducts(information, self.by_data + other.by_data)


def _slopes_of_means(problem: CellProblem, entries: Array) -> _SlopeProducts:
    """Products by the precisions (P, P, C, G, W) of the patterns' mean responses."""
    covariates = problem.covariate_mean
    weighted = covariates * problem.subjects
    information = np.einsum("pqcgw,mcg,ncg->mpnqw", entries, covariates, weighted)
    by_data = np.einsum("pqcgw,mcg,qcg->mpw", entries, weighted, problem.mean)
    return _SlopeProducts.in_one_row(information, by_data)


def _slopes_of_trials(scatter: TrialScatter, trial: Block) -> _SlopeProducts:
    """Products by the precisions of trials about the mean of their cell."""
    rows = scatter.covariate_rows
    entries = precision_entries(trial.inverse())  # (P, P, T, W)
    squares = np.einsum("lmt,lnt->mnt", rows, rows)
    responses = np.einsum("lmt,lqt->mqt", rows, scatter.response_rows)
    information = np.einsum("mnt,pqtw->mpnqw", squares, entries)
    by_data = np.einsum("mqt,pqtw->mpw", responses, entries)
    return _SlopeProducts.in_one_row(information, by_data)


def _slopes_of_scatter(
    scatter: PatternScatter,
    covariance: SubjectCovariance,
    precision: Block,
) -> _SlopeProducts:
    """Products by the inverse of V = D + ZZ' of subjects about the mean of their pattern.

    With LL' = I + Z'H the inverse is V⁻¹ = D⁻¹ - (L⁻¹H')'(L⁻¹H').
    """
    data = scatter.rows[None]
    rows = np.concatenate([scatter.slopes, data])  # (k, n, P, E)
    count, subjects, *of_cells = rows.shape
    entries = precision_entries(precision)  # (P, P, E, W)
    width = entries.shape[-1]
    squares = np.einsum("anpe,bnqe->abpqe", rows, rows)
    flat_squares = squares.reshape(count * count, -1)
    flat_entries = entries.reshape(-1, width)
    by_noise = flat_squares @ flat_entries
    by_noise = by_noise.reshape(count, count, width)
    flat = rows.reshape(-1, *of_cells)
    whitened = covariance.whitened_effects(flat)  # (q, k n, W)
    whitened = whitened.reshape(-1, count, subjects, width)
    explained_by_effects = np.einsum("qanw,qbnw->abw", whitened, whitened)
    products = by_noise - explained_by_effects
    slopes = products[:-1]
    return _SlopeProducts(
        information=slopes[:, :-1],
        by_data=slopes[:, -1],
    )
