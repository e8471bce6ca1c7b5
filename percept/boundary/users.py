"""Populations of users: normal laws of (k, b), or of their logarithms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.haptics.plane import Boxes

__all__ = ["DAMPING", "LEAST", "STIFFNESS", "Users"]

Array = NDArray[np.float64]

#: Rows of a population's mean and SD.
STIFFNESS = 0
DAMPING = 1
#: Logarithms of a stiffness or damping of zero, and below: no user is there.
LEAST = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class Users:
    """Populations of users, one per draw (D,); stiffness first, damping second.

    The mean and the SD are of the logarithms where `log` is true, else in N/m and N·s/m.
    """

    log: bool
    mean: Array  # (2, D)
    sd: Array  # (2, D)
    correlation: Array  # (D,)

    @classmethod
    def of(
        cls,
        mean: Array,
        covariance: Array,
        *,
        log: bool,
    ) -> Users:
        """Take means (D, 2) and covariances (D, 2, 2)."""
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        sd = np.sqrt(variance)
        correlation = covariance[:, 0, 1] / sd.prod(axis=1)
        return cls(log=log, mean=mean.T, sd=sd.T, correlation=correlation)

    @property
    def size(self) -> int:
        """Number of populations, D."""
        return self.correlation.size

    def select(self, which: NDArray[np.intp] | slice | None) -> Users:
        """Return some of the populations."""
        return Users(
            log=self.log,
            mean=self.mean[..., which],
            sd=self.sd[..., which],
            correlation=self.correlation[..., which],
        )

    def column(self) -> Users:
        """Return the same with a last axis of one, which frequencies broadcast against."""
        return self.select(None)

    def score(self, value: float | Array, quantity: int) -> Array:
        """Return how many SDs a stiffness (0) or damping (1) lies above the mean, (D,)."""
        if self.log:
            value = np.log(np.maximum(value, LEAST))
        return np.asarray((value - self.mean[quantity]) / self.sd[quantity])

    def native(self, score: float, quantity: int) -> Array:
        """Return the stiffness (0) or damping (1) that lies `score` SDs from the mean, (D,)."""
        distance = score * self.sd[quantity]
        value = self.mean[quantity] + distance
        return np.exp(value) if self.log else value

    def central_ranges(self, level: float) -> Boxes:
        """Return the limits between which the central `level` of stiffness and of damping lie."""
        tail = 0.5 * (1.0 - level)
        edge = float(-special.ndtri(tail))
        softest = self.native(-edge, STIFFNESS)
        stiffest = self.native(edge, STIFFNESS)
        least_damped = self.native(-edge, DAMPING)
        most_damped = self.native(edge, DAMPING)
        return Boxes.of((softest, stiffest), (least_damped, most_damped))
