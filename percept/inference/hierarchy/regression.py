"""Locations by regression, orthogonally: for studies of few patterns of counts, and for scales of any size.

Cell means of pattern g in environment j are z_gj = beta_j + ubar_g + noise with beta_j = alpha + gamma x_j
+ delta_j. Either the environments' own biases delta_j are summed out and the patterns' mean subject effects
ubar_g kept as latents, or the other way round. With a single pattern alpha and ubar enter only as their
sum, so they merge.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import (
    Block,
    Precision,
    SharedCovariance,
    Vector,
    gram,
    join,
    weighted_mean,
)
from percept.inference.hierarchy.least_squares import factor
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Layout, Scales
from percept.inference.hierarchy.statistics import Pattern, Statistics

Array = NDArray[np.float64]


class PooledMeans:
    """Means of all patterns pooled within environments, for W sets of scales, without subtraction.

    For means z_g with precisions P_g about a common value, z splits into the weighted mean zbar = K⁻¹ sum_g
    P_g z_g, K = sum_g P_g, whose covariance about that value is K⁻¹, and the deviations z_g - zbar. Squares
    of both, whitened, sum to the whole; the determinant is prod |P_g⁻¹| |K|.
    """

    def __init__(self, patterns: Sequence[Pattern], noises: Sequence[Block], environments: int) -> None:
        self._patterns = patterns
        width = noises[0].diagonal()[0].shape[-1]
        self._environments, self._width = environments, width
        if len(patterns) == 1:
            self.mean: Vector = tuple(
                np.broadcast_to(m[:, None], (environments, width)) for m in patterns[0].mean
            )
            self.spread: Block = noises[0]
            self.log_determinant = np.zeros(width)
            self._noise: dict[tuple[int, int], Block] = {}
            self._sources: list[list[int]] = [[0] for _ in range(environments)]
            return
        self._noise = {
            (g, j): noise[i]
            for g, (pattern, noise) in enumerate(zip(patterns, noises, strict=True))
            for i, j in enumerate(pattern.environments.tolist())
        }
        self._value = {
            (g, j): pattern.mean[:, i]
            for g, pattern in enumerate(patterns)
            for i, j in enumerate(pattern.environments.tolist())
        }
        self._sources = [[] for _ in range(environments)]
        for g, j in self._noise:
            self._sources[j].append(g)
        self.log_determinant = np.zeros(width)
        self._precisions: dict[int, Precision] = {}
        spreads, means = [], []
        for j, sources in enumerate(self._sources):
            spread, mean = self._pool(j, sources)
            spreads.append(spread)
            means.append(mean)
        self.spread = join(spreads)
        self.mean = tuple(np.stack(component) for component in zip(*means, strict=True))

    def _pool(self, j: int, sources: list[int]) -> tuple[Block, Vector]:
        values = [self._constant(self._value[g, j]) for g in sources]
        if len(sources) == 1:
            return self._noise[sources[0], j], values[0]
        parts = join([self._noise[g, j] for g in sources]).inverse()
        precision = parts.total()
        self._precisions[j] = precision
        self.log_determinant = self.log_determinant + precision.log_determinant()
        for g in sources:
            self.log_determinant = self.log_determinant + self._noise[g, j].log_determinant()
        # Weighted about the first value, so that a common offset does not enter the products.
        origin = values[0]
        apart = tuple(
            np.stack([v - o for v in component])
            for component, o in zip(zip(*values, strict=True), origin, strict=True)
        )
        shift = weighted_mean(parts, precision, apart)
        return precision.inverse(), tuple(o + s for o, s in zip(origin, shift, strict=True))

    def _constant(self, value: Array) -> Vector:
        return tuple(np.full(self._width, component) for component in value)

    def _contested(self) -> list[tuple[int, int]]:
        """(pattern, environment) wherever several patterns meet: only there are deviations not zero."""
        return [(g, j) for j, sources in enumerate(self._sources) if len(sources) > 1 for g in sources]

    @property
    def deviations(self) -> list[Vector]:
        """Whitened deviations z_g - zbar where several patterns meet."""
        return [
            self._noise[g, j].whiten(
                tuple(v - m[j] for v, m in zip(self._value[g, j], self.mean, strict=True))
            )
            for g, j in self._contested()
        ]

    def effect_on_mean(self, g: int, effect: Vector) -> Vector:
        """Share of a vector added to pattern g's means in the pooled means, entries (J, W)."""
        shares = []
        for j, sources in enumerate(self._sources):
            if g not in sources:
                shares.append(tuple(np.zeros(self._width) for _ in effect))
            elif len(sources) == 1:
                shares.append(effect)
            else:
                own = self._noise[g, j].inverse()
                shares.append(weighted_mean(own, self._precisions[j], effect, axis=None))
        return tuple(np.stack(component) for component in zip(*shares, strict=True))

    def effect_on_deviations(self, g: int, effect: Vector) -> list[Vector]:
        """Whitened change of `deviations` when a vector is added to pattern g's means."""
        on_mean = self.effect_on_mean(g, effect)
        return [
            self._noise[h, j].whiten(
                tuple((e if h == g else 0.0) - m[j] for e, m in zip(effect, on_mean, strict=True))
            )
            for h, j in self._contested()
        ]


