"""Models side by side or cell by cell, and the limits that any model estimates."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.model import Model, Pooled
from percept.inference.hierarchy.priors import Named
from percept.inference.sampling.endpoints import mixture_quantile, share_half_width
from percept.inference.sampling.gate import Estimates

__all__ = ["KINDS", "IntervalEstimands", "Limits", "Model", "Product", "Unpooled"]

Array = NDArray[np.float64]

#: What an interval covers: the average user, the next user, a share of all users.
KINDS = ("mean", "user", "share")


class Product(Model):
    """Product of models of different parameters."""

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
        sizes = [len(model.names) for model in self.models]
        ends = np.cumsum(sizes)[:-1]
        parts = np.split(points, ends, axis=1)
        return list(zip(self.models, parts, strict=True))

    def identity(self) -> tuple[object, ...]:
        """Return what decides each of the models."""
        return ("product", *(model.identity() for model in self.models))

    def pooled_parts(self, points: Array) -> list[tuple[Pooled, Array]]:
        """Pooled densities of all models."""
        parts: list[tuple[Pooled, Array]] = []
        for model, coordinates in self._split(points):
            parts += model.pooled_parts(coordinates)
        return parts

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        values = [model(coordinates) for model, coordinates in self._split(points)]
        return np.sum(values, axis=0)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of all cells at coordinates (W, d)."""
        laws = [model.laws(coordinates) for model, coordinates in self._split(points)]
        return ConditionalMoments(
            mean=np.hstack([law.mean for law in laws]),
            sd=np.hstack([law.sd for law in laws]),
            population_sd=np.hstack([law.population_sd for law in laws]),
        )

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw population means and new users of all cells, each (W, C)."""
        drawn = [model.draw(coordinates, rng) for model, coordinates in self._split(points)]
        means = np.hstack([mean for mean, _ in drawn])
        users = np.hstack([user for _, user in drawn])
        return means, users

    def scales(self, points: Array) -> Named:
        """Scales of all models by name, those along parameters put together."""
        parts = [model.scales(coordinates) for model, coordinates in self._split(points)]
        named: Named = {}
        for name, (dimensions, _) in parts[0].items():
            values = np.hstack([part[name][1] for part in parts])
            named[name] = (dimensions, values)
        return named


class Unpooled(Model):
    """Each cell by itself: y ~ N(beta, sigma²), beta and log sigma flat.

    Responses are standardised by the cell's own mean and SD, so that an offset costs no digits.
    With t = log(sigma/SD) the posterior is exp(-nu t - nu exp(-2t)/2), nu = n - 1, and beta given
    sigma is N(0, exp(2t)/n). The coordinate is t in units of 1/sqrt(2 nu).
    """

    def __init__(self, cells: tuple[tuple[str, str], ...], counts: NDArray[np.int64]) -> None:
        if np.any(counts < 2):
            parameter, environment = cells[int(np.argmin(counts))]
            raise RefusalError(
                f"{parameter} in {environment} has one subject; the reference prior needs two.",
                hint='Add subjects, or use pooling = "partial".',
            )
        self.cells = cells
        self.names = [f"log sigma[{p},{e}]" for p, e in cells]
        self.priors_in_force: dict[str, float] = {}
        self._n = np.asarray(counts, dtype=float)
        self._df = self._n - 1.0
        self._unit = 1.0 / np.sqrt(2.0 * self._df)

    def identity(self) -> tuple[object, ...]:
        """Return cells and counts: the data are standardised."""
        return ("unpooled", self.cells, self._n)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, C), shape (W,)."""
        t = points * self._unit
        with np.errstate(over="ignore"):
            cost = self._df * (t + 0.5 * np.exp(-2.0 * t))
        return -cost.sum(axis=1)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of the standardised beta and of the population at coordinates (W, C)."""
        spread = np.exp(points * self._unit)
        return ConditionalMoments(
            mean=np.zeros_like(spread),
            sd=spread / np.sqrt(self._n),
            population_sd=spread,
        )

    def scales(self, points: Array) -> Named:
        """Ratio of sigma to the sample SD per cell."""
        ratio = np.exp(points * self._unit)
        return {"sigma_ratio": (("cell",), ratio)}


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Limits of one kind in C cells, on the response scale."""

    lower: Array  # (C,)
    upper: Array  # (C,)
    influence: Array  # (S, 2 C) Pull of each draw on the lower limits, then on the upper ones


class IntervalEstimands:
    """Limits of the requested intervals, of every cell.

    Parameters
    ----------
    model : Model
        Whose cells they are.
    kinds : tuple of str
        Of `KINDS`.
    level : float
        Credibility of the intervals of the average user and of the next user.
    share, confidence : float
        The third kind holds this share of all users with this probability.
    """

    def __init__(
        self,
        model: Model,
        *,
        kinds: tuple[str, ...] = KINDS,
        level: float = 0.99,
        share: float = 0.99,
        confidence: float = 0.95,
    ) -> None:
        self.model = model
        self.cells = model.cells
        self.kinds = kinds
        self.level = level
        self.share = share
        self.confidence = confidence

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return ("intervals", self.kinds, self.level, self.share, self.confidence)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, packed: shape (W, 3 C)."""
        return self.model.laws(points).pack()

    def limits(self, kind: str, laws: ConditionalMoments) -> Limits:
        """Limits of one kind from the laws of all draws."""
        if kind == "share":
            return self._share_limits(laws)
        sd = laws.sd
        if kind == "user":
            sd = np.hypot(laws.sd, laws.population_sd)
        tail = 0.5 * (1.0 - self.level)
        lower, on_lower = mixture_quantile(laws.mean, sd, tail, upper=False)
        upper, on_upper = mixture_quantile(laws.mean, sd, tail, upper=True)
        influence = np.hstack([on_lower, on_upper])
        return Limits(lower, upper, influence)

    def _share_limits(self, laws: ConditionalMoments) -> Limits:
        centre, half_width, influence = share_half_width(
            laws.mean,
            laws.sd,
            laws.population_sd,
            share=self.share,
            confidence=self.confidence,
        )
        return Limits(centre - half_width, centre + half_width, influence)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits of one kind after another, their scale being the interval's half-width."""
        laws = ConditionalMoments.unpack(components)
        for kind in self.kinds:
            limits = self.limits(kind, laws)
            lower = [f"lower {kind} limit of {p} in {e}" for p, e in self.cells]
            upper = [f"upper {kind} limit of {p} in {e}" for p, e in self.cells]
            half_width = 0.5 * (limits.upper - limits.lower)
            estimates = Estimates(
                names=(*lower, *upper),
                value=np.concatenate([limits.lower, limits.upper]),
                scale=np.tile(half_width, 2),
            )
            yield estimates, limits.influence
