"""What every model offers, and the collapsed posterior: all locations integrated out exactly."""

from __future__ import annotations

import dataclasses
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, SharedCovariance
from percept.inference.hierarchy.information import Information, InformationProblem
from percept.inference.hierarchy.priors import Named, Priors, draws_first
from percept.inference.hierarchy.regression import LocationProblem, Regression
from percept.inference.hierarchy.scales import Layout, Options, Scales
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["CollapsedDensity", "ConditionalMoments", "Model", "PairLaws", "Resolution"]

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)
#: Coordinates times draws of a pass: fewer waste calls, and more leave the processor's cache.
_PASS = 49152
#: Draws of a pass, whatever their dimension.
_FEWEST_DRAWS = 128
_MOST_DRAWS = 2048


@dataclasses.dataclass(frozen=True)
class Resolution:
    """Variance that a finite resolution of the adjustment adds, on the response scale."""

    between: Array | None = None  # (P, J)
    trial: Array | None = None  # (P, J)


@dataclasses.dataclass(frozen=True, eq=False)
class ConditionalMoments:
    """Law of each cell's location and of its users, given each draw, on the response scale.

    A cell is a parameter in an environment. Both laws are normal.
    """

    mean: Array  # (S, C) Mean of the location, and of the users
    sd: Array  # (S, C) SD of the location
    population_sd: Array  # (S, C) SD of users about the location

    def pack(self) -> Array:
        """Return all three side by side, shape (S, 3 C)."""
        return np.hstack([self.mean, self.sd, self.population_sd])

    @classmethod
    def unpack(cls, packed: Array) -> ConditionalMoments:
        """Undo `pack`."""
        return cls(*np.split(packed, 3, axis=1))

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw each cell's location and a new user of it, cells apart from one another."""
        mean = self.mean + self.sd * rng.standard_normal(self.mean.shape)
        users = mean + self.population_sd * rng.standard_normal(mean.shape)
        return mean, users


@dataclasses.dataclass(frozen=True, eq=False)
class PairLaws:
    """Joint law of two parameters in each environment, given each draw."""

    mean: Array  # (S, J, 2) Mean of the locations
    location: Array  # (S, J, 2, 2) Covariance of the locations
    users: Array  # (S, J, 2, 2) Covariance of users about them


