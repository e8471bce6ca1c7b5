"""Locations by orthogonal regression, for one pattern of counts and for scales of any size.

Cell means of pattern g in environment j are z_gj = beta_j + ubar_g + noise with beta_j = alpha +
gamma x_j + delta_j. With a single pattern the environments' own biases delta_j are integrated out,
and alpha and ubar merge since only their sum enters. With several patterns ubar_g is integrated out
and the delta_j are latents.

With y | xi ~ N(A xi, I) and xi ~ N(0, I), everything wanted of y and of xi given y comes from the
triangular factor of [[I], [A]]. Modified Gram-Schmidt with the target carried along is backward
stable for this; normal equations, and Woodbury's identity, subtract large numbers instead.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, SharedCovariance, Vector, gram
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Layout, Scales
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["Factored", "LocationProblem", "Regression", "factor"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Factored:
    """Result of `factor` for latents of dimension q and W sets of scales."""

    log_determinant: Array  # (W,) log det(I + A'A)
    distance: Array  # (W,) y'(I + AA')⁻¹y, a sum of squares
    triangle: Array  # (q, q, W) Upper triangular R with R'R = I + A'A
    coefficients: Array  # (q, W) R times the conditional mean of xi

    def solve(self, right: Array) -> Array:
        """Solve R x = right for x, `right` of shape (q, ..., W)."""
        solution = np.array(np.broadcast_to(right, right.shape[:-1] + self.triangle.shape[-1:]))
        for i in reversed(range(len(solution))):
            solution[i] /= self.triangle[i, i]
            for k in range(i):
                solution[k] -= self.triangle[k, i] * solution[i]
        return solution

    def solve_transposed(self, right: Array) -> Array:
        """Solve R'x = right for x, `right` of shape (q, ..., W)."""
        solution = np.array(np.broadcast_to(right, right.shape[:-1] + self.triangle.shape[-1:]))
        for i in range(len(solution)):
            solution[i] /= self.triangle[i, i]
            for k in range(i + 1, len(solution)):
                solution[k] -= self.triangle[i, k] * solution[i]
        return solution

    @property
    def mean(self) -> Array:
        """Conditional mean of xi, shape (q, W)."""
        return self.solve(self.coefficients)


