"""The law that walkers would follow if a transport were perfect: a standard multivariate t."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_DF = 20.0  # tails a little heavier than normal: a proposal must not miss what the transport did


class Reference:
    """Multivariate t about zero with unit scale matrix."""

    def __init__(self, dimension: int) -> None:
        self.dimension = dimension
        self._constant = (
            math.lgamma(0.5 * (_DF + dimension))
            - math.lgamma(0.5 * _DF)
            - 0.5 * dimension * math.log(math.pi * _DF)
        )

    def log_density(self, points: Array) -> Array:
        """Log density at points of shape (N, d), shape (N,)."""
        square = np.einsum("nd,nd->n", points, points)
        return self._constant - 0.5 * (_DF + self.dimension) * np.log1p(square / _DF)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` points, shape (count, d)."""
        radius = np.sqrt(0.5 * _DF / rng.standard_gamma(0.5 * _DF, size=count))
        return radius[:, None] * rng.standard_normal((count, self.dimension))

    def turn(self, points: Array, rng: np.random.Generator) -> Array:
        """Turn points about zero by random angles, leaving the law invariant.

        A t law is normal given its radius: drawing the radius given the point and rotating towards
        a normal draw of that radius is reversible with respect to the law, at any angle.
        """
        count = len(points)
        square = np.einsum("nd,nd->n", points, points)
        gamma = rng.standard_gamma(0.5 * (_DF + self.dimension), size=count)
        radius = np.sqrt(0.5 * (_DF + square) / gamma)
        # Many small angles: in a far tail only short steps are accepted.
        angle = 0.5 * math.pi * rng.random(count) ** 2
        towards = (np.sin(angle) * radius)[:, None] * rng.standard_normal(points.shape)
        return np.cos(angle)[:, None] * points + towards