@dataclasses.dataclass(frozen=True, eq=False)
class Whitened:
    """A regression on standard normal latents with unit noise, and how beta follows from it."""

    design: Array  # (q, M, W) Columns of the whitened design
    target: Array  # (M, W) Whitened pattern means
    log_determinant: Array  # (W,) log det of the noise covariance that was whitened away
    columns: list[Vector]  # What each latent adds to the pooled means, per parameter
    locations: list[Vector]
    pooled: PooledMeans | None  # The pooled means, where the environments' own biases were summed out


class LocationProblem:
    """Builds the regression of the pattern means on the locations."""

    def __init__(self, statistics: Statistics, layout: Layout, priors: Priors) -> None:
        self._patterns = statistics.patterns
        self._size = layout.parameters
        self._environments = layout.environments
        self._trend = layout.trend
        self._subject_effect = layout.subject_effect
        self._alpha_sd = priors.alpha_sd
        self._trend_columns = _trend_columns(statistics.x, layout, priors)
        #: Columns (Q, P, J) of alpha and gamma, times their prior SDs.
        self.trend = np.array([[part[:, 0] for part in column] for column in self._trend_columns])
        effects = len(self._patterns) if self._subject_effect else 0
        self.merged = effects == 1
        self.by_environment = self._trend and 1 < effects >= self._environments

    def build(self, scales: Scales, cells: list[Block], *, merge: bool = True) -> Whitened:
        """Whiten the pattern means and the design of the latents."""
        if self.by_environment:
            return self._keeping_biases(scales, cells)
        return self._keeping_effects(scales, cells, merge=merge and self.merged)

    def _noise(self, cells: list[Block]) -> list[Block]:
        """Covariance of each pattern's mean about its mean subject effect, entries (E, W)."""
        return [
            cell.scaled(1.0 / pattern.subjects) for cell, pattern in zip(cells, self._patterns, strict=True)
        ]

    def _keeping_biases(self, scales: Scales, cells: list[Block]) -> Whitened:
        width = scales.log_prior.size
        tau = scales.tau
        assert tau is not None
        assert scales.shared is not None
        shape = (self._environments, width)
        columns = list(self._trend_columns)
        for j in range(self._environments):
            at = (np.arange(self._environments) == j)[:, None]
            columns += [_unit(self._size, p, at * tau[p]) for p in range(self._size)]
        stacked = stack_columns(columns, shape)
        targets: list[Array] = []
        designs: list[Array] = []
        log_determinant = np.zeros(width)
        for pattern, noise in zip(self._patterns, self._noise(cells), strict=True):
            covariance = SharedCovariance(noise, scales.shared.scaled(1.0 / pattern.subjects))
            log_determinant += covariance.log_determinant()
            mean = tuple(np.broadcast_to(m[:, None], (m.size, width)) for m in pattern.mean)
            targets += _flatten(covariance.whiten(mean))
            part = tuple(c[:, pattern.environments] for c in stacked)
            designs += _by_column(covariance.whiten(part), len(columns))
        design = np.concatenate(designs, axis=1)
        return Whitened(design, np.concatenate(targets), log_determinant, columns, columns, None)

    def _keeping_effects(self, scales: Scales, cells: list[Block], *, merge: bool) -> Whitened:
        width = scales.log_prior.size
        pooled = PooledMeans(self._patterns, self._noise(cells), self._environments)
        spread = pooled.spread
        if scales.tau is not None:
            spread = spread.plus_diagonal(tuple(tau * tau for tau in scales.tau))
        shape = (self._environments, width)
        columns = list(self._trend_columns)
        deviations = _flatten(pooled.deviations)
        rows = [[np.zeros((len(deviations), width))] for _ in columns]
        if scales.shared is not None and merge:
            subjects = self._patterns[0].subjects
            prior = scales.shared.scaled(1.0 / subjects).plus_diagonal(
                (np.array(self._alpha_sd**2),) * self._size
            )
            columns[: self._size] = prior.factor_columns()
        elif scales.shared is not None:
            for g, pattern in enumerate(self._patterns):
                for effect in scales.shared.scaled(1.0 / pattern.subjects).factor_columns():
                    columns.append(pooled.effect_on_mean(g, effect))
                    rows.append(_flatten(pooled.effect_on_deviations(g, effect)))
        whitened = spread.whiten(stack_columns([*columns, pooled.mean], shape))
        both = np.concatenate(_by_column([whitened], len(columns) + 1), axis=1)
        design, target = both[:-1], both[-1]
        if deviations:
            design = np.concatenate([design, np.stack([np.concatenate(row) for row in rows])], axis=1)
            target = np.concatenate([target, *deviations])
        log_determinant = pooled.log_determinant + spread.log_determinant().sum(axis=0)
        return Whitened(design, target, log_determinant, columns, self._trend_columns, pooled)


