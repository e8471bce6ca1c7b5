"""Locations by their information: the form for studies of several patterns of counts.

`information_equations` sets up the precision of the latents, which Cholesky factors. Cost follows
subjects times environments, and trials never. The difference in the information of a subject loses
digits where the subject effect dwarfs the rest or a correlation nears one. The pivots of the factor
tell how many: draws that lose more than `LEAST_PIVOT` allows are left to the orthogonal form.

With V_i the covariance of subject i's cell means m_i, the log density of all means is

    constant - (log det(factor factor') + sum_i log det V_i + distance) / 2

where log det V_i is that of its cells, plus log det Sigma_u less log det T_i of its effect. The
distance is latents'latents + sum_i (m_i - beta)'V_i⁻¹(m_i - beta) at the best latents: sums of
squares about weighted means, which lose no digits. Shapes are as `information_equations` says.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, gram
from percept.inference.hierarchy.information_equations import normal_equations
from percept.inference.hierarchy.information_problem import InformationProblem
from percept.inference.hierarchy.scales import Scales
from percept.inference.hierarchy.shared_covariance import weighted_mean
from percept.inference.hierarchy.stacked_cholesky import (
    stacked_factor,
    stacked_solve_lower,
    stacked_solve_upper,
)

__all__ = [
    "LEAST_PIVOT",
    "Information",
]

Array = NDArray[np.float64]
#: Least part of a pivot that subtraction may leave: log determinants then err by 1e-8 at the most.
LEAST_PIVOT = 1e-7


class Information:
    """Locations at W sets of scales: density of the cell means, and on demand the law of beta.

    Parameters
    ----------
    problem : InformationProblem
        Cells, patterns and kinds of cells.
    scales : Scales
        Scales with SDs tau of the environments' deviations.
    kinds : Block
        Covariance of the mean of a cell of each kind, entries (K, W).
    """

    def __init__(self, problem: InformationProblem, scales: Scales, kinds: Block) -> None:
        assert scales.tau is not None
        self._problem = problem
        self._tau = _tau_of_locations(scales.tau, problem.environments)
        #: Covariance of each cell's mean about the subject's effect, entries (J, G, W).
        self._cells = _padded(kinds)[problem.kind_of_cell]
        self._precisions = self._cells.inverse()
        self._precision = self._precisions.total()  # entries (G, W)
        #: Covariance of the weighted mean of a subject's cells; None without subjects' effects.
        self._mean_covariance: Block | None = None
        effect_covariance: Block | None = None
        if scales.shared is not None:
            self._mean_covariance = scales.shared + self._precision.inverse()
            effect_precision = scales.shared.inverse() + self._precision
            effect_covariance = effect_precision.inverse()  # T
        equations = normal_equations(problem, self._tau, kinds, effect_covariance)
        self._factor = stacked_factor(equations.matrix)
        pivots = np.einsum("wii->wi", self._factor)
        least = LEAST_PIVOT * equations.full_diagonal
        kept = pivots * pivots >= least
        #: (W,) Whether enough digits are left.
        self.sound = kept.all(axis=1)
        whitened = stacked_solve_lower(self._factor, equations.right)
        self._latents = stacked_solve_upper(self._factor, whitened)
        self.mean: Vector = tuple(self._of_latents(self._latents))
        determinants = problem.subjects_of_kind @ kinds.log_determinant()
        if scales.shared is not None and effect_covariance is not None:
            prior = scales.shared.log_determinant()
            of_effects = prior - effect_covariance.log_determinant()
            determinants = determinants + problem.subjects @ of_effects
        latent_squares = np.einsum("wq,wq->w", self._latents, self._latents)
        distance = latent_squares + self._distance()
        log_pivots = np.log(pivots).sum(axis=1)
        subtracted = 0.5 * (determinants + distance)
        self.log_density = problem.constant - subtracted - log_pivots

    def _of_latents(self, latents: Array) -> Array:
        """Locations (P, J, W) of latents (W, Q)."""
        problem = self._problem
        locations = self._tau.shape[1]
        deviations = self._tau * latents[:, :locations]
        beta = deviations + latents[:, locations:] @ self._problem.trend
        by_location = beta.T
        shape = (problem.quantities, problem.environments, len(latents))
        return np.asarray(by_location.reshape(shape))

    def _distance(self) -> Array:
        """Sum of squares of means about the locations, and of scatter within patterns, whitened."""
        problem = self._problem
        residuals = []
        for p, beta in enumerate(self.mean):
            off_centre = problem.centre[p][:, None] - beta
            residual = problem.mean[p][..., None] + off_centre[:, None]
            residuals.append(residual)
        distance = problem.subjects @ self._squares(tuple(residuals), slice(None))
        if problem.row_pattern.size:
            rows = tuple(problem.rows[..., None])
            distance = distance + self._squares(rows, problem.row_pattern).sum(axis=0)
        return distance

    def _squares(
        self,
        residuals: Vector,
        patterns: NDArray[np.intp] | slice,
    ) -> Array:
        """r'V_g⁻¹r of vectors (J, R, W) or (J, R, 1), each of its pattern g: shape (R, W).

        The weighted mean over environments carries the subject's effect. What departs from the
        mean has the cells' noise alone.
        """
        cells = self._cells[:, patterns]
        if self._mean_covariance is None:
            return _sum_of_squares(cells.whiten(residuals))
        precisions = self._precisions[:, patterns]
        precision = self._precision[patterns]
        mean = weighted_mean(precisions, precision, residuals, axis=0)
        pairs = zip(residuals, mean, strict=True)
        departures = tuple(residual - of_mean for residual, of_mean in pairs)
        whitened_mean = self._mean_covariance[patterns].whiten(mean)
        squares = _sum_of_squares(cells.whiten(departures))
        one_row = tuple(component[None] for component in whitened_mean)
        return squares + _sum_of_squares(one_row)

    @functools.cached_property
    def _inverse(self) -> Array:
        """Inverse of the factor, (W, Q, Q): its columns' products are the latents' covariance."""
        return np.asarray(np.linalg.inv(self._factor))

    @functools.cached_property
    def covariance(self) -> Block:
        """Conditional covariance of beta within each environment, entries (J, W)."""
        by_quantity = self.columns().transpose(1, 0, 2, 3)
        return gram(tuple(by_quantity))

    def columns(self) -> Array:
        """Columns (Q, P, J, W) whose outer products sum to the covariance of beta."""
        problem = self._problem
        locations = self._tau.shape[1]
        of_deviations = self._inverse[:, :, :locations] * self._tau[:, None]
        of_trend = self._inverse[:, :, locations:] @ self._problem.trend
        columns = of_deviations + of_trend  # (W, Q, P J)
        draws_last = columns.transpose(1, 2, 0)
        latents, _, width = draws_last.shape
        shape = (latents, problem.quantities, problem.environments, width)
        return draws_last.reshape(shape)

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw beta of all environments jointly, once per set of scales: (P, J, W)."""
        normals = rng.standard_normal(self._latents.shape)
        departures = stacked_solve_upper(self._factor, normals)
        return self._of_latents(self._latents + departures)

    def trend(self, rows: Array) -> tuple[Array, Array]:
        """Mean (R, W) and columns (Q, R, W) of combinations (R, A) of the coefficients a."""
        locations = self._tau.shape[1]
        mean = rows @ self._latents[:, locations:].T
        columns = self._inverse[:, :, locations:] @ rows.T
        return mean, np.moveaxis(columns, 0, -1)


def _sum_of_squares(parts: Vector) -> Array:
    """Squares of all parts (J, R, W) of a vector, summed: (R, W)."""
    squares = [np.einsum("jrw,jrw->rw", part, part) for part in parts]
    return np.asarray(sum(squares))


def _tau_of_locations(tau: Vector, environments: int) -> Array:
    """SD of every location's deviation, (W, P J)."""
    by_quantity = []
    for of_quantity in tau:
        shape = (environments, of_quantity.size)
        repeated = np.broadcast_to(of_quantity, shape)
        by_quantity.append(repeated)
    return np.concatenate(by_quantity).T


def _padded(kinds: Block) -> Block:
    """Covariances of kinds of cells, and last an infinite one: an absent cell says nothing."""
    infinite = np.full((1, kinds.leading.shape[1]), np.inf)
    variances = tuple(np.concatenate([part, infinite]) for part in kinds.variances)
    if kinds.slope is None:
        return Block(variances)
    no_slope = np.zeros_like(infinite)
    return Block(variances, np.concatenate([kinds.slope, no_slope]))
