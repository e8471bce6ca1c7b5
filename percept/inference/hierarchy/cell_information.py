"""Locations of a linear design by normal equations, and the density of all responses.

The locations are the cells', B xi, and the slopes of covariates. `CellEquations` holds the
parts of the joint precision of the latents xi and the subjects' effects, and `elimination` solves
them: subjects or environments first, whichever leaves the smaller matrix. With A that precision and
D_i the noise of subject i's cells,

    log density = constant - (log det A + sum_i log det D_i + distance + xi'xi) / 2

at the best xi. The distance is a sum of squares about the fitted values, so that no digits are
lost. For each pattern of N subjects it is N r'V⁻¹r of the mean, with r = m - B xi and V = D + ZZ',
and the same of the subjects about their mean.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.cell_equations import CellEquations
from percept.inference.hierarchy.cell_problem import CellProblem
from percept.inference.hierarchy.cell_scales import CellScales
from percept.inference.hierarchy.elimination import solve
from percept.inference.hierarchy.small_cholesky import log_diagonal, solve_lower, solve_upper

__all__ = ["CellLaw"]

Array = NDArray[np.float64]


class CellLaw:
    """Law of the locations at W sets of scales, and the density of all responses.

    Cells and slopes of covariates stand in one vector of R = P C + M P locations, cells first and
    quantity by quantity. Other axes are G patterns, q effects of a subject, a own deviations in
    each of J environments, f fixed columns, and the r = f + M P latents that are no deviations.

    Attributes
    ----------
    sound : ndarray of bool
        Whether enough digits remain for the density, (W,).
    laws_sound : ndarray of bool
        Whether enough remain for the law of the locations, (W,).
    log_density : ndarray
        Log density of the responses given the scales, without trials about their cells' means, up
        to a constant of the study, (W,).
    """

    def __init__(self, problem: CellProblem, scales: CellScales) -> None:
        self._problem = problem
        equations = CellEquations(problem, scales)
        self._equations = equations
        self._trial = scales.trial
        self._solved = solve(equations)
        #: (W,) Whether enough digits remain for the density.
        self.sound = self._solved.remainder.sound
        #: (W,) Whether enough remain for the law of the locations.
        self.laws_sound = self._solved.remainder.laws_sound
        self._latents = self._solved.latents
        self.log_density = problem.constant - 0.5 * (
            self._solved.log_determinant
            + self._subjects_determinant()
            + self._distance()
            + np.einsum("qw,qw->w", self._latents, self._latents)
        )

    @cached_property
    def _locations(self) -> Array:
        """Locations that fit best, (R, W)."""
        problem = self._problem
        deviations = problem.deviations
        cell_latents = deviations + problem.fixed_columns
        deviation_sd = self._equations.deviation_sd
        coefficients = self._latents.copy()
        # Columns of fixed terms carry their prior SDs; columns of own deviations and slopes do not.
        coefficients[:deviations] *= np.repeat(deviation_sd, problem.environments, axis=0)
        cells = problem.sparse_basis.T @ coefficients[:cell_latents]
        slopes = problem.covariate_sd * coefficients[cell_latents:]
        return np.concatenate([cells, slopes])

    @property
    def mean(self) -> Array:
        """Mean of the locations, (W, R)."""
        return self._locations.T

    def _subjects_determinant(self) -> Array:
        """Log determinants of D_i and of the effects' precision, summed over all subjects."""
        problem = self._problem
        subject = self._equations.subject
        subjects_by_cell = problem.present * problem.subjects
        of_cells = subject.noise.log_determinant()
        of_noise = np.einsum("cg,cgw->w", subjects_by_cell, of_cells)
        of_effects = 2.0 * problem.subjects @ log_diagonal(subject.effect_factor)
        return np.asarray(of_noise + of_effects)

    def _distance(self) -> Array:
        """Squares of responses about their fitted values, whitened and summed.

        Squares of trials about their cell's mean are here only as far as slopes explain them. The
        others hold no location: `LinearModel.log_likelihood` adds them.
        """
        problem = self._problem
        cells = problem.size * problem.cells
        slopes = self._locations[cells:]
        slopes_by_quantity = slopes.reshape(-1, problem.size, slopes.shape[-1])
        distance = self._distance_of_means(slopes_by_quantity)
        covariances = self._equations.subject.covariances()
        for scatter, covariance in zip(problem.scatter, covariances, strict=True):
            residuals = scatter.rows[..., None]
            if problem.slopes:
                residuals = residuals - np.einsum("snpe,sw->npew", scatter.slopes, slopes)
            distance = distance + covariance.scatter_distance(residuals)
        trial = self._trial
        if trial is not None and problem.slopes:
            scatter_of_trials = problem.trial_scatter
            covariate_rows = scatter_of_trials.covariate_rows
            fitted = np.einsum("lmt,mpw->lptw", covariate_rows, slopes_by_quantity)
            residuals = scatter_of_trials.response_rows[..., None] - fitted
            by_quantity = residuals.swapaxes(0, 1)
            distance = distance + trial.distance(tuple(by_quantity)).sum(axis=0)
        return np.asarray(distance)

    def _distance_of_means(self, slopes: Array) -> Array:
        """N r'V⁻¹r of the patterns' means less their fit with slopes (M, P, W), summed: (W,)."""
        problem = self._problem
        cells = problem.size * problem.cells
        fitted = self._locations[:cells]
        fitted = fitted.reshape(problem.size, problem.cells, 1, slopes.shape[-1])
        residuals = problem.mean[..., None] - fitted
        if problem.slopes:
            of_covariates = np.einsum("mcg,mpw->pcgw", problem.covariate_mean, slopes)
            residuals = residuals - of_covariates
        return np.asarray(problem.subjects @ self._mean_squares(residuals))

    def _mean_squares(self, residuals: Array) -> Array:
        """r'V⁻¹r of one vector of each pattern, (P, C, G, W), as sums of squares: (G, W).

        With b = (I + Z'H)⁻¹H'r, the subject's effect that fits r best, r'V⁻¹r is the distance of
        r - Zb by D, plus b'b.
        """
        subject = self._equations.subject
        factor = subject.effect_factor
        weighted = np.einsum("qpcgw,pcgw->qgw", subject.weighted_effects, residuals)
        effects = solve_upper(factor, solve_lower(factor, weighted))
        explained = np.einsum("qpcw,qgw->pcgw", subject.effect_columns, effects)
        unexplained = residuals - explained
        unexplained *= self._problem.present[..., None]
        # `distance` takes rows of each quantity and sums over them; here there is one row.
        one_row = unexplained[:, None]
        squares = subject.noise.distance(tuple(one_row)).sum(axis=0)
        return np.asarray(squares + np.einsum("qgw,qgw->gw", effects, effects))

    def fixed(self, rows: Array) -> tuple[Array, Array]:
        """Mean and columns of combinations of the fixed columns' coefficients.

        Parameters
        ----------
        rows : ndarray
            Weights (L, f) of the coefficients over their prior SDs, which are standard normal. No
            prior SD enters here: the columns of fixed terms carry it.

        Returns
        -------
        mean : ndarray
            Shape (W, L).
        columns : ndarray
            Columns (W, L, K) whose products sum to the combinations' covariance.
        """
        problem = self._problem
        first_fixed = problem.deviations
        coefficients = self._latents[first_fixed : first_fixed + problem.fixed_columns]
        no_deviations = np.zeros((len(rows), problem.own_columns, problem.environments))
        rest_rows = np.pad(rows, ((0, 0), (0, problem.slopes)))
        columns = self._solved.columns_of(no_deviations, rest_rows)
        return (rows @ coefficients).T, columns.T

    def columns_of(self, rows: Array) -> Array:
        """Columns (W, L, K) whose products are the covariance of combinations (L, R)."""
        deviation_rows, rest_rows = self._latent_rows(rows)
        return self._solved.columns_of(deviation_rows, rest_rows).T

    def variances_of(self, rows: Array) -> Array:
        """Variances (W, L) of combinations (L, R)."""
        deviation_rows, rest_rows = self._latent_rows(rows)
        return self._solved.variances_of(deviation_rows, rest_rows)

    def _latent_rows(self, rows: Array) -> tuple[Array, Array]:
        """Weights of own deviations (L, a, J) and of the rest (L, r), from weights of locations."""
        problem = self._problem
        cells = problem.size * problem.cells
        cell_latent_rows = rows[:, :cells] @ problem.basis
        slope_rows = problem.covariate_sd * rows[:, cells:]
        deviation_rows = cell_latent_rows[:, : problem.deviations]
        fixed_rows = cell_latent_rows[:, problem.deviations :]
        shape = (len(rows), problem.own_columns, problem.environments)
        rest_rows = np.concatenate([fixed_rows, slope_rows], axis=1)
        return deviation_rows.reshape(shape), rest_rows
