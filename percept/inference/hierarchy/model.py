"""What every model offers, to the sampler and to reports."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.laws import (
    ConditionalMoments,
    NewEnvironment,
    PairLaws,
    PriorDraws,
    SubjectLaws,
    TrendLaw,
)
from percept.inference.hierarchy.priors import Named, Priors
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["MORE_ENVIRONMENTS", "ONE_ENVIRONMENT", "Model", "Pooled", "Resolution"]

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

    def pooled_parts(self, points: Array) -> list[tuple[Pooled, Array]]:
        """Pooled densities whose product the model is, each with its coordinates."""
        return []


class Pooled(Model):
    """A model of one or two quantities that subjects and environments share."""

    statistics: Statistics
    priors: Priors

    def pooled_parts(self, points: Array) -> list[tuple[Pooled, Array]]:
        """Return itself."""
        return [(self, points)]

    @abstractmethod
    def pairs(self, points: Array) -> PairLaws:
        """Joint law of both quantities in each environment, at coordinates (W, d)."""

    @abstractmethod
    def trends(self, points: Array) -> dict[str, TrendLaw]:
        """Law of bias over decades of the reference at coordinates (W, d).

        By the levels of all factors; without factors there is one, with an empty name.
        RefusalError with one environment.
        """

    @property
    @abstractmethod
    def trial_group(self) -> NDArray[np.intp]:
        """Group of trials of every subject in every environment, (N, J)."""

    @abstractmethod
    def subject_laws(self, points: Array) -> SubjectLaws:
        """Say what coordinates (W, d) tell of every subject's cell means."""

    @abstractmethod
    def draw_prior(self, draws: int, rng: np.random.Generator) -> PriorDraws:
        """Draw scales, population means and new users before any data."""

    def draw_subject_effects(
        self, points: Array, locations: Array, rng: np.random.Generator
    ) -> Array | None:
        """Draw what every subject adds to all environments, (W, N, P); None if they differ."""
        return None

    @abstractmethod
    def new_environment(
        self, points: Array, x: Array, repeats: int, rng: np.random.Generator
    ) -> dict[str, NewEnvironment]:
        """Laws of an untested environment, as the function `new_environment`."""
