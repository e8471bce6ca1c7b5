"""What a posterior gives per draw: normal laws of the locations, and the spread of users about them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Laws:
    """Per draw and cell (a parameter in an environment), on the response scale."""

    mean: Array  # (S, C)
    sd: Array  # (S, C)
    spread: Array  # (S, C) SD of the population about its mean

    def pack(self) -> Array:
        """Return all three side by side, shape (S, 3 C)."""
        return np.concatenate([self.mean, self.sd, self.spread], axis=1)

    @classmethod
    def unpack(cls, packed: Array) -> Laws:
        """Undo `pack`."""
        return cls(*np.split(packed, 3, axis=1))


class Model(Protocol):
    """A posterior over scales, with the locations integrated out."""

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""

    @property
    def cells(self) -> tuple[tuple[str, str], ...]:
        """(parameter, environment) of every cell, parameter-major."""

    @property
    def priors(self) -> Mapping[str, float]:
        """Priors in force, by their names in `Priors`; none under the reference prior."""

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""

    def laws(self, points: Array) -> Laws:
        """Laws of the locations at coordinates (W, d)."""

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw population means and new users, each (W, C), once per coordinates."""

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Named scales and correlations at coordinates: dimensions and values, draws first."""
