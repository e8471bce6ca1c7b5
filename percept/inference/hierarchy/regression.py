"""Locations by orthogonal regression, for scales of any size: at its fastest with one pattern.

Subjects with equal cells and trials form a pattern g of n_g subjects. Their mean z_gj in
environment j is

    z_gj = beta_j + ubar_g + noise,    beta_j = alpha + gamma x_j + delta_j

with one entry for each of P quantities. Priors are normal about zero: alpha and gamma with known
SDs, the environments' biases delta_j with SDs tau, the mean subject effect ubar_g with the
covariance shared/n_g. The means are whitened by the covariance that is integrated out, and
regressed on standard normal latents xi by `orthogonal`:

    patterns   integrated out   latents
    one        delta            alpha, gamma, ubar; merged: the sum alpha + ubar, and gamma
    several    ubar             alpha, gamma, delta

Only the sum of alpha and ubar enters the means of one pattern. So the merged form gives their
density with P latents fewer, and no law of beta.

Shapes: P quantities, J environments, E of them in a pattern, Q latents, M whitened means, W sets of
scales. A `Vector` holds an array per quantity, and a `Block` a covariance of the quantities per
entry.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, gram
from percept.inference.hierarchy.orthogonal import factor
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Layout, Scales
from percept.inference.hierarchy.shared_covariance import SharedCovariance
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["LocationProblem", "Regression"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class OnePatternMeans:
    """What the biases delta are drawn back from, once they are integrated out."""

    noise: Block  # (J, W) Covariance of the means about beta + ubar
    mean: Vector  # (J, W) z


@dataclasses.dataclass(frozen=True, eq=False)
class WhitenedMeans:
    """Pattern means as a regression on standard normal latents with unit noise."""

    design: Array  # (Q, M, W) Columns of the whitened design
    target: Array  # (M, W) Whitened pattern means
    log_determinant: Array  # (W,) log det of the covariance that was whitened away
    columns: list[Vector]  # (J, W or 1) What each latent adds to the means, effects of subjects too
    location_columns: list[Vector]  # (J, W or 1) To beta: zero for effects of subjects
    integrated_out: OnePatternMeans | None  # None with several patterns, whose delta are latents


class LocationProblem:
    """Builds the regression of the pattern means on the latents.

    Parameters
    ----------
    statistics : Statistics
        Of the responses.
    layout : Layout
        Whose scales the regression takes.
    priors : Priors
        Prior SDs of alpha and gamma.

    Attributes
    ----------
    environments : int
        Their number J.
    trend : ndarray
        Columns (P or 2 P, P, J) of alpha, and of gamma if there are several environments, times
        their prior SDs.
    """

    def __init__(self, statistics: Statistics, layout: Layout, priors: Priors) -> None:
        self._patterns = statistics.patterns
        self._size = layout.parameters
        self.environments = layout.environments
        self._alpha_sd = priors.alpha_sd
        each_quantity = np.eye(self._size)[..., None]
        every_environment = np.zeros(self.environments)
        trend = [priors.alpha_sd * each_quantity + every_environment]
        if layout.trend:
            trend.append(priors.gamma_sd * statistics.x * each_quantity)
        self.trend = np.concatenate(trend)
        # One entry for all draws.
        self._trend_columns = [tuple(column[..., None]) for column in self.trend]

    def whitened(
        self,
        scales: Scales,
        cell_noise: list[Block],
        *,
        merge: bool,
    ) -> WhitenedMeans:
        """Whiten the pattern means and the latents' columns.

        The noise is the covariance of one subject's cell means about beta + u, by pattern (E, W).
        """
        noise_of_means = []
        for pattern, noise in zip(self._patterns, cell_noise, strict=True):
            noise_of_means.append(noise.scaled(1.0 / pattern.subjects))
        if len(noise_of_means) == 1:
            return self._of_one_pattern(scales, noise_of_means[0], merge=merge)
        return self._of_several(scales, noise_of_means)

    def _of_several(self, scales: Scales, noise_of_means: list[Block]) -> WhitenedMeans:
        """Integrate out each pattern's ubar; delta are latents."""
        width = scales.log_prior.size
        columns = self._trend_columns + self._bias_columns(scales)
        by_latent = _stacked(columns, (self.environments, width))
        targets = []
        designs = []
        log_determinant = np.zeros(width)
        for pattern, noise in zip(self._patterns, noise_of_means, strict=True):
            shared: Block | None = None
            if scales.shared is not None:
                shared = scales.shared.scaled(1.0 / pattern.subjects)
            covariance = SharedCovariance(noise, shared)
            log_determinant += covariance.log_determinant()
            shape = (len(pattern.environments), width)
            mean = tuple(np.broadcast_to(m[:, None], shape) for m in pattern.mean)
            for part in _components(covariance.whiten(mean)):
                targets.append(part.reshape(-1, width))
            present = tuple(rows[:, pattern.environments] for rows in by_latent)
            for part in _components(covariance.whiten(present)):
                designs.append(part.reshape(len(columns), -1, width))
        return WhitenedMeans(
            design=np.concatenate(designs, axis=1),
            target=np.concatenate(targets),
            log_determinant=log_determinant,
            columns=columns,
            location_columns=columns,
            integrated_out=None,
        )

    def _bias_columns(self, scales: Scales) -> list[Vector]:
        """Columns of delta, quantity by quantity and environment by environment."""
        columns: list[Vector] = []
        if scales.tau is None:
            return columns
        for p, tau in enumerate(scales.tau):
            for j in range(self.environments):
                column = np.zeros((self._size, self.environments, tau.size))
                column[p, j] = tau
                columns.append(tuple(column))
        return columns

    def _of_one_pattern(self, scales: Scales, noise: Block, *, merge: bool) -> WhitenedMeans:
        """Integrate out delta; ubar is a latent, by itself or merged with alpha."""
        (pattern,) = self._patterns
        shape = (self.environments, scales.log_prior.size)
        mean = tuple(np.broadcast_to(m[:, None], shape) for m in pattern.mean)
        covariance = noise
        if scales.tau is not None:
            covariance = noise.plus_diagonal(_squares(scales.tau))
        columns = list(self._trend_columns)
        if scales.shared is not None:
            of_ubar = scales.shared.scaled(1.0 / pattern.subjects)
            if merge:
                alpha_variance = np.array(self._alpha_sd**2)
                of_sum = of_ubar.plus_diagonal((alpha_variance,) * self._size)
                columns[: self._size] = of_sum.factor_columns()
            else:
                columns += of_ubar.factor_columns()
        with_mean = _stacked([*columns, mean], shape)
        whitened = covariance.whiten(with_mean)
        rows = np.concatenate(whitened, axis=1)
        # The subject effect moves the means and not beta.
        nothing = (np.zeros(1),) * self._size
        effects = len(columns) - len(self._trend_columns)
        return WhitenedMeans(
            design=rows[:-1],
            target=rows[-1],
            log_determinant=covariance.log_determinant().sum(axis=0),
            columns=columns,
            location_columns=self._trend_columns + [nothing] * effects,
            integrated_out=OnePatternMeans(noise, mean),
        )


