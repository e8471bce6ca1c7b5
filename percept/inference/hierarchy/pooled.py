"""The hierarchical model of one study, ready to sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.conditional import Conditional
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.laws import Laws
from percept.inference.hierarchy.prior_density import draws_first
from percept.inference.hierarchy.scales import Scales

Array = NDArray[np.float64]


class Pooled:
    """Environments and subjects partially pooled."""

    def __init__(self, density: CollapsedDensity) -> None:
        self.density = density
        statistics = density.statistics
        self.cells = tuple((p, e) for p in statistics.parameters for e in statistics.environments)

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return self.density.names

    @property
    def priors(self) -> dict[str, float]:
        """Priors in force, by name."""
        return self.density.layout.priors_in_force

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        return self.density(points)

    def laws(self, points: Array) -> Laws:
        """Laws of beta and spread of the population at coordinates (W, d)."""
        return Laws.unpack(np.concatenate([self._laws(part) for part in self._passes(points)]))

    def _passes(self, points: Array) -> list[Array]:
        most = self.density.draws_per_pass
        return [points[i : i + most] for i in range(0, len(points), most)]

    def _laws(self, points: Array) -> Array:
        return Conditional(self.density, self._scales(points)).laws.pack()

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw beta of all cells jointly and one new user of each environment, each (W, C)."""
        means, users = zip(*(self._draw(part, rng) for part in self._passes(points)), strict=True)
        return np.concatenate(means), np.concatenate(users)

    def _draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        law = Conditional(self.density, self._scales(points))
        beta = law.draw(rng)
        user = beta.copy()
        for column in law.population.factor_columns():
            user += np.stack(column) * rng.standard_normal(beta.shape[1:])
        return beta.reshape(-1, len(points)).T, user.reshape(-1, len(points)).T

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Named scales and correlations at coordinates: dimensions and values, draws first."""
        return draws_first(self._scales(points).named)

    def _scales(self, points: Array) -> Scales:
        return self.density.layout.scales(np.ascontiguousarray(points.T))
