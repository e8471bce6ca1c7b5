"""Models of a study, ready to sample: pooled, side by side, or cell by cell; and what they estimate."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments
from percept.inference.hierarchy.priors import draws_first
from percept.inference.hierarchy.scales import Scales
from percept.inference.sampling.endpoints import Estimates, mixture_quantile, share_half_width

Array = NDArray[np.float64]


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

    def identity(self) -> tuple[object, ...]:
        """Everything that decides density and locations, as arrays and plain values."""

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""

    def laws(self, points: Array) -> ConditionalMoments:
        """ConditionalMoments of the locations at coordinates (W, d)."""

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw population means and new users, each (W, C), once per coordinates."""

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Named scales and correlations at coordinates: dimensions and values, draws first."""


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

    def identity(self) -> tuple[object, ...]:
        """Everything that decides density and locations: statistics, priors, options, resolution."""
        density = self.density
        return (
            "pooled",
            dataclasses.astuple(density.statistics),
            dataclasses.astuple(density.priors),
            dataclasses.astuple(density.layout.options),
            dataclasses.astuple(density.resolution),
        )

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        return self.density(points)

    def by_pass(self, points: Array, work: Callable[[Scales], tuple[Array, ...]]) -> list[Array]:
        """Arrays worked out from the scales at coordinates (W, d), some draws at a time, draws first."""
        most, layout = self.density.draws_per_pass, self.density.layout
        parts = [
            work(layout.scales(np.ascontiguousarray(points[i : i + most].T)))
            for i in range(0, len(points), most)
        ]
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def laws(self, points: Array) -> ConditionalMoments:
        """ConditionalMoments of beta and spread of the population at coordinates (W, d)."""
        (packed,) = self.by_pass(points, lambda scales: (self.density.moments(scales).pack(),))
        return ConditionalMoments.unpack(packed)

    def pairs(self, points: Array) -> tuple[Array, Array, Array]:
        """Conditional moments of the two parameters at coordinates (S, d), as `CollapsedDensity.pairs`."""
        mean, own, users = self.by_pass(points, self.density.pairs)
        return mean, own, users

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw beta of all cells jointly and one new user of each environment, each (W, C)."""

        def drawn(scales: Scales) -> tuple[Array, Array]:
            beta = self.density.locations(scales).draw(rng)
            user = beta.copy()
            for column in self.density.population(scales).factor_columns():
                user += np.stack(column) * rng.standard_normal(beta.shape[1:])
            return beta.reshape(-1, beta.shape[-1]).T, user.reshape(-1, beta.shape[-1]).T

        beta, user = self.by_pass(points, drawn)
        return beta, user

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Named scales and correlations at coordinates: dimensions and values, draws first."""
        shapes = draws_first(self.density.layout.scales(np.zeros((self.density.dimension, 1))).named)
        values = self.by_pass(
            points, lambda scales: tuple(value for _, value in draws_first(scales.named).values())
        )
        return {name: (shapes[name][0], value) for name, value in zip(shapes, values, strict=True)}


class Product:
    """Product of models, one per parameter."""

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(models)
        self._ends = np.cumsum([len(model.names) for model in models])[:-1]
        self.cells = tuple(cell for model in models for cell in model.cells)

    def split(self, points: Array) -> list[tuple[Model, Array]]:
        """Each model with its coordinates (W, d), views."""
        return list(zip(self.models, np.split(points, self._ends, axis=1), strict=True))

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return [name for model in self.models for name in model.names]

    @property
    def priors(self) -> dict[str, float]:
        """Priors in force in any of the models, by name."""
        return {name: value for model in self.models for name, value in model.priors.items()}

    def identity(self) -> tuple[object, ...]:
        """Return what decides each of the models."""
        return ("product", *(model.identity() for model in self.models))

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        return np.sum([model(part) for model, part in self.split(points)], axis=0)

    def laws(self, points: Array) -> ConditionalMoments:
        """ConditionalMoments of all cells at coordinates (W, d)."""
        laws = [model.laws(part) for model, part in self.split(points)]
        return ConditionalMoments(
            *(np.concatenate([getattr(p, n) for p in laws], axis=1) for n in ("mean", "sd", "population_sd"))
        )

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw population means and new users of all cells, each (W, C)."""
        means, users = zip(*(model.draw(part, rng) for model, part in self.split(points)), strict=True)
        return np.concatenate(means, axis=1), np.concatenate(users, axis=1)

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Named scales of all models, those along parameters put together."""
        parts = [model.scales(part) for model, part in self.split(points)]
        return {
            name: (dimensions, np.concatenate([part[name][1] for part in parts], axis=1))
            for name, (dimensions, _) in parts[0].items()
        }


class Unpooled:
    """y ~ N(beta, sigma²) per cell, beta and log sigma flat.

    Responses are standardised by the cell's own mean and SD, so that an offset costs no digits: with
    t = log(sigma/SD) the posterior is exp(-nu t - nu exp(-2t)/2), nu = n - 1, and
    beta | sigma ~ N(0, exp(2t)/n). The coordinate is t in units of 1/sqrt(2 nu).
    """

    def __init__(self, cells: tuple[tuple[str, str], ...], counts: NDArray[np.int64]) -> None:
        if np.any(counts < 2):
            parameter, environment = cells[int(np.argmin(counts))]
            raise RefusalError(
                f"{parameter} in {environment} has one subject; the reference prior needs two.",
                hint='Add subjects, or use pooling = "partial".',
            )
        self.cells = cells
        self._n = np.asarray(counts, dtype=float)
        self._df = self._n - 1.0
        self._unit = 1.0 / np.sqrt(2.0 * self._df)

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return [f"log sigma[{p},{e}]" for p, e in self.cells]

    @property
    def priors(self) -> dict[str, float]:
        """None that could be set."""
        return {}

    def identity(self) -> tuple[object, ...]:
        """Everything that decides the density: cells and counts, the data being standardised."""
        return ("unpooled", self.cells, self._n)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, C), shape (W,)."""
        t = points * self._unit
        with np.errstate(over="ignore"):
            return -(self._df * (t + 0.5 * np.exp(-2.0 * t))).sum(axis=1)

    def laws(self, points: Array) -> ConditionalMoments:
        """ConditionalMoments of the standardised beta and spread at coordinates (W, C)."""
        spread = np.exp(points * self._unit)
        return ConditionalMoments(np.zeros_like(spread), spread / np.sqrt(self._n), spread)

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw standardised population means and new users, each (W, C)."""
        laws = self.laws(points)
        mean = laws.sd * rng.standard_normal(points.shape)
        return mean, mean + laws.population_sd * rng.standard_normal(points.shape)

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
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
        self._model = model
        self.kinds = kinds
        self.level, self.share, self.confidence = level, share, confidence
        self.cells = model.cells

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all limits, in their order."""
        return tuple(
            f"{side} {kind} limit of {p} in {e}"
            for kind in self.kinds
            for side in ("lower", "upper")
            for p, e in self.cells
        )

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return ("intervals", self.kinds, self.level, self.share, self.confidence)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, packed: shape (W, 3 C)."""
        return self._model.laws(points).pack()

    def limits(self, kind: str, laws: ConditionalMoments) -> tuple[Array, Array, Array]:
        """Limits of one kind on the response scale."""
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

    def parts(self) -> list[IntervalEstimands]:
        """Limits of one kind each."""
        claim = {"level": self.level, "share": self.share, "confidence": self.confidence}
        return [IntervalEstimands(self._model, kinds=(kind,), **claim) for kind in self.kinds]

    def estimate(self, components: Array) -> tuple[Estimates, Array]:
        """All limits of all kinds asked for, their scale being the interval's half-width."""
        laws = ConditionalMoments.unpack(components)
        values, scales, influences = [], [], []
        for kind in self.kinds:
            lower, upper, influence = self.limits(kind, laws)
            values += [lower, upper]
            scales += [0.5 * (upper - lower)] * 2
            influences.append(influence)
        found = Estimates(self.names, np.concatenate(values), np.concatenate(scales))
        return found, np.concatenate(influences, axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class NewEnvironment:
    """What S posterior draws say of one new environment; P parameters, on the response scale."""

    mean: Array  # (S, P) Conditional mean of β*
    covariance: Array  # (S, P, P) Conditional covariance of β*
    population: Array  # (S, P, P) Σ_u + Σ_w*: covariance of users about β*

    @property
    def laws(self) -> ConditionalMoments:
        """Each parameter by itself, cells being parameters."""
        variances = (np.diagonal(part, axis1=1, axis2=2) for part in (self.covariance, self.population))
        return ConditionalMoments(self.mean, *map(np.sqrt, variances))


def new_environment(
    model: Model, points: Array, x: Array, *, repeats: int, rng: np.random.Generator
) -> NewEnvironment:
    """Work out the laws of a new environment at posterior draws."""
    if isinstance(model, Product):
        parts = [
            new_environment(part, own, x[[p]], repeats=repeats, rng=rng)
            for p, (part, own) in enumerate(model.split(points))
        ]
        mean = np.concatenate([part.mean for part in parts], axis=1)
        variances = (
            np.concatenate([getattr(part, name)[:, 0] for part in parts], axis=1)
            for name in ("covariance", "population")
        )
        # Uncorrelated parameters.
        return NewEnvironment(mean, *(own[..., None] * np.eye(x.size) for own in variances))
    if not isinstance(model, Pooled):
        raise RefusalError(
            "environments without pooling say nothing on others.",
            hint='Set pooling = "partial" in [model].',
        )
    density = model.density
    if not density.layout.trend:
        raise RefusalError(
            "one environment says nothing on others.", hint="Add sessions with more reference environments."
        )
    return NewEnvironment(
        *model.by_pass(points, lambda scales: density.new_environment(scales, x, repeats, rng))
    )


class NewEstimands(IntervalEstimands):
    """Endpoints of the intervals of a new environment, cells being parameters."""

    def __init__(self, estimands: IntervalEstimands, x: Array, repeats: int, seed: int) -> None:
        vars(self).update(vars(estimands))
        self._all, self._x, self._repeats, self._seed = estimands, x, repeats, seed
        self._rng = np.random.default_rng(seed)
        self.cells = tuple((parameter, "new") for parameter in dict.fromkeys(p for p, _ in estimands.cells))

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return (*super().identity(), "new", tuple(self._x.tolist()), self._repeats, self._seed)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, shape (W, 3 P R): every spread side by side."""
        found = new_environment(self._model, points, self._x, repeats=self._repeats, rng=self._rng)
        return found.laws.pack().reshape(len(points), -1)

    def parts(self) -> list[IntervalEstimands]:
        """Limits of one kind each."""
        return [NewEstimands(part, self._x, self._repeats, self._seed) for part in self._all.parts()]

    def estimate(self, components: Array) -> tuple[Estimates, Array]:
        """All limits, and the influence of each draw over all its spreads."""
        found, influence = super().estimate(components.reshape(len(components) * self._repeats, -1))
        return found, influence.reshape(len(components), self._repeats, -1).mean(axis=1)
