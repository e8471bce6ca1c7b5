"""The collapsed posterior density: every location and subject effect integrated out exactly."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, SharedCovariance
from percept.inference.hierarchy.information import Information, InformationProblem
from percept.inference.hierarchy.priors import Named, Priors, draws_first
from percept.inference.hierarchy.regression import LocationProblem, Regression
from percept.inference.hierarchy.scales import Layout, Options, Scales
from percept.inference.hierarchy.statistics import Statistics

Array = NDArray[np.float64]
#: Numbers of coordinates per pass: fewer waste calls, and temporaries beyond the processor's cache
#: cost more.
_PASS = 49152
_LOG_2PI = math.log(2.0 * math.pi)


@dataclasses.dataclass(frozen=True)
class Resolution:
    """Variance that a finite resolution of the adjustment adds, on the response scale."""

    between: Array | None = None  # (P, J)
    trial: Array | None = None  # (P, J)


@dataclasses.dataclass(frozen=True, eq=False)
class ConditionalMoments:
    """Per draw and cell (a parameter in an environment), on the response scale."""

    mean: Array  # (S, C)
    sd: Array  # (S, C)
    population_sd: Array  # (S, C) SD of the population about its mean

    def pack(self) -> Array:
        """Return all three side by side, shape (S, 3 C)."""
        return np.concatenate([self.mean, self.sd, self.population_sd], axis=1)

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw each cell's mean and a new user of it, cells apart from one another."""
        mean = self.mean + self.sd * rng.standard_normal(self.mean.shape)
        return mean, mean + self.population_sd * rng.standard_normal(mean.shape)

    @classmethod
    def unpack(cls, packed: Array) -> ConditionalMoments:
        """Undo `pack`."""
        return cls(*np.split(packed, 3, axis=1))


