"""A target seen through a map: walkers live in coordinates where it resembles the reference law."""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.checked import Target
from percept.inference.sampling.transport import Transport

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Affine:
    """Linear map from standard coordinates."""

    centre: Array  # (d,) Where zero goes
    factor: Array  # (d, d) Lower factor of the covariance

    @classmethod
    def normal(cls, centre: Array, covariance: Array) -> Self:
        """Map standard coordinates to a given centre (d,) and covariance (d, d)."""
        # A ridge lets a thin sample be factored.
        ridge = 1e-10 * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
        return cls(centre, np.linalg.cholesky(covariance + ridge))

    @classmethod
    def fit(cls, points: Array, weights: Array) -> Self:
        """Fit to points (N, d) with weights (N,) that sum to one."""
        centre = weights @ points
        deviation = points - centre
        return cls.normal(centre, (weights[:, None] * deviation).T @ deviation)

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""
        log_determinant = np.log(np.diag(self.factor)).sum()
        return self.centre + z @ self.factor.T, np.full(len(z), log_determinant)


class Transported:
    """A target in the coordinates of a transport."""

    def __init__(self, target: Target, transport: Affine | Transport) -> None:
        self._target = target
        self.transport = transport

    @property
    def names(self) -> list[str]:
        """Names of the target's coordinates."""
        return self._target.names

    def map(self, z: Array) -> Array:
        """Take points to the target's coordinates."""
        return self.transport(z)[0]

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d) of the transport's coordinates, shape (W,)."""
        x, log_jacobian = self.transport(points)
        return self._target(x) + log_jacobian