class Model(ABC):
    """A posterior over scales, its locations integrated out: what sampler and reports need of it.

    Coordinates are (W, d), near standard normal under the prior. Cells are parameter-major.
    """

    names: list[str]  # Of the coordinates
    cells: tuple[tuple[str, str], ...]  # Parameter and environment
    priors_in_force: dict[str, float]  # By their names in `Priors`
    takes_options: bool = True  # Whether `Options` make it simpler

    @abstractmethod
    def identity(self) -> tuple[object, ...]:
        """Everything that decides density and locations: a posterior is found again by it."""

    @abstractmethod
    def __call__(self, points: Array) -> Array:
        """Log density at coordinates (W, d), up to a constant, shape (W,)."""

    @abstractmethod
    def laws(self, points: Array) -> ConditionalMoments:
        """Law of the locations and of users at coordinates (W, d)."""

    @abstractmethod
    def scales(self, points: Array) -> Named:
        """Scales and correlations by name, as dimensions and values, at coordinates (W, d)."""

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the locations and a new user of every cell, each (W, C)."""
        return self.laws(points).draw(rng)

    def pooled_parts(self, points: Array) -> list[tuple[CollapsedDensity, Array]]:
        """Pooled densities whose product the model is, each with its coordinates."""
        return []


class CollapsedDensity(Model):
    """Posterior of the scales and correlations; environments and subjects are partially pooled.

    Parameters
    ----------
    statistics : Statistics
        Sufficient statistics of the responses.
    priors : Priors, optional
        Prior scales.
    options : Options, optional
        Simpler models.
    resolution : Resolution, optional
        Variance that the adjustment's resolution adds.
    """

    def __init__(
        self,
        statistics: Statistics,
        priors: Priors | None = None,
        options: Options | None = None,
        resolution: Resolution | None = None,
    ) -> None:
        self.statistics = statistics
        self.priors = priors or Priors()
        self.resolution = resolution or Resolution()
        self.layout = Layout(statistics, self.priors, options or Options())
        self.names = self.layout.names
        self.dimension = self.layout.dimension
        self.priors_in_force = self.layout.priors_in_force
        self.cells = tuple(itertools.product(statistics.parameters, statistics.environments))
        self.regression = LocationProblem(statistics, self.layout, self.priors)
        self.information: InformationProblem | None = None
        #: Draws that are computed at once.
        self.draws_per_pass = _PASS // self.dimension
        self.draws_per_pass = min(_MOST_DRAWS, max(_FEWEST_DRAWS, self.draws_per_pass))
        if self.layout.trend and len(statistics.patterns) > 1:
            self.information = InformationProblem(statistics.patterns, self.regression.trend)
            self.draws_per_pass = self.information.draws_per_pass
        trials = 0.0
        for pattern in statistics.patterns:
            trials += pattern.subjects * pattern.trials.sum()
        numbers = len(statistics.parameters) * float(trials)
        self._constant = statistics.constant - 0.5 * _LOG_2PI * numbers

    def identity(self) -> tuple[object, ...]:
        """Return statistics, priors, options and resolution: they decide everything."""
        return (
            "pooled",
            dataclasses.astuple(self.statistics),
            dataclasses.astuple(self.priors),
            dataclasses.astuple(self.layout.options),
            dataclasses.astuple(self.resolution),
        )

    def pooled_parts(self, points: Array) -> list[tuple[CollapsedDensity, Array]]:
        """Return itself."""
        return [(self, points)]

    def __call__(self, points: Array) -> Array:
        """Log posterior density of coordinates (W, d), up to the evidence, shape (W,)."""
        count = len(points)
        if count % self.draws_per_pass == 1:
            # Sums over a single column run in another order: keep values independent of the batch.
            points = np.concatenate([points, points[-1:]])
        inside = np.all(np.abs(points) <= self.layout.limits, axis=1)
        # Points outside are computed at zero, so that no pass depends on how many there are.
        coords = np.where(inside[:, None], points, 0.0)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            parts = [
                scales.log_prior + self.log_likelihood(scales) for scales in self._passes(coords)
            ]
        value = np.concatenate(parts)[:count]
        possible = inside[:count] & ~np.isnan(value)
        return np.where(possible, value, -np.inf)

    def _passes(self, points: Array) -> Iterator[Scales]:
        """Scales at coordinates (W, d), some draws at a time."""
        for start in range(0, len(points), self.draws_per_pass):
            part = points[start : start + self.draws_per_pass]
            yield self.layout.scales(np.ascontiguousarray(part.T))

    def by_pass(self, points: Array, work: Callable[[Scales], tuple[Array, ...]]) -> list[Array]:
        """Arrays worked out from the scales at coordinates (W, d), draws first."""
        parts = [work(scales) for scales in self._passes(points)]
        by_array = zip(*parts, strict=True)
        return [np.concatenate(arrays) for arrays in by_array]

    def log_likelihood(self, scales: Scales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        statistics = self.statistics
        value = np.full(scales.log_prior.shape, self._constant)
        trial = self.trial_block(scales)
        if trial is not None:
            rows = tuple(statistics.trial_rows[..., None])
            squares = trial.distance(rows).sum(axis=0)
            determinants = np.einsum("j,jw->w", statistics.trial_df, trial.log_determinant())
            value = value - 0.5 * (squares + determinants)
        if self.information is None:
            return value + self._by_regression(scales)
        law = self._by_information(self.information, scales)
        if not law.sound.all():
            lost = np.flatnonzero(~law.sound)
            law.log_density[lost] = self._by_regression(scales[lost])
        return value + law.log_density

    def _by_regression(self, scales: Scales) -> Array:
        """Log density of the cell means, by the orthogonal form."""
        cells = self.cell_blocks(scales)
        value = np.zeros(scales.log_prior.shape)
        for pattern, cell in zip(self.statistics.patterns, cells, strict=True):
            if pattern.subjects > 1:
                covariance = SharedCovariance(cell, scales.shared)
                determinants = (pattern.subjects - 1.0) * covariance.log_determinant()
                value -= 0.5 * (determinants + covariance.scatter_distance(pattern.rows))
        law = Regression(self.regression, scales, cells, merge=True)
        return value + law.log_density

    def _by_information(self, problem: InformationProblem, scales: Scales) -> Information:
        """Locations by their information, which may lack digits."""
        kinds = self._cell_block(scales, problem.environment, problem.trials)
        return Information(problem, scales, kinds)

    def locations(self, scales: Scales) -> Regression | Information:
        """Law of beta given W sets of scales and the data: exactly Gaussian."""
        if self.information is not None:
            law = self._by_information(self.information, scales)
            if law.sound.all():
                return law
        return Regression(self.regression, scales, self.cell_blocks(scales))

    def population(self, scales: Scales) -> Block:
        """Covariance of users about beta in each environment, entries (J, W)."""
        if scales.shared is None:
            return scales.between
        shape = (self.layout.environments, scales.log_prior.size)
        shared = scales.shared.mapped(lambda part: np.broadcast_to(part, shape))
        return shared + scales.between

    def trial_block(self, scales: Scales) -> Block | None:
        """Covariance between trials with the resolution's share, entries (J, W)."""
        if scales.trial is None or self.resolution.trial is None:
            return scales.trial
        resolution = self.resolution.trial[..., None]
        return scales.trial.plus_diagonal(tuple(resolution))

    def cell_blocks(self, scales: Scales) -> list[Block]:
        """Covariance of one cell mean about the subject's effect, per pattern, entries (E, W)."""
        patterns = self.statistics.patterns
        return [self._cell_block(scales, p.environments, p.trials) for p in patterns]

    def _cell_block(
        self,
        scales: Scales,
        environments: NDArray[np.intp],
        trials: Array,
    ) -> Block:
        """Covariance of cell means about the subject's effect, entries (E, W)."""
        cell = scales.between[environments]
        if self.resolution.between is not None:
            resolution = self.resolution.between[:, environments, None]
            cell = cell.plus_diagonal(tuple(resolution))
        trial = self.trial_block(scales)
        if trial is not None:
            share = 1.0 / trials[:, None]
            cell = cell + trial[environments].scaled(share)
        return cell

    def moments(self, scales: Scales) -> ConditionalMoments:
        """Moments of beta and of the population, cells parameter by parameter."""
        law = self.locations(scales)
        variance = np.concatenate(law.covariance.diagonal())
        population_variance = np.concatenate(self.population(scales).diagonal())
        mean = np.concatenate(law.mean)
        return ConditionalMoments(
            mean=mean.T,
            sd=np.sqrt(variance).T,
            population_sd=np.sqrt(population_variance).T,
        )

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of beta and of the population at coordinates (W, d)."""
        parts = []
        for scales in self._passes(points):
            parts.append(self.moments(scales).pack())
        return ConditionalMoments.unpack(np.concatenate(parts))

    def pairs(self, points: Array) -> PairLaws:
        """Joint law of both parameters in each environment, at coordinates (W, d)."""

        def pair(scales: Scales) -> tuple[Array, Array, Array]:
            law = self.locations(scales)
            location = _matrices(law.covariance)
            users = _matrices(self.population(scales))
            return np.stack(law.mean).T, location, users

        return PairLaws(*self.by_pass(points, pair))

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw beta of all cells jointly and one new user of each environment, each (W, C)."""

        def drawn(scales: Scales) -> tuple[Array, Array]:
            beta = self.locations(scales).draw(rng)
            user = beta.copy()
            for column in self.population(scales).factor_columns():
                user += np.stack(column) * rng.standard_normal(beta.shape[1:])
            cells = len(self.cells)
            return beta.reshape(cells, -1).T, user.reshape(cells, -1).T

        beta, user = self.by_pass(points, drawn)
        return beta, user

    def scales(self, points: Array) -> Named:
        """Scales and correlations by name at coordinates: dimensions and values, draws first."""
        parts = [draws_first(scales.named) for scales in self._passes(points)]
        named: Named = {}
        for name, (dimensions, _) in parts[0].items():
            values = np.concatenate([part[name][1] for part in parts])
            named[name] = (dimensions, values)
        return named


def _matrices(block: Block) -> Array:
    """Covariances (W, J, P, P) of a block of entries (J, W)."""
    columns = np.stack(block.factor_columns())
    products = np.einsum("rpjw,rqjw->jpqw", columns, columns)
    return np.moveaxis(products, -1, 0)
