"""Models of a study, ready to sample: side by side, or cell by cell; and the limits they estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments
from percept.inference.hierarchy.priors import Named
from percept.inference.sampling.endpoints import mixture_quantile, share_half_width
from percept.inference.sampling.gate import Estimates

if TYPE_CHECKING:
    from percept.inference.hierarchy.within import WithinSubjects

Array = NDArray[np.float64]
#: A posterior over scales, with the locations integrated out. Its `cells` are parameter-major.
Model: TypeAlias = "CollapsedDensity | WithinSubjects | Unpooled | Product"


class Product:
    """Product of models, one per parameter."""

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(models)
        self._ends = np.cumsum([len(model.names) for model in models])[:-1]
        self.names: list[str] = [name for model in models for name in model.names]
        self.cells: tuple[tuple[str, str], ...] = tuple(
            cell for model in models for cell in model.cells
        )
        self.priors_in_force: dict[str, float] = {}
        for model in models:
            self.priors_in_force |= model.priors_in_force

    def split(self, points: Array) -> list[tuple[Model, Array]]:
        """Each model with its coordinates (W, d), views."""
        return list(zip(self.models, np.split(points, self._ends, axis=1), strict=True))

    def identity(self) -> tuple[object, ...]:
        """Return what decides each of the models."""
        return ("product", *(model.identity() for model in self.models))

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        return np.sum([model(part) for model, part in self.split(points)], axis=0)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of all cells at coordinates (W, d)."""
        laws = [vars(model.laws(part)).values() for model, part in self.split(points)]
        return ConditionalMoments(
            *(np.concatenate(part, axis=1) for part in zip(*laws, strict=True))
        )

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw population means and new users of all cells, each (W, C)."""
        means, users = zip(
            *(model.draw(part, rng) for model, part in self.split(points)), strict=True
        )
        return np.concatenate(means, axis=1), np.concatenate(users, axis=1)

    def scales(self, points: Array) -> Named:
        """Named scales of all models, those along parameters put together."""
        parts = [model.scales(part) for model, part in self.split(points)]
        return {
            name: (dimensions, np.concatenate([part[name][1] for part in parts], axis=1))
            for name, (dimensions, _) in parts[0].items()
        }


class Unpooled:
    """y ~ N(beta, sigma²) per cell, beta and log sigma flat.

    Responses are standardised by the cell's own mean and SD, so that an offset costs no digits:
    with t = log(sigma/SD) the posterior is exp(-nu t - nu exp(-2t)/2), nu = n - 1, and beta | sigma
    ~ N(0, exp(2t)/n). The coordinate is t in units of 1/sqrt(2 nu).
    """

    def __init__(self, cells: tuple[tuple[str, str], ...], counts: NDArray[np.int64]) -> None:
        if np.any(counts < 2):
            parameter, environment = cells[int(np.argmin(counts))]
            message = (
                f"{parameter} in {environment} has one subject; the reference prior needs two."
            )
            raise RefusalError(message, hint='Add subjects, or use pooling = "partial".')
        self.cells = cells
        self.names = [f"log sigma[{p},{e}]" for p, e in cells]
        self.priors_in_force: dict[str, float] = {}
        self._n = np.asarray(counts, dtype=float)
        self._df = self._n - 1.0
        self._unit = 1.0 / np.sqrt(2.0 * self._df)

    def identity(self) -> tuple[object, ...]:
        """Everything that decides the density: cells and counts, the data being standardised."""
        return ("unpooled", self.cells, self._n)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, C), shape (W,)."""
        t = points * self._unit
        with np.errstate(over="ignore"):
            return -(self._df * (t + 0.5 * np.exp(-2.0 * t))).sum(axis=1)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of the standardised beta and of the population at coordinates (W, C)."""
        spread = np.exp(points * self._unit)
        return ConditionalMoments(np.zeros_like(spread), spread / np.sqrt(self._n), spread)

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw standardised population means and new users, each (W, C)."""
        return self.laws(points).draw(rng)

    def scales(self, points: Array) -> Named:
        """Ratio of sigma to the sample SD per cell."""
        return {"sigma_ratio": (("cell",), np.exp(points * self._unit))}


KINDS = ("mean", "user", "share")


class IntervalEstimands:
    """Endpoints of the intervals asked for, of every cell."""

    def __init__(
        self,
        model: Model,
        *,
        kinds: tuple[str, ...] = KINDS,
        level: float = 0.99,
        share: float = 0.99,
        confidence: float = 0.95,
    ) -> None:
        self.model, self.kinds, self.cells = model, kinds, model.cells
        self.level, self.share, self.confidence = level, share, confidence

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return ("intervals", self.kinds, self.level, self.share, self.confidence)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, packed: shape (W, 3 C)."""
        return self.model.laws(points).pack()

    def limits(self, kind: str, laws: ConditionalMoments) -> tuple[Array, Array, Array]:
        """Limits of one kind on the response scale, and their influence functions."""
        if kind == "share":
            centre, half, influence = share_half_width(
                laws.mean, laws.sd, laws.population_sd, share=self.share, confidence=self.confidence
            )
            return centre - half, centre + half, influence
        sd = laws.sd if kind == "mean" else np.hypot(laws.sd, laws.population_sd)
        tail = 0.5 * (1.0 - self.level)
        lower, on_lower = mixture_quantile(laws.mean, sd, tail, upper=False)
        upper, on_upper = mixture_quantile(laws.mean, sd, tail, upper=True)
        return lower, upper, np.concatenate([on_lower, on_upper], axis=1)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits of one kind after another, their scale being the interval's half-width."""
        laws = ConditionalMoments.unpack(components)
        for kind in self.kinds:
            lower, upper, influence = self.limits(kind, laws)
            sides = product(("lower", "upper"), self.cells)
            names = tuple(f"{side} {kind} limit of {p} in {e}" for side, (p, e) in sides)
            yield (
                Estimates(names, np.r_[lower, upper], np.tile(0.5 * (upper - lower), 2)),
                influence,
            )
