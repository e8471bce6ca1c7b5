"""Normal equations of a linear design: own deviations, coefficients, and subjects' effects.

Subject i has the cell means m_i = A_i B xi + Z b_i + noise. A_i picks the cells of the subject, B
holds the columns of the design, and Z the columns of the subject's effects. The noise has the
covariance D, a small block for each cell. xi and b_i are standard normal a priori. With H = D⁻¹Z
their joint precision has these parts:

    xi by xi     I + sum_i B'A_i'D⁻¹A_i B
    xi by b_i    B'A_i'H
    b_i by b_i   I + Z'H = LL'

and the right side is sum_i B'A_i'D⁻¹m_i for xi, and H'm_i for b_i. Both are kept in three groups:

    deviations   the environments' own: the first entries of xi, a for each of J environments
    rest         the other entries of xi, f coefficients of fixed terms and then the slopes of
                 covariates; and last the right side, as if the data were one more entry: r + 1
    effects      the subjects' effects, q for each of G patterns

The data stand last because an elimination then carries them along. No cell has own deviations of
two environments, and no subject's cell mean has effects of another. These parts of the precision
are zero and are not stored.

N subjects may share a pattern of cells and trials. Their effects enter whitened, as u = √N L'b̄,
with b̄ the mean effect. The precision of u is one, and its product with xi is √N B'H L'⁻¹.

The columns of fixed terms in `CellProblem` hold their prior SDs. The SDs of own deviations and
slopes enter here. Shapes end with W sets of scales; P are the quantities and C the cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import precision_entries, precision_parts
from percept.inference.model.cell_problem import CellProblem
from percept.inference.model.cell_scales import CellScales
from percept.inference.model.slope_products import slope_products
from percept.inference.model.small_cholesky import solve_lower
from percept.inference.model.subject_equations import SubjectEquations

__all__ = ["CellEquations"]

Array = NDArray[np.float64]


class CellEquations:
    """Parts of the joint precision of latents and subjects' effects, at W sets of scales.

    Attributes
    ----------
    problem : CellProblem
        What data and design say before any scale is known.
    subject : SubjectEquations
        Noise and effects of one subject of each pattern, with the effects' own precision.
    deviation_sd : ndarray
        SD of the own deviations of each column, (a, W).
    deviations : ndarray
        Deviations of an environment by each other, without the prior's one, (a, a, J, W).
    deviations_by_rest : ndarray
        Shape (a, J, r + 1, W).
    rest : ndarray
        The rest by itself, without the prior's one, (r + 1, r + 1, W). The last row has no meaning.
    effects_by_latents : ndarray
        Whitened effects by own deviations, the rest and the data, (q, a J + r + 1, G, W).
    """

    def __init__(self, problem: CellProblem, scales: CellScales) -> None:
        self.problem = problem
        self.subject = SubjectEquations(problem, scales)
        self.deviation_sd = problem.own_sd(scales.tau)
        #: W
        self._width = scales.effects.shape[-1]
        #: r + 1: fixed terms, slopes and the data.
        self._rest = problem.fixed_columns + problem.slopes + 1
        #: Where the coefficients of fixed terms stand in the rest.
        self._fixed = slice(problem.fixed_columns)
        #: Where the slopes of covariates stand in it.
        self._slopes = slice(problem.fixed_columns, -1)
        self._set_products_with_effects()
        self._set_products_of_latents()
        if problem.slopes:
            self._add_products_with_slopes()
            self._add_products_of_slopes(scales)

    def _set_products_with_effects(self) -> None:
        """Store √N L⁻¹H'B for the latents, and √N L⁻¹H'm for the data."""
        problem = self.problem
        root_subjects = np.sqrt(problem.subjects)
        factor = self.subject.effect_factor / root_subjects[:, None]
        for_cells = factor[:, :, None, None]
        whitened = solve_lower(for_cells, self.subject.weighted_effects)  # (q, P, C, G, W)
        effects, _, _, patterns, _ = whitened.shape
        cell_latents = problem.deviations + problem.fixed_columns
        count = cell_latents + problem.slopes + 1
        products = np.empty((effects, count, patterns, self._width))
        for of_effect, cells in zip(products, whitened, strict=True):
            by_latent = problem.sparse_basis @ self._flat_cells(cells)
            of_effect[:cell_latents] = by_latent.reshape(-1, patterns, self._width)
        sd = np.repeat(self.deviation_sd, problem.environments, axis=0)
        products[:, : problem.deviations] *= sd[:, None]
        if problem.slopes:
            slopes = np.einsum("qpcgw,mcg->qmpgw", whitened, problem.covariate_mean)
            by_slope = slopes.reshape(effects, problem.slopes, patterns, self._width)
            products[:, cell_latents:-1] = problem.covariate_sd * by_slope
        products[:, -1] = np.einsum("qpcgw,pcg->qgw", whitened, problem.mean)
        self.effects_by_latents = products

    def _set_products_of_latents(self) -> None:
        """Store B'D⁻¹B for the latents but slopes, and B'D⁻¹m for the data.

        Columns of slopes are left at zero, to be added.
        """
        problem = self.problem
        precision = self._precision_of_cells()
        sum_of_means = problem.mean * problem.subjects
        weighted = self.subject.precision.apply(tuple(sum_of_means[..., None]))
        data = np.stack([part.sum(axis=1) for part in weighted])  # (P, C, W)
        by_data = problem.sparse_basis @ self._flat_cells(data)  # B'D⁻¹m, (a J + f, W)
        self.deviations = self._deviations_by_each_other(precision)
        self.deviations_by_rest = self._deviations_by_rest(precision, by_data[: problem.deviations])
        self.rest = self._rest_by_itself(precision, by_data[problem.deviations :])

    def _precision_of_cells(self) -> Array:
        """D⁻¹ summed over subjects, (P P C, W)."""
        problem = self.problem
        by_pattern = self.subject.precision
        parts = precision_parts(by_pattern)
        sums = [np.einsum("cgw,g->cw", part, problem.subjects) for part in parts]
        if len(sums) == 1:
            return sums[0]
        first, cross, second = sums
        return np.concatenate([first, cross, cross, second])

    def _deviations_by_each_other(self, precision: Array) -> Array:
        """Return own deviations of an environment by each other, (a, a, J, W)."""
        problem = self.problem
        shape = (problem.own_columns, problem.own_columns, problem.environments, self._width)
        products = problem.own_products @ precision
        sd = self.deviation_sd[:, None]
        sd_products = sd[:, None] * sd
        return np.asarray(products.reshape(shape) * sd_products)

    def _deviations_by_rest(self, precision: Array, by_data: Array) -> Array:
        """Return own deviations by fixed terms, slopes (zero) and data: (a, J, r + 1, W)."""
        problem = self.problem
        own = problem.own_columns
        shape = (own, problem.fixed_columns, problem.environments, self._width)
        products = (problem.mixed_products @ precision).reshape(shape)
        by_environment = products.swapaxes(1, 2)  # (a, J, f, W)
        by_rest = np.zeros((own, problem.environments, self._rest, self._width))
        by_rest[:, :, self._fixed] = by_environment * self.deviation_sd[:, None, None]
        by_rest[:, :, -1] = self._of_deviations(by_data)
        return by_rest

    def _rest_by_itself(self, precision: Array, by_data: Array) -> Array:
        """Return fixed terms by themselves and by the data, slopes zero: (r + 1, r + 1, W)."""
        fixed = self.problem.fixed_columns
        products = self.problem.fixed_products @ precision
        rest = np.zeros((self._rest, self._rest, self._width))
        rest[self._fixed, self._fixed] = products.reshape(fixed, fixed, self._width)
        rest[self._fixed, -1] = by_data
        return rest

    def _add_products_with_slopes(self) -> None:
        """Add B'D⁻¹x for own deviations and fixed terms, with x the values of the covariates."""
        problem = self.problem
        sum_of_values = problem.covariate_mean * problem.subjects
        precision = precision_entries(self.subject.precision)
        # (P, C, M, P, W): M covariates, and the last P is the quantity of the slope.
        weighted = np.einsum("pqcgw,mcg->pcmqw", precision, sum_of_values)
        by_cell = self._flat_cells(weighted)
        products = problem.sparse_basis @ by_cell
        products = products.reshape(-1, problem.slopes, self._width)
        products *= problem.covariate_sd
        own = products[: problem.deviations]
        fixed = products[problem.deviations :]
        self.deviations_by_rest[:, :, self._slopes] = self._of_deviations(own)
        self.rest[self._fixed, self._slopes] = fixed
        self.rest[self._slopes, self._fixed] = fixed.swapaxes(0, 1)

    def _add_products_of_slopes(self, scales: CellScales) -> None:
        """Add the products of slopes with one another and with the data."""
        products = slope_products(self.problem, self.subject, scales.trial)
        sd = self.problem.covariate_sd
        information = sd * sd * products.by_slopes
        self.rest[self._slopes, self._slopes] = information
        self.rest[self._slopes, -1] = sd * products.by_data

    def _flat_cells(self, values: Array) -> Array:
        """Values (P, C, ...) as a matrix (P C, ...) that columns of cells can multiply."""
        problem = self.problem
        count = problem.size * problem.cells
        return values.reshape(count, -1)

    def _of_deviations(self, products: Array) -> Array:
        """Products with own columns (a J, ..., W) times the SDs, by environment: (a, J, ..., W)."""
        problem = self.problem
        counts = (problem.own_columns, problem.environments)
        by_environment = products.reshape(*counts, *products.shape[1:])
        between = [1] * (products.ndim - 1)
        sd = self.deviation_sd.reshape(-1, *between, self._width)
        return by_environment * sd
