"""Posteriors that are not one linear model: several side by side, and cells that pool nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.errors import RefusalError
from percept.inference.model.laws import IndependentLaw, JointLaw, Law
from percept.inference.model.model import LinearModel, Model
from percept.inference.model.priors import Named

__all__ = ["Product", "Unpooled"]

Array = NDArray[np.float64]

#: An SD of one subject is unknown.
_FEWEST_SUBJECTS = 2


class Product(Model):
    """Product of independent models of different quantities.

    Coordinates, cells and locations of the models stand one after another, in their order.

    Attributes
    ----------
    models : list of LinearModel
        The factors.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        self.models: list[LinearModel] = []
        for model in models:
            self.models += [part for part, _ in model.split(np.zeros((0, len(model.names))))]
        self.names: list[str] = []
        self.cells: tuple[tuple[str, str], ...] = ()
        self.priors_in_force: dict[str, float] = {}
        for model in self.models:
            self.names += model.names
            self.cells += model.cells
            self.priors_in_force |= model.priors_in_force
        rows = linalg.block_diag(*(model.cell_rows for model in self.models))
        self.cell_rows = np.asarray(rows)
        self.draws_per_pass = min(model.draws_per_pass for model in self.models)

    def split(self, points: Array) -> list[tuple[LinearModel, Array]]:
        """Each model with its part of coordinates (W, d), views."""
        counts = [len(model.names) for model in self.models]
        coordinates = np.split(points, np.cumsum(counts)[:-1], axis=1)
        return list(zip(self.models, coordinates, strict=True))

    def identity(self) -> tuple[object, ...]:
        """Return what decides each of the models."""
        return ("product", *(model.identity() for model in self.models))

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        return np.sum([model(part) for model, part in self.split(points)], axis=0)

    def scales(self, points: Array) -> Named:
        """Scales of all models by name, quantities side by side; NaN where a model has none."""
        parts = [model.scales(coordinates) for model, coordinates in self.split(points)]
        named: Named = {}
        for part in parts:
            for name, (dimensions, values) in part.items():
                if name not in named and not dimensions:
                    named[name] = ((), values)
                elif name not in named:
                    named[name] = (dimensions, self._side_by_side(name, parts, values))
        return named

    def _side_by_side(
        self,
        name: str,
        parts: list[Named],
        example: Array,
    ) -> Array:
        """Values of a scale in all models, (W, P, ...), in which one model's are as the example."""
        columns = []
        for model, part in zip(self.models, parts, strict=True):
            width, _, *others = example.shape
            missing = np.full((width, model.design.parameters, *others), np.nan)
            _, values = part.get(name, ((), missing))
            columns.append(values)
        return np.hstack(columns)

    def law(self, points: Array) -> Law:
        """Law of all locations and of users at coordinates (W, d) of one pass."""
        return JointLaw([model.law(part) for model, part in self.split(points)])


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

    #: Calls of numpy cost little by then: each draw has C numbers alone.
    draws_per_pass = 1024

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
        self.cell_rows = np.eye(len(cells))
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

    def law(self, points: Array) -> Law:
        """Law of standardised cells, which are independent."""
        sigma = self._sigma_ratio(points)
        return IndependentLaw(sigma / np.sqrt(self._n), sigma)

    def scales(self, points: Array) -> Named:
        """Ratio of sigma to the sample SD per cell."""
        return {"sigma_ratio": (("cell",), self._sigma_ratio(points))}
