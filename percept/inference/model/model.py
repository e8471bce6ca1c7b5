"""What every model offers, to the sampler and to reports."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.laws import ConditionalMoments
from percept.inference.model.priors import Named

__all__ = ["MORE_ENVIRONMENTS", "ONE_ENVIRONMENT", "Model", "Resolution"]

Array = NDArray[np.float64]

ONE_ENVIRONMENT = "one environment shows no trend to predict others from."
MORE_ENVIRONMENTS = "Add sessions with more reference environments."


@dataclasses.dataclass(frozen=True)
class Resolution:
    """Variance that a finite resolution of the adjustment adds, on the response scale."""

    between: Array | None = None  # (P, J)
    trial: Array | None = None  # (P, J)


class Model(ABC):
    """A posterior over scales, its locations integrated out: what sampler and reports need of it.

    Coordinates are (W, d), near standard normal under the prior. Cells are parameter-major.
    """

    names: list[str]  # Of the coordinates
    cells: tuple[tuple[str, str], ...]  # Parameter and environment
    priors_in_force: dict[str, float]  # By their names in `Priors`
    takes_options: bool = True  # Whether `Options` make it simpler

    @abstractmethod
    def identity(self) -> tuple[object, ...]:
        """Everything that decides density and locations: a posterior is found again by it."""

    @abstractmethod
    def __call__(self, points: Array) -> Array:
        """Log density at coordinates (W, d), up to a constant, shape (W,)."""

    @abstractmethod
    def laws(self, points: Array) -> ConditionalMoments:
        """Law of the locations and of users at coordinates (W, d)."""

    @abstractmethod
    def scales(self, points: Array) -> Named:
        """Scales and correlations by name, as dimensions and values, at coordinates (W, d)."""

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the locations and a new user of every cell, each (W, C)."""
        return self.laws(points).draw(rng)
