"""The collapsed posterior density: every location and subject effect integrated out exactly."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, SharedCovariance, spread_over
from percept.inference.hierarchy.information import Information, InformationProblem
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.regression import LocationProblem, Regression
from percept.inference.hierarchy.scales import Layout, Options, Scales
from percept.inference.hierarchy.statistics import Statistics

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
#: Numbers of coordinates per pass: fewer waste calls, and temporaries beyond the processor's cache cost more.
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

    @classmethod
    def unpack(cls, packed: Array) -> ConditionalMoments:
        """Undo `pack`."""
        return cls(*np.split(packed, 3, axis=1))


class CollapsedDensity:
    """Log posterior density of the scales and correlations, vectorised over draws."""

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
        self._constant = statistics.constant - 0.5 * _LOG_2PI * len(statistics.parameters) * float(trials)

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return self.layout.dimension

    @property
    def names(self) -> list[str]:
        """Names of the coordinates, in order."""
        return self.layout.names

    @property
    def draws_per_pass(self) -> int:
        """Draws that are computed at once."""
        if self.information is not None:
            return self.information.draws_per_pass
        return min(2048, max(128, _PASS // self.dimension))

    def __call__(self, points: Array) -> Array:
        """Log posterior density, up to the evidence."""
        most = self.draws_per_pass
        if len(points) > most:
            return np.concatenate([self(points[i : i + most]) for i in range(0, len(points), most)])
        if len(points) == 1:
            # Sums over a single column run in another order: keep values independent of the batch.
            return self(np.repeat(points, 2, axis=0))[:1]
        inside = np.all(np.abs(points) <= self.layout.limits, axis=1)
        coords = np.ascontiguousarray(np.where(inside[:, None], points, 0.0).T)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            scales = self.layout.scales(coords)
            value = scales.log_prior + self.log_likelihood(scales)
        return np.where(inside & ~np.isnan(value), value, -np.inf)

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
        found = Information(self.information, scales, self._kinds(scales))
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
        problem = self.regression.build(scales, cells)
        return value + Regression(problem, scales, self.layout.environments).log_density

    def locations(self, scales: Scales) -> Regression | Information:
        """Law of beta given W sets of scales and the data: exactly Gaussian."""
        if self.information is not None:
            found = Information(self.information, scales, self._kinds(scales))
            if found.sound.all():
                return found
        problem = self.regression.build(scales, self.cell_blocks(scales), merge=False)
        return Regression(problem, scales, self.layout.environments)

    def population(self, scales: Scales) -> Block:
        """Covariance of users about beta in each environment, entries (J, W)."""
        if scales.shared is None:
            return scales.between
        return spread_over(scales.shared, (self.layout.environments, scales.log_prior.size)) + scales.between

    def moments(self, scales: Scales) -> ConditionalMoments:
        """Moments of beta and of the population, cells parameter by parameter."""
        law = self.locations(scales)
        sd, population_sd = (
            np.sqrt(np.concatenate(block.diagonal())).T for block in (law.covariance, self.population(scales))
        )
        return ConditionalMoments(np.concatenate(law.mean).T, sd, population_sd)

    def pairs(self, scales: Scales) -> tuple[Array, Array, Array]:
        """Mean of both parameters' beta (W, J, 2), its covariance, and that of users about it (W, J, 2, 2)."""
        law = self.locations(scales)
        blocks = (law.covariance, self.population(scales))
        own, users = (np.moveaxis(_matrix(block), -1, 0) for block in blocks)
        return np.stack(law.mean).T, own, users

    def trial_block(self, scales: Scales) -> Block | None:
        """Covariance between trials with the resolution's share, entries (J, W)."""
        if scales.trial is None or self.resolution.trial is None:
            return scales.trial
        return scales.trial.plus_diagonal(tuple(self.resolution.trial[..., None]))

    def cell_blocks(self, scales: Scales) -> list[Block]:
        """Covariance of one cell mean about the subject's effect, per pattern, entries (E, W)."""
        trial = self.trial_block(scales)
        return [self._cells(scales, trial, p.environments, p.trials) for p in self.statistics.patterns]

    def _kinds(self, scales: Scales) -> Block:
        """Covariance of a cell mean about the subject's effect for each kind of cell, entries (K, W)."""
        assert self.information is not None
        kinds = self.information
        return self._cells(scales, self.trial_block(scales), kinds.environment, kinds.trials)

    def _cells(self, scales: Scales, trial: Block | None, environments: Indices, trials: Array) -> Block:
        cell = scales.between[environments]
        if self.resolution.between is not None:
            cell = cell.plus_diagonal(tuple(self.resolution.between[:, environments, None]))
        if trial is not None:
            cell = cell + trial[environments].scaled(1.0 / trials[:, None])
        return cell


def _matrix(block: Block) -> Array:
    """Covariances (J, P, P, W) of a block of entries (J, W)."""
    columns = np.stack([np.stack(column) for column in block.factor_columns()])
    return np.einsum("rpjw,rqjw->jpqw", columns, columns)
