"""Locations by their information: the form for studies of several patterns of counts.

Given the scales, subject i adds to the information on the locations beta

    V_i⁻¹ = P_i - P_i 1 T_i 1'P_i
    P_ij = (Sigma_w,j + Sigma_e,j/r_ij)⁻¹
    T_i = (Sigma_u⁻¹ + sum_j P_ij)⁻¹

where a missing cell has no precision, and T_i is the covariance of the subject's effect given its
data. beta = tau delta + X'a has standard normal latents: deviations delta of the environments, and
coefficients a of the columns X of alpha and gamma. With the information L = sum_i V_i⁻¹ and
t = sum_i V_i⁻¹ m_i of the means m_i, the latents have the precision and the right side

    I + [[tau L tau, tau L X'], [X L tau, X L X']]  and  [tau t, X t]

Cost follows subjects times environments, and trials never. The difference in V_i⁻¹ loses digits
where the subject effect dwarfs the rest or a correlation nears one. The pivots of the Cholesky
factor tell how many. Draws that lose more than `LEAST_PIVOT` allows are left to the orthogonal
form. Distances are sums of squares about the weighted means in either case.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, gram
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
    "precision_entries",
]

Array = NDArray[np.float64]
#: Least part of a pivot that subtraction may leave: log determinants then err by 1e-8 at the most.
LEAST_PIVOT = 1e-7


@dataclasses.dataclass(frozen=True, eq=False)
class _NormalEquations:
    """Precision of the latents and its right side, at W sets of scales."""

    matrix: Array  # (W, Q, Q)
    right: Array  # (W, Q)
    full_diagonal: Array  # (W, Q) What the diagonal would be if subjects' effects were known


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
        by_quantity = [np.broadcast_to(tau, (problem.environments, tau.size)) for tau in scales.tau]
        self._tau = np.concatenate(by_quantity).T  # (W, P J)
        self._cells = _padded(kinds)[problem.kind]  # entries (J, G, W)
        self._precisions = self._cells.inverse()
        self._precision = self._precisions.total()  # entries (G, W)
        #: Covariance of the weighted mean of a subject's cells; None without subjects' effects.
        self._mean_covariance: Block | None = None
        effect_covariance: Block | None = None
        if scales.shared is not None:
            self._mean_covariance = scales.shared + self._precision.inverse()
            effect_precision = scales.shared.inverse() + self._precision
            effect_covariance = effect_precision.inverse()  # T
        entries = precision_entries(kinds.inverse())
        equations = self._normal_equations(entries, effect_covariance)
        self._factor = stacked_factor(equations.matrix)
        pivots = np.einsum("wii->wi", self._factor)
        kept = pivots * pivots >= LEAST_PIVOT * equations.full_diagonal
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
        self.log_density = problem.constant - 0.5 * (determinants + distance) - log_pivots

    def _normal_equations(
        self, entries: Array, effect_covariance: Block | None
    ) -> _NormalEquations:
        """Precision of the latents from precisions (P, P, K, W) of the kinds of cells."""
        problem = self._problem
        size = problem.size
        width = entries.shape[-1]
        subjects_by_kind = problem.in_environment * problem.subjects_of_kind
        cell_precision = subjects_by_kind @ entries  # (P, P, J, W) Without subjects' effects
        sums = (problem.mean_of_kind @ problem.subjects)[..., None]  # (P, K, 1)
        locations = size * problem.environments
        information = np.zeros((width, locations, locations))
        if effect_covariance is not None:
            explained = self._explained_columns(entries, effect_covariance)
            information = -explained @ explained.transpose(0, 2, 1)
            sums = sums - self._effect_sums(entries, effect_covariance)
        environment = np.arange(problem.environments)
        for p in range(size):
            row = p * problem.environments + environment
            for q in range(size):
                column = q * problem.environments + environment
                information[:, row, column] += cell_precision[p, q].T
        about_centre = problem.in_environment @ (entries * sums).sum(axis=1)
        right = about_centre.reshape(locations, width).T + information @ problem.centre.ravel()
        diagonal = np.einsum("ppjw->wpj", cell_precision).reshape(width, locations)
        return self._of_information(information, right, diagonal)

    def _explained_columns(self, entries: Array, effect_covariance: Block) -> Array:
        """Columns P 1 F with FF' = T: their products are what subjects' effects take away."""
        problem = self._problem
        size, _, _, width = entries.shape
        absent = np.zeros((size, size, 1, width))
        by_kind = np.concatenate([entries, absent], axis=2)
        by_cell = by_kind[:, :, problem.kind]  # (P, P, J, G, W)
        root_subjects = np.sqrt(problem.subjects)[:, None]
        columns = []
        for column in effect_covariance.factor_columns():
            parts = [by_cell[:, q] * (root_subjects * part) for q, part in enumerate(column)]
            columns.append(sum(parts))
        stacked = np.stack(columns).transpose(4, 1, 2, 0, 3)  # (W, P, J, P, G)
        return stacked.reshape(width, size * problem.environments, -1)

    def _effect_sums(self, entries: Array, effect_covariance: Block) -> Array:
        """Best effects T 1'P m, at locations of zero, summed over subjects by kind: (P, K, W)."""
        problem = self._problem
        by_pattern = problem.mean_of_kind.transpose(0, 2, 1)
        weighted = (by_pattern @ entries).sum(axis=1)  # (P, G, W)
        effects = np.stack(effect_covariance.apply(tuple(weighted)))
        over_subjects = problem.subjects[:, None] * effects
        return np.asarray(problem.has_kind @ over_subjects)

    def _of_information(
        self, information: Array, right: Array, diagonal: Array
    ) -> _NormalEquations:
        """Turn information L and right side t of the locations into equations of the latents.

        The diagonal is that of L if subjects' effects were known.
        """
        tau = self._tau
        columns = self._trend  # X
        locations = tau.shape[1]
        by_columns = information @ columns.T
        mixed = tau[:, :, None] * by_columns
        latents = locations + len(columns)
        matrix = np.empty((len(tau), latents, latents))
        scaled = tau[:, :, None] * information
        matrix[:, :locations, :locations] = scaled * tau[:, None, :]
        matrix[:, :locations, locations:] = mixed
        matrix[:, locations:, :locations] = mixed.transpose(0, 2, 1)
        matrix[:, locations:, locations:] = columns @ by_columns
        np.einsum("wii->wi", matrix)[...] += 1.0
        of_deviations = tau**2 * diagonal
        of_columns = diagonal @ (columns**2).T
        return _NormalEquations(
            matrix=matrix,
            right=np.concatenate([tau * right, right @ columns.T], axis=1),
            full_diagonal=1.0 + np.concatenate([of_deviations, of_columns], axis=1),
        )

    @property
    def _trend(self) -> Array:
        """Columns X of alpha and gamma over all locations, (Q, P J)."""
        columns = self._problem.prior_columns
        return columns.reshape(len(columns), -1)

    def _of_latents(self, latents: Array) -> Array:
        """Locations (P, J, W) of latents (W, Q)."""
        problem = self._problem
        locations = self._tau.shape[1]
        deviations = self._tau * latents[:, :locations]
        beta = deviations + latents[:, locations:] @ self._trend
        return np.asarray(beta.T.reshape(problem.size, problem.environments, -1))

    def _distance(self) -> Array:
        """Sum of squares of means about the locations, and of scatter within patterns, whitened."""
        problem = self._problem
        residuals = []
        for mean, centre, beta in zip(problem.mean, problem.centre, self.mean, strict=True):
            off_centre = centre[:, None] - beta
            residuals.append(mean[..., None] + off_centre[:, None])
        distance = problem.subjects @ self._squares(tuple(residuals), slice(None))
        if problem.row_pattern.size:
            rows = tuple(problem.rows[..., None])
            distance = distance + self._squares(rows, problem.row_pattern).sum(axis=0)
        return distance

    def _squares(self, residuals: Vector, patterns: NDArray[np.intp] | slice) -> Array:
        """r'V_g⁻¹r of vectors (J, R, W) or (J, R, 1), each of its pattern g: shape (R, W).

        The weighted mean over environments carries the subject's effect. What departs from the
        mean has the cells' noise alone.
        """
        cells = self._cells[:, patterns]
        if self._mean_covariance is None:
            return _sum_of_squares(cells.whiten(residuals))
        precisions = self._precisions[:, patterns]
        mean = weighted_mean(precisions, self._precision[patterns], residuals, axis=0)
        departures = tuple(r - m for r, m in zip(residuals, mean, strict=True))
        whitened_mean = self._mean_covariance[patterns].whiten(mean)
        squares = _sum_of_squares(cells.whiten(departures))
        return squares + _sum_of_squares(tuple(part[None] for part in whitened_mean))

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
        of_trend = self._inverse[:, :, locations:] @ self._trend
        columns = (of_deviations + of_trend).transpose(1, 2, 0)
        return columns.reshape(-1, problem.size, problem.environments, columns.shape[2])

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw beta of all environments jointly, once per set of scales: (P, J, W)."""
        normals = rng.standard_normal(self._latents.shape)
        departures = stacked_solve_upper(self._factor, normals)
        return self._of_latents(self._latents + departures)

    def trend(self, rows: Array) -> tuple[Array, Array]:
        """Mean (R, W) and columns (Q, R, W) of rows (R, 2 P) of alpha and gamma over prior SDs."""
        locations = self._tau.shape[1]
        mean = rows @ self._latents[:, locations:].T
        columns = self._inverse[:, :, locations:] @ rows.T
        return mean, np.moveaxis(columns, 0, -1)


def _sum_of_squares(parts: Vector) -> Array:
    """Squares of all parts (J, R, W) of a vector, summed: (R, W)."""
    squares = [np.einsum("jrw,jrw->rw", part, part) for part in parts]
    return np.asarray(sum(squares))


def _padded(kinds: Block) -> Block:
    """Covariances of kinds of cells, and last an infinite one: an absent cell says nothing."""
    infinite = np.full((1, kinds.leading.shape[1]), np.inf)
    variances = tuple(np.concatenate([part, infinite]) for part in kinds.variances)
    if kinds.slope is None:
        return Block(variances)
    no_slope = np.zeros_like(infinite)
    return Block(variances, np.concatenate([kinds.slope, no_slope]))


def precision_entries(precision: Block) -> Array:
    """Entries (P, P, ...) of precisions (...)."""
    second = precision.leading
    slope = precision.slope
    if slope is None:
        return second[None, None]
    cross = second * slope
    first = precision.rest + cross * slope
    return np.stack([[first, cross], [cross, second]])
