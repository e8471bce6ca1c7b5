"""Product of linear designs of different quantities, as one posterior.

Locations and coordinates of the models stand one after another, and so do the R weights of a
combination. A combination of all locations is then the sum of one combination in each model. The
models are independent, so means and variances add.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from percept.inference.hierarchy.models import Product, split_columns

__all__ = ["LinearProduct"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class _Share:
    """What one model of the product is asked: L combinations at W sets of coordinates."""

    model: LinearPosterior
    rows: Array  # (L, R of the model) Weights of its locations
    points: Array  # (W, d of the model) Its coordinates


class LinearProduct(Product):
    """Product of independent linear models of different quantities.

    Parameters
    ----------
    models : sequence of LinearPosterior
        Of one quantity or two each.
    """

    def __init__(self, models: Sequence[LinearPosterior]) -> None:
        super().__init__(models)
        self.linear_parts = tuple(models)

    def _shares(self, rows: Array, points: Array) -> list[_Share]:
        """Split weights (L, R) and coordinates (W, d) by model."""
        models = self.linear_parts
        weights = split_columns(rows, [model.locations_count for model in models])
        coordinates = split_columns(points, [len(model.names) for model in models])
        shares = []
        for m, model in enumerate(models):
            shares.append(_Share(model, weights[m], coordinates[m]))
        return shares

    def laws_of(self, rows: Array, points: Array) -> ConditionalMoments:
        """Law of linear combinations of all locations, (L, R), as `LinearModel.laws_of`."""
        means = []
        variances = []
        population_variances = []
        for share in self._shares(rows, points):
            law = share.model.laws_of(share.rows, share.points)
            means.append(law.mean)
            variances.append(law.sd**2)
            population_variances.append(law.population_sd**2)
        variance = np.sum(variances, axis=0)
        population_variance = np.sum(population_variances, axis=0)
        return ConditionalMoments(
            mean=np.sum(means, axis=0),
            sd=np.sqrt(variance),
            population_sd=np.sqrt(population_variance),
        )

    def log_user_sds(self, rows: Array, points: Array) -> Array:
        """Log SDs of one user's combinations about the locations', at (W, d): shape (W, L)."""
        log_variances = []
        # A combination may have no weights in a model: its variance there is zero.
        with np.errstate(divide="ignore"):
            for share in self._shares(rows, points):
                log_sds = share.model.log_user_sds(share.rows, share.points)
                log_variances.append(2.0 * log_sds)
        log_variance = np.logaddexp.reduce(log_variances, axis=0)
        return np.asarray(0.5 * log_variance)

    def draw_of(
        self,
        rows: Array,
        points: Array,
        rng: np.random.Generator,
        *,
        repeats: int = 1,
    ) -> tuple[Array, Array]:
        """Draw combinations of all locations, as `LinearPosterior.draw_of`."""
        locations = []
        users = []
        for share in self._shares(rows, points):
            drawn = share.model.draw_of(share.rows, share.points, rng, repeats=repeats)
            locations.append(drawn[0])
            users.append(drawn[1])
        return np.sum(locations, axis=0), np.sum(users, axis=0)
