"""Locations given the scales: one Gaussian regression, in the smaller of two exact forms.

Cell means of pattern g in environment j are z_gj = beta_j + ubar_g + noise with
beta_j = alpha + gamma x_j + delta_j. Either the environments' own biases delta_j are summed out and
the patterns' mean subject effects ubar_g kept as latents, or the other way round; whichever leaves
fewer latents. With a single pattern alpha and ubar enter only as their sum, so they merge.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector
from percept.inference.hierarchy.covariance import SharedCovariance
from percept.inference.hierarchy.pooled_means import PooledMeans
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Layout, Scales
from percept.inference.hierarchy.statistics import Statistics

Array = NDArray[np.float64]


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
        self._x = statistics.x
        self._size = layout.parameters
        self._environments = layout.environments
        self._trend = layout.trend
        self._subject_effect = layout.subject_effect
        self._alpha_sd = priors.alpha_sd
        self._trend_columns = _trend_columns(statistics.x, layout, priors)
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
