"""The collapsed posterior density: every location and subject effect integrated out exactly."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block
from percept.inference.hierarchy.covariance import SharedCovariance
from percept.inference.hierarchy.least_squares import factor
from percept.inference.hierarchy.locations import LocationProblem
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Layout, Options, Scales
from percept.inference.hierarchy.statistics import Pattern, Statistics

Array = NDArray[np.float64]
#: Numbers of coordinates per pass: fewer waste calls, and temporaries beyond the processor's cache cost more.
_PASS = 49152
_LOG_2PI = math.log(2.0 * math.pi)


@dataclasses.dataclass(frozen=True)
class Resolution:
    """Variance that a finite resolution of the adjustment adds, on the response scale."""

    between: Array | None = None  # (P, J)
    trial: Array | None = None  # (P, J)


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
        cells = self.cell_blocks(scales)
        for pattern, cell in zip(statistics.patterns, cells, strict=True):
            if pattern.subjects > 1:
                covariance = SharedCovariance(cell, scales.shared)
                value = value - 0.5 * (
                    (pattern.subjects - 1.0) * covariance.log_determinant()
                    + covariance.scatter_distance(pattern.rows)
                )
        problem = self.regression.build(scales, cells)
        solved = factor(problem.design, problem.target)
        return value - 0.5 * (problem.log_determinant + solved.log_determinant + solved.distance)

    def trial_block(self, scales: Scales) -> Block | None:
        """Covariance between trials with the resolution's share, entries (J, W)."""
        if scales.trial is None or self.resolution.trial is None:
            return scales.trial
        return scales.trial.plus_diagonal(tuple(self.resolution.trial[..., None]))

    def cell_blocks(self, scales: Scales) -> list[Block]:
        """Covariance of one cell mean about the subject's effect, per pattern, entries (E, W)."""
        trial = self.trial_block(scales)
        return [self._cell_block(scales, trial, pattern) for pattern in self.statistics.patterns]

    def _cell_block(self, scales: Scales, trial: Block | None, pattern: Pattern) -> Block:
        cell = scales.between[pattern.environments]
        if self.resolution.between is not None:
            cell = cell.plus_diagonal(tuple(self.resolution.between[:, pattern.environments, None]))
        if trial is not None:
            cell = cell + trial[pattern.environments].scaled(1.0 / pattern.trials[:, None])
        return cell
