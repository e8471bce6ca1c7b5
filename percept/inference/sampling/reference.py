"""The law that a good transport gives the target: a multivariate t, a little heavier than normal."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["ReferenceLaw"]

Array = NDArray[np.float64]

#: Tails a little heavier than normal: a proposal must not miss what the transport did. There are as
#: many degrees of freedom as dimensions, or the radius alone would tell the law from a normal one.
_FEWEST_DF = 20.0


class ReferenceLaw:
    """Multivariate t about zero with unit scale matrix."""

    def __init__(self, dimension: int) -> None:
        self.dimension = dimension
        self._df = max(_FEWEST_DF, float(dimension))
        self._total_df = self._df + dimension
        self._log_constant = (
            math.lgamma(0.5 * self._total_df)
            - math.lgamma(0.5 * self._df)
            - 0.5 * dimension * math.log(math.pi * self._df)
        )

    def log_density(self, points: Array) -> Array:
        """Log density at points of shape (N, d), shape (N,)."""
        square = np.einsum("nd,nd->n", points, points)
        return self._log_constant - 0.5 * self._total_df * np.log1p(square / self._df)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` points, shape (count, d)."""
        gamma = rng.standard_gamma(0.5 * self._df, size=count)
        radius = np.sqrt(0.5 * self._df / gamma)
        return radius[:, None] * rng.standard_normal((count, self.dimension))

    def rotate(self, points: Array, rng: np.random.Generator) -> Array:
        """Rotate points about zero by random angles, leaving the law invariant.

        A t law is normal given its radius. Drawing the radius given the point and rotating towards
        a normal draw of that radius is reversible with respect to the law, at any angle.
        """
        count = len(points)
        square = np.einsum("nd,nd->n", points, points)
        gamma = rng.standard_gamma(0.5 * self._total_df, size=count)
        radius = np.sqrt(0.5 * (self._df + square) / gamma)
        # Many small angles: in a far tail only short steps are accepted.
        angle = 0.5 * math.pi * rng.random(count) ** 2
        sine = (np.sin(angle) * radius)[:, None]
        towards = sine * rng.standard_normal(points.shape)
        return np.cos(angle)[:, None] * points + towards