class CollapsedDensity:
    """Posterior of the scales and correlations; environments and subjects are partially pooled."""

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
        self.regression = LocationProblem(statistics, self.layout, self.priors)
        self.information: InformationProblem | None = None
        if self.layout.trend and len(statistics.patterns) > 1:
            self.information = InformationProblem(statistics.patterns, self.regression.trend)
        trials = sum(p.subjects * p.trials.sum() for p in statistics.patterns)
        self._constant = statistics.constant - 0.5 * _LOG_2PI * len(statistics.parameters) * float(
            trials
        )
        self.names, self.dimension = self.layout.names, self.layout.dimension
        self.priors_in_force = self.layout.priors_in_force
        self.cells = tuple((p, e) for p in statistics.parameters for e in statistics.environments)
        #: Draws that are computed at once.
        self.draws_per_pass = min(2048, max(128, _PASS // self.dimension))
        if self.information is not None:
            self.draws_per_pass = self.information.draws_per_pass

    def identity(self) -> tuple[object, ...]:
        """Everything that decides density and locations: statistics, priors, options, resolution."""
        model: tuple[Any, ...] = (
            self.statistics,
            self.priors,
            self.layout.options,
            self.resolution,
        )
        return ("pooled", *(dataclasses.astuple(part) for part in model))

    def __call__(self, points: Array) -> Array:
        """Log posterior density of coordinates (W, d), up to the evidence, shape (W,)."""
        most, count = self.draws_per_pass, len(points)
        if count % most == 1:
            # Sums over a single column run in another order: keep values independent of the batch.
            points = np.concatenate([points, points[-1:]])
        inside = np.all(np.abs(points) <= self.layout.limits, axis=1)
        value = np.full(len(points), -np.inf)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            for start in range(0, len(points), most):
                part = slice(start, start + most)
                coords = np.where(inside[part, None], points[part], 0.0)
                scales = self.layout.scales(np.ascontiguousarray(coords.T))
                value[part] = scales.log_prior + self.log_likelihood(scales)
        return np.where(inside & ~np.isnan(value), value, -np.inf)[:count]

    def log_likelihood(self, scales: Scales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        statistics = self.statistics
        value = np.full(scales.log_prior.shape, self._constant)
        trial = self.trial_block(scales)
        if trial is not None:
            squares = trial.distance(tuple(statistics.trial_rows[..., None])).sum(axis=0)
            determinants = np.einsum("j,jw->w", statistics.trial_df, trial.log_determinant())
            value = value - 0.5 * (squares + determinants)
        if self.information is None:
            return value + self._by_regression(scales)
        found = self._by_information(self.information, scales)
        if not found.sound.all():
            lost = np.flatnonzero(~found.sound)
            found.log_density[lost] = self._by_regression(scales[lost])
        return value + found.log_density

    def _by_regression(self, scales: Scales) -> Array:
        """Log density of the cell means, by the orthogonal form."""
        cells = self.cell_blocks(scales)
        value = np.zeros(scales.log_prior.shape)
        for pattern, cell in zip(self.statistics.patterns, cells, strict=True):
            if pattern.subjects > 1:
                covariance = SharedCovariance(cell, scales.shared)
                value -= 0.5 * (
                    (pattern.subjects - 1.0) * covariance.log_determinant()
                    + covariance.scatter_distance(pattern.rows)
                )
        return value + Regression(self.regression, scales, cells, merge=True).log_density

    def locations(self, scales: Scales) -> Regression | Information:
        """Law of beta given W sets of scales and the data: exactly Gaussian."""
        if self.information is not None:
            found = self._by_information(self.information, scales)
            if found.sound.all():
                return found
        return Regression(self.regression, scales, self.cell_blocks(scales))

    def population(self, scales: Scales) -> Block:
        """Covariance of users about beta in each environment, entries (J, W)."""
        if scales.shared is None:
            return scales.between
        shape = self.layout.environments, scales.log_prior.size
        return scales.shared.mapped(lambda part: np.broadcast_to(part, shape)) + scales.between

    def trial_block(self, scales: Scales) -> Block | None:
        """Covariance between trials with the resolution's share, entries (J, W)."""
        if scales.trial is None or self.resolution.trial is None:
            return scales.trial
        return scales.trial.plus_diagonal(tuple(self.resolution.trial[..., None]))

    def cell_blocks(self, scales: Scales) -> list[Block]:
        """Covariance of one cell mean about the subject's effect, per pattern, entries (E, W)."""
        return [self._cells(scales, p.environments, p.trials) for p in self.statistics.patterns]

    def _by_information(self, problem: InformationProblem, scales: Scales) -> Information:
        """Locations by their information, whose digits may not do."""
        return Information(
            problem, scales, self._cells(scales, problem.environment, problem.trials)
        )

    def _cells(self, scales: Scales, environments: NDArray[np.intp], trials: Array) -> Block:
        """Covariance of cell means about the subject's effect, entries (E, W)."""
        cell, trial = scales.between[environments], self.trial_block(scales)
        if self.resolution.between is not None:
            cell = cell.plus_diagonal(tuple(self.resolution.between[:, environments, None]))
        if trial is not None:
            cell = cell + trial[environments].scaled(1.0 / trials[:, None])
        return cell

    def passes(self, points: Array) -> Iterator[Scales]:
        """Scales at coordinates (W, d), some draws at a time."""
        for start in range(0, len(points), self.draws_per_pass):
            part = points[start : start + self.draws_per_pass]
            yield self.layout.scales(np.ascontiguousarray(part.T))

    def by_pass(self, points: Array, work: Callable[[Scales], tuple[Array, ...]]) -> list[Array]:
        """Arrays worked out from the scales at coordinates (W, d), draws first."""
        return [np.concatenate(part) for part in zip(*map(work, self.passes(points)), strict=True)]

    def moments(self, scales: Scales) -> ConditionalMoments:
        """Moments of beta and of the population, cells parameter by parameter."""
        law = self.locations(scales)
        sd, population_sd = (
            np.sqrt(np.concatenate(block.diagonal())).T
            for block in (law.covariance, self.population(scales))
        )
        return ConditionalMoments(np.concatenate(law.mean).T, sd, population_sd)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of beta and of the population at coordinates (W, d)."""
        (packed,) = self.by_pass(points, lambda scales: (self.moments(scales).pack(),))
        return ConditionalMoments.unpack(packed)

    def pairs(self, points: Array) -> tuple[Array, Array, Array]:
        """Mean of the pair of betas (W, J, 2), its covariance, and that of users about it (W, J, 2, 2)."""

        def pair(scales: Scales) -> tuple[Array, Array, Array]:
            law = self.locations(scales)
            own, users = (_matrices(block) for block in (law.covariance, self.population(scales)))
            return np.stack(law.mean).T, own, users

        mean, own, users = self.by_pass(points, pair)
        return mean, own, users

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw beta of all cells jointly and one new user of each environment, each (W, C)."""

        def drawn(scales: Scales) -> tuple[Array, Array]:
            beta = self.locations(scales).draw(rng)
            user = beta.copy()
            for column in self.population(scales).factor_columns():
                user += np.stack(column) * rng.standard_normal(beta.shape[1:])
            return beta.reshape(-1, beta.shape[-1]).T, user.reshape(-1, beta.shape[-1]).T

        beta, user = self.by_pass(points, drawn)
        return beta, user

    def scales(self, points: Array) -> Named:
        """Named scales and correlations at coordinates: dimensions and values, draws first."""
        parts = [draws_first(scales.named) for scales in self.passes(points)]
        return {
            name: (dimensions, np.concatenate([part[name][1] for part in parts]))
            for name, (dimensions, _) in parts[0].items()
        }


def _matrices(block: Block) -> Array:
    """Covariances (W, J, P, P) of a block of entries (J, W)."""
    columns = np.stack([np.stack(column) for column in block.factor_columns()])
    return np.moveaxis(np.einsum("rpjw,rqjw->jpqw", columns, columns), -1, 0)