def stack_columns(columns: list[Vector], shape: tuple[int, int]) -> Vector:
    """Stack columns along a new first axis."""
    stacked = tuple(np.empty((len(columns), *shape)) for _ in columns[0])
    for i, column in enumerate(columns):
        for rows, part in zip(stacked, column, strict=True):
            rows[i] = part
    return stacked


def _unit(size: int, p: int, value: Array | float) -> Vector:
    """Vector of `size` parameters with a value at parameter `p`."""
    return tuple(np.asarray(value) if q == p else np.zeros_like(value) for q in range(size))


def _trend_columns(x: Array, layout: Layout, priors: Priors) -> list[Vector]:
    """Columns of alpha and gamma over environments, before whitening, entries (J, 1)."""
    size = layout.parameters
    columns = [_unit(size, p, np.full((layout.environments, 1), priors.alpha_sd)) for p in range(size)]
    if layout.trend:
        columns += [_unit(size, p, priors.gamma_sd * x[p][:, None]) for p in range(size)]
    return columns


def _flatten(pieces: list[Vector]) -> list[Array]:
    """Rows of every component of every piece, each of shape (rows, W)."""
    return [np.reshape(c, (-1, c.shape[-1])) for piece in pieces for c in piece]


def _by_column(pieces: list[Vector], columns: int) -> list[Array]:
    """Rows of every component of every piece for each column, each of shape (columns, rows, W)."""
    return [np.reshape(c, (columns, -1, c.shape[-1])) for piece in pieces for c in piece]


class Regression:
    """Locations at W sets of scales: the density of the patterns' means, and on demand the law of beta."""

    def __init__(self, problem: Whitened, scales: Scales, environments: int) -> None:
        self._problem, self._scales = problem, scales
        self._shape = environments, scales.log_prior.size
        self._solved = factor(problem.design, problem.target)
        self.log_density = -0.5 * (
            problem.log_determinant + self._solved.log_determinant + self._solved.distance
        )

    @cached_property
    def _on_latents(self) -> tuple[list[Array], list[Array], Block | None]:
        """Columns of beta on the latents (Q, J, W) per parameter, what does not depend on them, and the
        covariance of each environment's own part.
        """  # noqa: D205
        problem, scales, shape = self._problem, self._scales, self._shape
        columns = list(stack_columns(problem.locations, shape))
        constant = [np.zeros(shape) for _ in columns]
        extra = len(problem.columns) - len(problem.locations)
        if extra:
            columns = [np.concatenate([rows, np.zeros((extra, *shape))]) for rows in columns]
        if problem.pooled is None or scales.tau is None:
            return columns, constant, None
        variances = tuple(tau * tau for tau in scales.tau)
        pull = problem.pooled.spread.plus_diagonal(variances).inverse()
        for q, column in enumerate(problem.columns):
            change = pull.apply(tuple(np.broadcast_to(c, shape) for c in column))
            for rows, variance, part in zip(columns, variances, change, strict=True):
                rows[q] -= variance * part
        pulled = pull.apply(problem.pooled.mean)
        constant = [variance * part for variance, part in zip(variances, pulled, strict=True)]
        inverse = tuple(np.broadcast_to(1.0 / variance, shape) for variance in variances)
        return columns, constant, problem.pooled.spread.inverse().plus_diagonal(inverse).inverse()

    def _of_latents(self, latents: Array) -> Vector:
        columns, constant, _ = self._on_latents
        return tuple(
            c + np.einsum("qjw,qw->jw", rows, latents) for c, rows in zip(constant, columns, strict=True)
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
        """Columns (R, P, J, W) whose outer products sum to the covariance of beta over all cells."""
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
        """Mean (R, W) and columns (Q, R, W) of rows (R, 2 P) of alpha and gamma over their prior SDs."""
        count, width = self._solved.coefficients.shape
        padded = np.zeros((count, len(rows), width))
        padded[: rows.shape[1]] = rows.T[..., None]
        return rows @ self._solved.mean[: rows.shape[1]], self._solved.solve_transposed(padded)
