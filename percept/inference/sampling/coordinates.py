"""A log density to sample, and the same density in other coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError

__all__ = ["Affine", "Target", "Transported", "describe_point"]

Array = NDArray[np.float64]

#: Ridge on a covariance, of its mean variance, that lets a thin sample be factored.
_RIDGE = 1e-10
#: Coordinates that a message names.
_MOST_NAMED = 4


class Target(Protocol):
    """A log density to sample."""

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), shape (W,); -inf allowed, NaN not."""


class CoordinateMap(Protocol):
    """A smooth map from standard coordinates to a target's."""

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""


def describe_point(names: list[str], point: Array) -> str:
    """Write out the four coordinates farthest from zero, in order."""
    by_size = np.argsort(-np.abs(point))
    extreme = sorted(by_size[:_MOST_NAMED].tolist())
    return ", ".join(f"{names[i]} = {point[i]:.6g}" for i in extreme)


@dataclass(frozen=True, eq=False)
class Affine:
    """Linear map from standard coordinates."""

    centre: Array  # (d,) Where zero goes
    factor: Array  # (d, d) Lower factor of the covariance

    @classmethod
    def normal(cls, centre: Array, covariance: Array) -> Self:
        """Map standard coordinates to a given centre (d,) and covariance (d, d)."""
        size = len(covariance)
        ridge = _RIDGE * np.trace(covariance) / size * np.eye(size)
        return cls(centre, np.linalg.cholesky(covariance + ridge))

    @classmethod
    def fit(cls, points: Array, weights: Array) -> Self:
        """Fit to points (N, d) with weights (N,) that sum to one."""
        centre = weights @ points
        deviation = points - centre
        weighted = weights[:, None] * deviation
        return cls.normal(centre, weighted.T @ deviation)

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""
        log_determinant = np.log(np.diag(self.factor)).sum()
        points = self.centre + z @ self.factor.T
        return points, np.full(len(z), log_determinant)


class Transported:
    """A target in the coordinates of a map, whose values are never NaN."""

    def __init__(self, target: Target, transport: CoordinateMap) -> None:
        self._target = target
        self._transport = transport

    @property
    def names(self) -> list[str]:
        """Names of the target's coordinates."""
        return self._target.names

    def map(self, z: Array) -> Array:
        """Take points to the target's coordinates."""
        points, _ = self._transport(z)
        return points

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d) of the map's coordinates, shape (W,)."""
        mapped, log_jacobian = self._transport(points)
        values = self._target(mapped)
        invalid = np.isnan(values)
        if invalid.any():
            first = int(np.argmax(invalid))
            where = describe_point(self.names, mapped[first])
            raise RefusalError(f"the log density is NaN at {where}.")
        return values + log_jacobian