def _stacked(columns: list[Vector], shape: tuple[int, int]) -> Vector:
    """Columns side by side along a new first axis: (Q, J, W) per quantity."""
    stacked = []
    for parts in zip(*columns, strict=True):
        broadcast = [np.broadcast_to(part, shape) for part in parts]
        stacked.append(np.stack(broadcast))
    return tuple(stacked)


def _components(pieces: list[Vector]) -> list[Array]:
    """All components of all vectors."""
    components: list[Array] = []
    for piece in pieces:
        components += piece
    return components


def _squares(sd: Vector) -> Vector:
    return tuple(part * part for part in sd)


@dataclasses.dataclass(frozen=True, eq=False)
class _BetaGivenLatents:
    """beta = constant + columns xi + remainder, the remainder independent by environment."""

    columns: list[Array]  # (Q, J, W) per quantity
    constant: list[Array]  # (J, W) per quantity
    remainder: Block | None  # (J, W) Covariance of the remainder; None if there is none


class Regression:
    """Locations at W sets of scales: density of the pattern means, and the law of beta.

    Parameters
    ----------
    problem : LocationProblem
        Patterns and priors.
    scales : Scales
        At W sets of coordinates.
    cell_noise : list of Block
        Covariance of one subject's cell means about beta + u, by pattern, entries (E, W).
    merge : bool
        Whether one pattern's alpha and ubar share latents. The density is then cheaper, and a law
        of beta raises ValueError.

    Attributes
    ----------
    log_density : ndarray
        Of the pattern means, (W,), up to powers of 2 pi and of counts.
    """

    def __init__(
        self,
        problem: LocationProblem,
        scales: Scales,
        cell_noise: list[Block],
        *,
        merge: bool = False,
    ) -> None:
        self._scales = scales
        self._shape = (problem.environments, scales.log_prior.size)
        mergeable = len(cell_noise) == 1 and scales.shared is not None
        self._merged = merge and mergeable
        self._whitened = problem.whitened(scales, cell_noise, merge=merge)
        self._solved = factor(self._whitened.design, self._whitened.target)
        log_determinant = self._whitened.log_determinant + self._solved.log_determinant
        self.log_density = -0.5 * (log_determinant + self._solved.distance)

    @cached_property
    def _beta(self) -> _BetaGivenLatents:
        """Write beta by the latents.

        Several patterns have delta among the latents, and nothing remains. One pattern has
        delta | xi, z ~ N(tau² (noise + tau²)⁻¹ (z - columns xi), (noise⁻¹ + tau⁻²)⁻¹).
        """
        self._refuse_merged()
        shape = self._shape
        of_locations = _stacked(self._whitened.location_columns, shape)
        means = self._whitened.integrated_out
        if means is None or self._scales.tau is None:
            nothing = [np.zeros(shape) for _ in of_locations]
            return _BetaGivenLatents(list(of_locations), nothing, None)
        variances = _squares(self._scales.tau)
        pull = means.noise.plus_diagonal(variances).inverse()
        pulled_columns = pull.apply(_stacked(self._whitened.columns, shape))
        pulled_mean = pull.apply(means.mean)
        columns = []
        constant = []
        precisions = []
        for p, variance in enumerate(variances):
            columns.append(of_locations[p] - variance * pulled_columns[p])
            constant.append(variance * pulled_mean[p])
            precisions.append(np.broadcast_to(1.0 / variance, shape))
        precision = means.noise.inverse().plus_diagonal(tuple(precisions))
        return _BetaGivenLatents(columns, constant, precision.inverse())

    def _refuse_merged(self) -> None:
        """Refuse a law of latents that hold a subject effect as well."""
        if self._merged:
            raise ValueError("A merged regression gives no law of beta: build it without merge.")

    def _at_latents(self, latents: Array) -> Vector:
        """Beta without its remainder, (J, W), at latents (Q, W)."""
        beta = []
        for constant, columns in zip(self._beta.constant, self._beta.columns, strict=True):
            beta.append(constant + np.einsum("qjw,qw->jw", columns, latents))
        return tuple(beta)

    @cached_property
    def mean(self) -> Vector:
        """Conditional mean of beta, (J, W) per quantity."""
        return self._at_latents(self._solved.mean)

    @cached_property
    def _latent_columns(self) -> list[Array]:
        """Columns (Q, J, W) per quantity that the latents give to the covariance of beta."""
        return [self._solved.solve_transposed(columns) for columns in self._beta.columns]

    @cached_property
    def covariance(self) -> Block:
        """Conditional covariance of beta within each environment, entries (J, W)."""
        of_latents = gram(self._latent_columns)
        if self._beta.remainder is None:
            return of_latents
        return of_latents + self._beta.remainder

    def columns(self) -> Array:
        """Columns (R, P, J, W) whose outer products sum to the covariance of beta."""
        of_latents = np.stack(self._latent_columns, axis=1)
        if self._beta.remainder is None:
            return of_latents
        _, size, environments, width = of_latents.shape
        # Each environment has its own columns of the remainder.
        of_remainder = np.zeros((size, environments, size, environments, width))
        each = np.arange(environments)
        for k, column in enumerate(self._beta.remainder.factor_columns()):
            for p, part in enumerate(column):
                of_remainder[k, each, p, each] = part
        flat = of_remainder.reshape(-1, size, environments, width)
        return np.concatenate([of_latents, flat])

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw beta of all environments jointly, once per set of scales: (P, J, W)."""
        coefficients = self._solved.coefficients
        normals = rng.standard_normal(coefficients.shape)
        latents = self._solved.solve(coefficients + normals)
        beta = np.stack(self._at_latents(latents))
        if self._beta.remainder is not None:
            for column in self._beta.remainder.factor_columns():
                normals = rng.standard_normal(beta.shape[1:])
                beta += np.stack(column) * normals
        return beta

    def trend(self, rows: Array) -> tuple[Array, Array]:
        """Mean (L, W) and columns (Q, L, W) of rows (L, 2 P) of alpha and gamma over prior SDs."""
        self._refuse_merged()
        latents, width = self._solved.coefficients.shape
        combinations, count = rows.shape
        # The latents of alpha and gamma are the first ones.
        weights = np.zeros((latents, combinations, width))
        weights[:count] = rows.T[..., None]
        mean = rows @ self._solved.mean[:count]
        return mean, self._solved.solve_transposed(weights)
