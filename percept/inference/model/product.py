"""Independent models of different quantities, as one posterior."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.laws import ConditionalMoments
from percept.inference.model.linear_posterior import LinearPosterior
from percept.inference.model.model import Model
from percept.inference.model.priors import Named

__all__ = ["Product", "linear_parts", "pooled_parts"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class _Share:
    """What one model of the product is asked: L combinations at W sets of coordinates."""

    model: LinearPosterior
    rows: Array  # (L, R of the model) Weights of its locations
    points: Array  # (W, d of the model) Its coordinates


class Product(Model):
    """Product of independent models of different quantities.

    Coordinates, cells and locations of the models stand one after another, in their order. A
    combination of all locations is the sum of one combination in each model, so means and variances
    add.

    Attributes
    ----------
    models : tuple of Model
        The factors.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(models)
        self.names: list[str] = []
        self.cells: tuple[tuple[str, str], ...] = ()
        self.priors_in_force: dict[str, float] = {}
        for model in models:
            self.names += model.names
            self.cells += model.cells
            self.priors_in_force |= model.priors_in_force

    def split(self, points: Array) -> list[tuple[Model, Array]]:
        """Each model with its coordinates (W, d), views."""
        counts = [len(model.names) for model in self.models]
        coordinates = _split_columns(points, counts)
        return list(zip(self.models, coordinates, strict=True))

    def identity(self) -> tuple[object, ...]:
        """Return what decides each of the models."""
        identities = [model.identity() for model in self.models]
        return ("product", *identities)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        log_densities = []
        for model, coordinates in self.split(points):
            log_densities.append(model(coordinates))
        return np.sum(log_densities, axis=0)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of all cells at coordinates (W, d)."""
        means = []
        sds = []
        population_sds = []
        for model, coordinates in self.split(points):
            laws = model.laws(coordinates)
            means.append(laws.mean)
            sds.append(laws.sd)
            population_sds.append(laws.population_sd)
        return ConditionalMoments(
            mean=np.hstack(means),
            sd=np.hstack(sds),
            population_sd=np.hstack(population_sds),
        )

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw population means and new users of all cells, each (W, C)."""
        means = []
        users = []
        for model, coordinates in self.split(points):
            model_means, model_users = model.draw(coordinates, rng)
            means.append(model_means)
            users.append(model_users)
        return np.hstack(means), np.hstack(users)

    def scales(self, points: Array) -> Named:
        """Scales of all models by name, side by side along the quantities."""
        parts = []
        for model, coordinates in self.split(points):
            parts.append(model.scales(coordinates))
        named: Named = {}
        for name, (dimensions, _) in parts[0].items():
            values = np.hstack([part[name][1] for part in parts])
            named[name] = (dimensions, values)
        return named

    def _shares(self, rows: Array, points: Array) -> list[_Share]:
        """Split weights (L, R) and coordinates (W, d) by model."""
        models = linear_parts(self)
        weights = _split_columns(rows, [model.locations_count for model in models])
        coordinates = _split_columns(points, [len(model.names) for model in models])
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


def linear_parts(model: Model) -> list[LinearPosterior]:
    """Models of subjects whose product a model is; none without pooling."""
    if isinstance(model, LinearPosterior):
        return [model]
    models = model.models if isinstance(model, Product) else ()
    return [part for factor in models for part in linear_parts(factor)]


def pooled_parts(model: Model, points: Array) -> list[tuple[LinearPosterior, Array]]:
    """Models of subjects whose product a model is, each with its part of coordinates (W, d)."""
    parts = linear_parts(model)
    if not parts:
        return []
    coordinates = _split_columns(points, [len(part.names) for part in parts])
    return list(zip(parts, coordinates, strict=True))


def _split_columns(matrix: Array, counts: Sequence[int]) -> list[Array]:
    """Split the columns of a matrix (rows, sum of counts) into parts (rows, count), views."""
    starts = np.cumsum(counts)[:-1]
    return np.split(matrix, starts, axis=1)
