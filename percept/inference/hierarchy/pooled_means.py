"""Pooling of the patterns' means within each environment, without subtraction.

For means z_g with precisions P_g about a common value, z splits into the weighted mean
zbar = K⁻¹ sum_g P_g z_g, K = sum_g P_g, whose covariance about that value is K⁻¹, and the deviations
z_g - zbar. Squares of both, whitened, sum to the whole; the determinant is prod |P_g⁻¹| |K|.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Precision, Vector, join, weighted_mean
from percept.inference.hierarchy.statistics import Pattern

Array = NDArray[np.float64]


class PooledMeans:
    """Means of all patterns pooled within environments, for W sets of scales."""

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
