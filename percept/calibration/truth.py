"""What is true of a simulated study, in the terms of the intervals and curves that claim to hold it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.simulate.model import TrueValues

Array = NDArray[np.float64]
Family = Literal["lognormal", "normal"]
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(64)
_PARAMETERS = ("k", "b")


@dataclass(frozen=True, eq=False)
class Population:
    """Users of one environment: points of equality, without trial noise."""

    family: Family  # Distribution of the users
    reference: Array  # (P,) N/m and N·s/m
    mean: Array  # (P,) On the response scale
    covariance: Array  # (P, P) On the response scale

    @property
    def sd(self) -> Array:
        """SD per parameter on the response scale."""
        return np.sqrt(np.diagonal(self.covariance))

    def native(self, response: Array) -> Array:
        """Responses (..., P) in N/m and N·s/m."""
        with np.errstate(over="ignore", under="ignore"):
            ratio = np.exp(response) if self.family == "lognormal" else 1.0 + response
            return self.reference * ratio

    def below(self, p: int, value: float) -> float:
        """Return the share of users whose parameter p lies below a value, N/m or N·s/m."""
        if self.family == "normal":
            response = value / self.reference[p] - 1.0
        elif value > 0:
            response = float(np.log(value / self.reference[p]))
        else:
            return 0.0
        return float(special.ndtr((response - self.mean[p]) / self.sd[p]))

    def content(self, p: int, lower: float, upper: float) -> float:
        """Return the share of users whose parameter p lies between limits."""
        return self.below(p, upper) - self.below(p, lower)

    def average(self, family: Family) -> Array:
        """Return what intervals of kind mean are about, N/m and N·s/m, by the family of the interval."""
        if self.family == "lognormal":
            return self.native(self.mean + (0.5 * self.sd**2 if family == "normal" else 0.0))
        if family == "normal":
            return self.native(self.mean)
        values = self.native(self.mean + self.sd * _NODES[:, None])
        kept = np.where(values > 0, _WEIGHTS[:, None], 0.0)
        logs = np.log(np.where(values > 0, values, 1.0))
        return np.exp((kept * logs).sum(axis=0) / kept.sum(axis=0))

    def users(self, count: int, rng: np.random.Generator) -> Array:
        """Draw users, (count, P), N/m and N·s/m."""
        return self.native(rng.multivariate_normal(self.mean, self.covariance, count, method="eigh"))


def populations_of(truth: TrueValues, references: Array, family: Family) -> list[Population]:
    """Put together the users of every environment."""
    return [
        Population(family, reference, beta, truth.cov_u + cov_w)
        for reference, beta, cov_w in zip(references, truth.beta, truth.cov_w, strict=True)
    ]
