"""The collapsed posterior density: every location and subject effect integrated out exactly."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

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
# Powers of the plastic number: their multiples fill the square evenly.
_STEPS = 1.32471795724474602596 ** np.array([-1.0, -2.0])
_LEAST = 1e-12
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
        """Mean of the pair of betas (W, J, 2), its covariance, and that of users about it (W, J, 2, 2)."""
        law = self.locations(scales)
        blocks = (law.covariance, self.population(scales))
        own, users = (np.moveaxis(_matrix(block), -1, 0) for block in blocks)
        return np.stack(law.mean).T, own, users

    def new_environment(
        self, scales: Scales, x: Array, repeats: int, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Moments at W sets of scales: the location is normal given these, log sigma is drawn evenly."""
        count, width = x.size, scales.log_prior.size
        # On alpha and gamma over their prior SDs.
        rows = np.zeros((count, 2 * count))
        rows[:, :count] = self.priors.alpha_sd * np.eye(count)
        rows[:, count:] = self.priors.gamma_sd * np.diag(x)
        mean, spread = self.locations(scales).trend(rows)
        mean = mean.T
        covariance = np.einsum("qpw,qrw->wpr", spread, spread)
        named = scales.named
        covariance[:, range(count), range(count)] += named["tau"].T ** 2
        log_sigma = np.log(named["s"]) + named.get("kappa", 0.0) * x[:, None]
        sigma = np.exp(
            log_sigma + named.get("omega", np.zeros((count, 1))) * _even((repeats, count, width), rng)
        )
        population = _covariance(np.moveaxis(sigma, -1, 0), named.get("rho_w"))
        if "sigma_u" in named:
            population = population + _covariance(named["sigma_u"].T[:, None], named.get("rho_u"))
        return (
            np.repeat(mean, repeats, axis=0),
            np.repeat(covariance, repeats, axis=0),
            population.reshape(-1, count, count),
        )

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


def _even(shape: tuple[int, int, int], rng: np.random.Generator) -> Array:
    """Return standard normals (R, P, W) that fill the square evenly, R in turn for each draw."""
    repeats, count, width = shape
    place = np.multiply.outer(np.arange(width * repeats), _STEPS[:count]) + rng.random(count)
    normals = special.ndtri(np.clip(place % 1.0, _LEAST, 1.0 - _LEAST))
    return np.moveaxis(normals.reshape(width, repeats, count), 0, -1)


def _covariance(sd: Array, rho: Array | None) -> Array:
    """Covariances (W, R, P, P) from SDs (W, R, P) and a correlation (W,)."""
    matrix = sd[..., :, None] * sd[..., None, :]
    if rho is not None:
        matrix[..., 0, 1] *= rho[:, None]
        matrix[..., 1, 0] *= rho[:, None]
    return matrix