def factor(design: Array, target: Array) -> Factored:
    """Factor [[I], [A]] and project the target, for every set of scales."""
    size, rows, width = design.shape
    # The identity is flipped so that each column's nonzeros are contiguous.
    work = np.zeros((size + 1, size + rows, width))
    work[:size, size:] = design
    work[size, size:] = target
    work[np.arange(size), size - 1 - np.arange(size)] = 1.0
    triangle = np.zeros((size, size, width))
    coefficients = np.empty((size, width))
    squares = np.empty((size, width))
    for i in range(size):
        column = work[i, size - 1 - i :]
        later = work[i + 1 :, size - 1 - i :]
        np.einsum("mw,mw->w", column, column, out=squares[i])
        norm = np.sqrt(squares[i], out=triangle[i, i])
        column /= norm
        shares = np.einsum("mw,kmw->kw", column, later)
        later -= shares[:, None] * column
        triangle[i, i + 1 :] = shares[:-1]
        coefficients[i] = shares[-1]
    residual = work[size]
    return Factored(
        np.log(squares).sum(axis=0),
        np.einsum("mw,mw->w", residual, residual),
        triangle,
        coefficients,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Whitened:
    """A regression on standard normal latents with unit noise, and how beta follows from it."""

    design: Array  # (q, M, W) Columns of the whitened design
    target: Array  # (M, W) Whitened pattern means
    log_determinant: Array  # (W,) log det of the noise covariance that was whitened away
    columns: list[Vector]  # What each latent adds to the means, per parameter
    locations: list[Vector]  # What each adds to the locations
    summed: (
        tuple[Block, Vector] | None
    )  # Noise and mean of the one pattern, its own biases integrated out


class LocationProblem:
    """Builds the regression of the pattern means on the locations."""

    def __init__(self, statistics: Statistics, layout: Layout, priors: Priors) -> None:
        self._patterns, self._size = statistics.patterns, layout.parameters
        self.environments = layout.environments
        self._alpha_sd = priors.alpha_sd
        each = np.eye(self._size)[..., None]
        slopes = [priors.gamma_sd * statistics.x * each] if layout.trend else []
        #: Columns (Q, P, J) of alpha and gamma, times their prior SDs.
        self.trend = np.concatenate([priors.alpha_sd * each + np.zeros(self.environments), *slopes])
        self._trend_columns = [tuple(column[..., None]) for column in self.trend]

    def whitened(self, scales: Scales, cells: list[Block], *, merge: bool) -> Whitened:
        """Whiten pattern means and the latents' design, level and subject effect merged or not."""
        # Covariance of each pattern's mean about its mean subject effect, entries (E, W).
        noises = [
            cell.scaled(1.0 / pattern.subjects)
            for cell, pattern in zip(cells, self._patterns, strict=True)
        ]
        if len(noises) == 1:
            return self._of_one_pattern(scales, noises[0], merge=merge)
        return self._of_several(scales, noises)

    def _of_several(self, scales: Scales, noises: list[Block]) -> Whitened:
        width = scales.log_prior.size
        columns = list(self._trend_columns)
        for p, tau in enumerate(scales.tau or ()):
            for j in range(self.environments):
                own = np.zeros((self._size, self.environments, width))
                own[p, j] = tau
                columns.append(tuple(own))
        stacked = _stack(columns, (self.environments, width))
        targets: list[Array] = []
        designs: list[Array] = []
        log_determinant = np.zeros(width)
        for pattern, noise in zip(self._patterns, noises, strict=True):
            shared = None if scales.shared is None else scales.shared.scaled(1.0 / pattern.subjects)
            covariance = SharedCovariance(noise, shared)
            log_determinant += covariance.log_determinant()
            mean = tuple(np.broadcast_to(m[:, None], (m.size, width)) for m in pattern.mean)
            targets += _rows(covariance.whiten(mean))
            part = tuple(c[:, pattern.environments] for c in stacked)
            designs += _rows(covariance.whiten(part), len(columns))
        design = np.concatenate(designs, axis=1)
        return Whitened(design, np.concatenate(targets), log_determinant, columns, columns, None)

    def _of_one_pattern(self, scales: Scales, noise: Block, *, merge: bool) -> Whitened:
        (pattern,) = self._patterns
        shape = self.environments, scales.log_prior.size
        mean = tuple(np.broadcast_to(m[:, None], shape) for m in pattern.mean)
        spread = noise
        if scales.tau is not None:
            spread = noise.plus_diagonal(tuple(tau * tau for tau in scales.tau))
        columns = list(self._trend_columns)
        if scales.shared is not None:
            effect = scales.shared.scaled(1.0 / pattern.subjects)
            if merge:
                both = effect.plus_diagonal((np.array(self._alpha_sd**2),) * self._size)
                columns[: self._size] = both.factor_columns()
            else:
                columns += effect.factor_columns()
        whitened = np.concatenate(
            _rows([spread.whiten(_stack([*columns, mean], shape))], len(columns) + 1), axis=1
        )
        log_determinant = spread.log_determinant().sum(axis=0)
        # The subject effect moves the means and not the locations.
        apart = [(np.zeros(1),) * self._size] * (len(columns) - len(self._trend_columns))
        locations = [*self._trend_columns, *apart]
        return Whitened(
            whitened[:-1], whitened[-1], log_determinant, columns, locations, (noise, mean)
        )


def _stack(columns: list[Vector], shape: tuple[int, int]) -> Vector:
    """Stack columns along a new first axis, each parameter (Q, J, W)."""
    return tuple(
        np.stack([np.broadcast_to(part, shape) for part in parts])
        for parts in zip(*columns, strict=True)
    )


def _rows(pieces: list[Vector], *columns: int) -> list[Array]:
    """Rows of every component of every piece, for each column: (*columns, rows, W)."""
    return [np.reshape(c, (*columns, -1, c.shape[-1])) for piece in pieces for c in piece]


class Regression:
    """Locations at W sets of scales: density of patterns' means, and on demand the law of beta.

    With `merge`, one pattern's level and subject effect share a latent. That has one latent fewer,
    and gives the density alone: the law of beta needs the level by itself.
    """

    def __init__(
        self, problem: LocationProblem, scales: Scales, cells: list[Block], *, merge: bool = False
    ) -> None:
        self._scales = scales
        self._shape = problem.environments, scales.log_prior.size
        self._merged = merge and len(cells) == 1 and scales.shared is not None
        self._whitened = whitened = problem.whitened(scales, cells, merge=merge)
        self._solved = factor(whitened.design, whitened.target)
        self.log_density = -0.5 * (
            whitened.log_determinant + self._solved.log_determinant + self._solved.distance
        )

    @cached_property
    def _on_latents(self) -> tuple[list[Array], list[Array], Block | None]:
        """Columns of beta on the latents (Q, J, W), the rest of its mean, its own covariance."""
        self._refuse_merged()
        problem, scales, shape = self._whitened, self._scales, self._shape
        columns = list(_stack(problem.locations, shape))
        constant = [np.zeros(shape) for _ in columns]
        if problem.summed is None or scales.tau is None:
            return columns, constant, None
        noise, mean = problem.summed
        variances = tuple(tau * tau for tau in scales.tau)
        pull = noise.plus_diagonal(variances).inverse()
        change = pull.apply(_stack(problem.columns, shape))
        columns = [
            rows - variance * part
            for rows, variance, part in zip(columns, variances, change, strict=True)
        ]
        constant = [
            variance * part for variance, part in zip(variances, pull.apply(mean), strict=True)
        ]
        inverse = tuple(np.broadcast_to(1.0 / variance, shape) for variance in variances)
        return columns, constant, noise.inverse().plus_diagonal(inverse).inverse()

    def _refuse_merged(self) -> None:
        """Refuse a law of latents that hold a subject effect as well."""
        if self._merged:
            raise ValueError("A merged regression gives no law of beta: build it without merge.")

    def _of_latents(self, latents: Array) -> Vector:
        columns, constant, _ = self._on_latents
        return tuple(
            c + np.einsum("qjw,qw->jw", rows, latents)
            for c, rows in zip(constant, columns, strict=True)
        )

    @cached_property
    def mean(self) -> Vector:
        """Conditional mean of beta, (J, W) per parameter."""
        return self._of_latents(self._solved.mean)

    @cached_property
    def _spread(self) -> list[Array]:
        """Columns (Q, J, W) per parameter that the latents give to the covariance of beta."""
        columns, *_ = self._on_latents
        return [self._solved.solve_transposed(rows) for rows in columns]

    @cached_property
    def covariance(self) -> Block:
        """Conditional covariance of beta within each environment, entries (J, W)."""
        *_, own = self._on_latents
        return gram(self._spread) if own is None else gram(self._spread) + own

    def columns(self) -> Array:
        """Columns (R, P, J, W) whose outer products sum to the covariance of beta."""
        *_, own = self._on_latents
        columns = np.stack(self._spread, axis=1)
        if own is None:
            return columns
        _, size, environments, width = columns.shape
        apart = np.zeros((size, environments, size, environments, width))
        at = np.arange(environments)
        for c, column in enumerate(own.factor_columns()):
            for p, part in enumerate(column):
                apart[c, at, p, at] = part
        return np.concatenate([columns, apart.reshape(-1, size, environments, width)])

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw beta of all environments jointly, once per set of scales: (P, J, W)."""
        normal = rng.standard_normal(self._solved.coefficients.shape)
        beta = np.stack(self._of_latents(self._solved.solve(self._solved.coefficients + normal)))
        *_, own = self._on_latents
        for column in own.factor_columns() if own is not None else ():
            beta += np.stack(column) * rng.standard_normal(beta.shape[1:])
        return beta

    def trend(self, rows: Array) -> tuple[Array, Array]:
        """Mean (R, W) and columns (Q, R, W) of rows (R, 2 P) of alpha and gamma over prior SDs."""
        self._refuse_merged()
        count, width = self._solved.coefficients.shape
        padded = np.zeros((count, len(rows), width))
        padded[: rows.shape[1]] = rows.T[..., None]
        return rows @ self._solved.mean[: rows.shape[1]], self._solved.solve_transposed(padded)
