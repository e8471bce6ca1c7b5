"""Law of the locations of a linear design given scales, and the density of the cell means.

The locations are the cells', B xi, and the slopes of covariates. A study of one row goes by
`OneRow`. For others `CellEquations` holds the parts of the joint precision of the latents xi and
the subjects' effects, and `elimination` solves them: subjects or environments first, whichever
leaves the smaller matrix. With A that precision and D_i the noise of subject i's cells,

    log density = constant - (log det A + sum_i log det D_i + distance + xi'xi) / 2

at the best xi. The distance is a sum of squares about the fitted values, so that no digits are
lost. For each pattern of N subjects it is N r'V⁻¹r of the mean, with r = m - B xi and V = D + ZZ',
and the same of the subjects about their mean. Draws whose elimination has lost too many digits go
by `WhitenedRows`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.cell_equations import CellEquations
from percept.inference.model.cell_problem import CellProblem
from percept.inference.model.cell_scales import CellScales
from percept.inference.model.elimination import OwnFirst, SubjectsFirst, subtract
from percept.inference.model.small_cholesky import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
    with_prior,
)
from percept.inference.model.whitened_rows import WhitenedRows

__all__ = ["CellLaw", "log_density"]

Array = NDArray[np.float64]

#: Least part of a pivot that an elimination may leave. Log densities then err by some 1e-5, as
#: measured on 12 subjects in 5 environments: 1e-16 over that part.
_LEAST_KEPT = 1e-11


def log_density(problem: CellProblem, scales: CellScales) -> Array:
    """Log density of the cell means given scales, without trials about their cell's mean, (W,)."""
    if problem.one_row is not None:
        return problem.one_row.log_density(scales)
    return _Information(problem, scales).log_density


def _locations(problem: CellProblem, latents: Array, deviation_sd: Array) -> Array:
    """Locations (R, W) of latents (Q, W)."""
    deviations = problem.deviations
    cell_latents = deviations + problem.fixed_columns
    coefficients = latents.copy()
    # Columns of fixed terms carry their prior SDs; columns of own deviations and slopes do not.
    coefficients[:deviations] *= np.repeat(deviation_sd, problem.environments, axis=0)
    cells = problem.sparse_basis.T @ coefficients[:cell_latents]
    slopes = problem.covariate_sd * coefficients[cell_latents:]
    return np.concatenate([cells, slopes])


class _Solved(Protocol):
    """Latents at W sets of scales: a own deviations in each of J environments, and r others."""

    latents: Array  # (a J + r, W) Those that fit best: own deviations, then the r of the rest

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (K, n, W) whose products are the covariance of n combinations of latents.

        Weights of the deviations themselves are in response units, (n, a, J). Those of the other
        latents, which are standard normal, are (n, r). Effects have none.
        """

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of combinations with such weights."""


class CellLaw:
    """Law of the locations at W sets of scales.

    Cells and slopes of covariates stand in one vector of R = P C + M P locations, cells first and
    quantity by quantity. Other axes are a own deviations in each of J environments, f fixed
    columns, and the r = f + M P latents that are no deviations.

    Attributes
    ----------
    mean : ndarray
        Mean of the locations, (W, R).
    """

    def __init__(self, problem: CellProblem, scales: CellScales) -> None:
        self._problem = problem
        self._solved: _Solved
        if problem.one_row is not None:
            self._solved = problem.one_row.solve(scales)
        else:
            self._solved = _Information(problem, scales)
        self._latents = self._solved.latents
        self.mean = _locations(problem, self._latents, problem.own_sd(scales.tau)).T

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


