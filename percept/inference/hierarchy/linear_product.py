"""Product of linear designs of different quantities, as one posterior."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from percept.inference.hierarchy.models import Product

__all__ = ["LinearProduct"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class _Share:
    """One model of a product, with its shares of weights and coordinates."""

    model: LinearPosterior
    rows: Array  # (L, R of the model)
    points: Array  # (W, d of the model)


class LinearProduct(Product):
    """Product of independent linear models of different quantities.

    Locations of the models stand in a row, in the order of the models, and so do weights. A
    combination of all locations is the sum of one combination in each model.
    """

    def __init__(self, models: Sequence[LinearPosterior]) -> None:
        super().__init__(models)
        self.linear_parts = tuple(models)

    def laws_of(self, rows: Array, points: Array) -> ConditionalMoments:
        """Law of linear combinations of all locations, (L, R), as `LinearModel.laws_of`."""
        laws = []
        for share in self._shares(rows, points):
            laws.append(share.model.laws_of(share.rows, share.points))
        variances = [law.sd**2 for law in laws]
        populations = [law.population_sd**2 for law in laws]
        return ConditionalMoments(
            mean=np.sum([law.mean for law in laws], axis=0),
            sd=np.sqrt(np.sum(variances, axis=0)),
            population_sd=np.sqrt(np.sum(populations, axis=0)),
        )

    def log_user_sds(self, rows: Array, points: Array) -> Array:
        """Log SDs of one user's own combinations at coordinates (W, d), shape (W, L)."""
        log_variances = []
        # A combination may have no weights in a model: its variance there is zero.
        with np.errstate(divide="ignore"):
            for share in self._shares(rows, points):
                log_sds = share.model.log_user_sds(share.rows, share.points)
                log_variances.append(2.0 * log_sds)
        return np.asarray(0.5 * np.logaddexp.reduce(log_variances, axis=0))

    def draw_of(
        self, rows: Array, points: Array, rng: np.random.Generator, *, repeats: int = 1
    ) -> tuple[Array, Array]:
        """Draw combinations of all locations, as `LinearPosterior.draw_of`."""
        locations = []
        users = []
        for share in self._shares(rows, points):
            location, user = share.model.draw_of(share.rows, share.points, rng, repeats=repeats)
            locations.append(location)
            users.append(user)
        return np.sum(locations, axis=0), np.sum(users, axis=0)

    def _shares(self, rows: Array, points: Array) -> list[_Share]:
        """Split weights and coordinates by model."""
        counts = [model.locations_count for model in self.linear_parts]
        starts = np.cumsum(counts)[:-1]
        weights = np.split(rows, starts, axis=1)
        coordinates = [part for _, part in self._split(points)]
        shares = zip(self.linear_parts, weights, coordinates, strict=True)
        return [_Share(*parts) for parts in shares]
