"""Models that pool nothing, or nothing between their parts.

`Product` joins models of different quantities; `Unpooled` takes each cell by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.model import Model, Pooled
from percept.inference.hierarchy.priors import Named

__all__ = ["Product", "Unpooled", "split_columns"]

Array = NDArray[np.float64]

#: An SD of one subject is unknown.
_FEWEST_SUBJECTS = 2


class Product(Model):
    """Product of independent models of different quantities.

    Coordinates and cells of the models stand one after another, in the order of the models.

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

    def _split(self, points: Array) -> list[tuple[Model, Array]]:
        """Each model with its coordinates (W, d), views."""
        counts = [len(model.names) for model in self.models]
        coordinates = split_columns(points, counts)
        return list(zip(self.models, coordinates, strict=True))

    def identity(self) -> tuple[object, ...]:
        """Return what decides each of the models."""
        identities = [model.identity() for model in self.models]
        return ("product", *identities)

    def pooled_parts(self, points: Array) -> list[tuple[Pooled, Array]]:
        """Pooled densities of all models, each with its coordinates."""
        parts: list[tuple[Pooled, Array]] = []
        for model, coordinates in self._split(points):
            parts += model.pooled_parts(coordinates)
        return parts

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        log_densities = []
        for model, coordinates in self._split(points):
            log_densities.append(model(coordinates))
        return np.sum(log_densities, axis=0)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of all cells at coordinates (W, d)."""
        means = []
        sds = []
        population_sds = []
        for model, coordinates in self._split(points):
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
        for model, coordinates in self._split(points):
            model_means, model_users = model.draw(coordinates, rng)
            means.append(model_means)
            users.append(model_users)
        return np.hstack(means), np.hstack(users)

    def scales(self, points: Array) -> Named:
        """Scales of all models by name, side by side along the quantities."""
        parts = []
        for model, coordinates in self._split(points):
            parts.append(model.scales(coordinates))
        named: Named = {}
        for name, (dimensions, _) in parts[0].items():
            values = np.hstack([part[name][1] for part in parts])
            named[name] = (dimensions, values)
        return named


def split_columns(matrix: Array, counts: Sequence[int]) -> list[Array]:
    """Split the columns of a matrix (rows, sum of counts) into parts (rows, count), views."""
    starts = np.cumsum(counts)[:-1]
    return np.split(matrix, starts, axis=1)


class Unpooled(Model):
    """Each cell by itself: y ~ N(beta, sigma²), beta and log sigma flat.

    Responses are standardised by the cell's own mean and SD, so that an offset costs no digits.
    With t = log(sigma/SD) and n subjects the posterior is exp(-nu t - nu exp(-2t)/2), nu = n - 1,
    and beta given sigma is N(0, exp(2t)/n). The coordinate is t in units of 1/sqrt(2 nu), the SD of
    t at the mode.

    Parameters
    ----------
    cells : tuple of (str, str)
        Parameter and environment of each of the C cells.
    counts : ndarray of int
        Subjects n of each cell, (C,).

    Raises
    ------
    RefusalError
        If a cell has one subject.
    """

    def __init__(
        self,
        cells: tuple[tuple[str, str], ...],
        counts: NDArray[np.int64],
    ) -> None:
        if np.any(counts < _FEWEST_SUBJECTS):
            parameter, environment = cells[int(np.argmin(counts))]
            raise RefusalError(
                f"{parameter} in {environment} has one subject; the reference prior needs two.",
                hint='Add subjects, or use pooling = "partial".',
            )
        self.cells = cells
        self.names = [f"log sigma[{parameter},{environment}]" for parameter, environment in cells]
        self.priors_in_force: dict[str, float] = {}
        self._n = np.asarray(counts, dtype=float)
        self._nu = self._n - 1.0
        self._unit = 1.0 / np.sqrt(2.0 * self._nu)

    def identity(self) -> tuple[object, ...]:
        """Return cells and counts: the data are standardised."""
        return ("unpooled", self.cells, self._n)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, C), shape (W,)."""
        t = points * self._unit
        with np.errstate(over="ignore"):
            inverse_variance = np.exp(-2.0 * t)
            cost = self._nu * (t + 0.5 * inverse_variance)
        return -cost.sum(axis=1)

    def _sigma_ratio(self, points: Array) -> Array:
        """exp(t), sigma over the cell's SD, (W, C)."""
        return np.exp(points * self._unit)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of the standardised beta and of the population at coordinates (W, C)."""
        sigma = self._sigma_ratio(points)
        return ConditionalMoments(
            mean=np.zeros_like(sigma),
            sd=sigma / np.sqrt(self._n),
            population_sd=sigma,
        )

    def scales(self, points: Array) -> Named:
        """Ratio of sigma to the sample SD per cell."""
        return {"sigma_ratio": (("cell",), self._sigma_ratio(points))}