class _Information:
    """Latents by normal equations; by whitened rows where these lose digits.

    Other axes are G patterns and q effects of a subject.
    """

    def __init__(self, problem: CellProblem, scales: CellScales) -> None:
        self._problem = problem
        self._trial = scales.trial
        # Draws that lose all digits may become NaN here.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            self._equations = CellEquations(problem, scales)
            self._solved, kept = _solve(self._equations)
            self.latents = self._solved.latents
            self._means = _locations(problem, self.latents, self._equations.deviation_sd)
            self.log_density = problem.constant - 0.5 * (
                self._solved.log_determinant
                + self._subjects_determinant()
                + self._distance()
                + np.einsum("qw,qw->w", self.latents, self.latents)
            )
        #: Draws that have lost too many digits. NaN is lost too.
        self._lost = np.flatnonzero(~(kept >= _LEAST_KEPT))
        self._exact: WhitenedRows | None = None
        if self._lost.size:
            self._exact = WhitenedRows(problem, scales.at(self._lost))
            self.latents[:, self._lost] = self._exact.latents
            self.log_density[self._lost] = self._exact.log_density

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (K, n, W) whose products are the covariance of n combinations of latents."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            columns = self._solved.columns_of(own, rest)
        if self._exact is not None:
            exact = self._exact.columns_of(own, rest)
            columns[..., self._lost] = 0.0
            columns[: len(exact), :, self._lost] = exact
        return columns

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of combinations."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            variances = self._solved.variances_of(own, rest)
        if self._exact is not None:
            variances[self._lost] = self._exact.variances_of(own, rest)
        return variances

    def _subjects_determinant(self) -> Array:
        """Log determinants of D_i and of the effects' precision, summed over all subjects."""
        subject = self._equations.subject
        of_effects = 2.0 * self._problem.subjects @ log_diagonal(subject.effect_factor)
        return np.asarray(subject.noise_determinant + of_effects)

    def _distance(self) -> Array:
        """Squares of responses about their fitted values, whitened and summed.

        Squares of trials about their cell's mean are here only as far as slopes explain them. The
        others hold no location: the model's log likelihood adds them.
        """
        problem = self._problem
        cells = problem.size * problem.cells
        slopes = self._means[cells:]
        covariates = len(problem.covariate_mean)
        slopes_by_quantity = slopes.reshape(covariates, problem.size, slopes.shape[-1])
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
        fitted = self._means[:cells]
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


def _solve(equations: CellEquations) -> tuple[OwnFirst | SubjectsFirst, Array]:
    """Solve the normal equations in the order that leaves the smaller matrix.

    Second is the least part of a pivot that the elimination has left, (W,): the part of its digits.
    """
    by_effects = equations.effects_by_latents
    solved: OwnFirst | SubjectsFirst
    if equations.problem.eliminates_environments(len(by_effects)):
        columns, environments, _, width = equations.deviations_by_rest.shape
        effects, _, patterns, _ = by_effects.shape
        own = columns * environments
        factor = lower_factor(with_prior(equations.deviations))  # (a, a, J, W)
        by_own = by_effects[:, :own].reshape(effects, columns, environments, patterns, width)
        own_by_effects = by_own.transpose(1, 0, 3, 2, 4)  # (a, q, G, J, W)
        own_by_effects = own_by_effects.reshape(columns, effects * patterns, environments, width)
        own_by_rest = equations.deviations_by_rest.swapaxes(1, 2)
        mixed = np.concatenate([own_by_effects, own_by_rest], axis=1)
        explained = solve_lower(factor[:, :, None], mixed)
        joint = _precision_of_effects(equations, own)
        whole = subtract(joint, explained)
        sd = equations.deviation_sd
        solved = OwnFirst(sd, factor, explained, joint, effects * patterns)
    else:
        joint = _precision_of_latents(equations)
        whole = subtract(joint, by_effects)
        solved = SubjectsFirst(equations.deviation_sd, joint)
    return solved, (solved.pivots / whole).min(axis=0, initial=1.0)


def _precision_of_effects(equations: CellEquations, own: int) -> Array:
    """Lower triangle of the precision of what is left, the data last: (K + 1, K + 1, W)."""
    effects, _, patterns, _ = equations.effects_by_latents.shape
    rest, _, width = equations.rest.shape
    first = effects * patterns
    joint = np.zeros((first + rest, first + rest, width))
    by_rest = equations.effects_by_latents[:, own:]  # (q, r + 1, G, W)
    rest_by_effects = by_rest.swapaxes(0, 1)
    joint[first:, :first] = rest_by_effects.reshape(rest, first, width)
    joint[first:, first:] = equations.rest.swapaxes(0, 1)
    diagonal = np.arange(first + rest)
    joint[diagonal, diagonal] += 1.0  # The prior's one, and all that effects have
    return joint


def _precision_of_latents(equations: CellEquations) -> Array:
    """Lower triangle of the latents' precision, the data last: (K + 1, K + 1, W)."""
    columns, environments, rest, width = equations.deviations_by_rest.shape
    own = columns * environments
    size = own + rest
    joint = np.zeros((size, size, width))
    environment = np.arange(environments)
    for first in range(columns):
        for second in range(columns):
            rows = first * environments + environment
            others = second * environments + environment
            joint[rows, others] = equations.deviations[first, second]
    by_rest = equations.deviations_by_rest.reshape(own, rest, width)
    joint[own:, :own] = by_rest.swapaxes(0, 1)
    joint[own:, own:] = equations.rest.swapaxes(0, 1)
    diagonal = np.arange(size)
    joint[diagonal, diagonal] += 1.0
    return joint
