"""The collapsed posterior of environments without factors: locations integrated out exactly."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.blocks import Block, SharedCovariance
from percept.inference.hierarchy.information import Information
from percept.inference.hierarchy.information_problem import InformationProblem
from percept.inference.hierarchy.laws import (
    ConditionalMoments,
    NewEnvironment,
    PairLaws,
    PriorDraws,
    SubjectLaws,
    TrendLaw,
    covariances,
    even_normals,
)
from percept.inference.hierarchy.model import (
    MORE_ENVIRONMENTS,
    ONE_ENVIRONMENT,
    Pooled,
    Resolution,
)
from percept.inference.hierarchy.priors import Named, Priors, draws_first
from percept.inference.hierarchy.regression import LocationProblem, Regression
from percept.inference.hierarchy.scales import Layout, Options, Scales
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_effects import draw_subject_effects

__all__ = ["CollapsedDensity"]

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)
#: Coordinates times draws of a pass: fewer waste calls, and more leave the processor's cache.
_PASS = 49152
#: Draws of a pass, whatever their dimension.
_FEWEST_DRAWS = 128
_MOST_DRAWS = 2048


class CollapsedDensity(Pooled):
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

    @property
    def trial_group(self) -> NDArray[np.intp]:
        """Group of trials of every subject in every environment, (N, J): its environment."""
        subjects = len(self.statistics.subjects)
        return np.tile(np.arange(self.layout.environments), (subjects, 1))

    def subject_laws(self, points: Array) -> SubjectLaws:
        """Say what coordinates (W, d) tell of every subject's cell means."""
        coordinates = np.ascontiguousarray(points.T)
        return self.subject_laws_at(self.layout.scales(coordinates))

    def subject_laws_at(self, scales: Scales) -> SubjectLaws:
        """Say what W sets of scales tell of every subject's cell means."""
        law = self.locations(scales)
        mean = np.stack(law.mean)
        effects = np.zeros((0, *mean.shape))
        if scales.shared is not None:
            columns = [np.stack(column)[:, None] for column in scales.shared.factor_columns()]
            effects = np.stack([np.broadcast_to(column, mean.shape) for column in columns])
        noise = self.cell_blocks(scales)
        return SubjectLaws(
            mean=mean,
            columns=law.columns(),
            effects=effects,
            noise=tuple(noise),
            covariances=tuple(SharedCovariance(cell, scales.shared) for cell in noise),
            trial=self.trial_block(scales),
        )

    def draw_subject_effects(
        self, points: Array, locations: Array, rng: np.random.Generator
    ) -> Array | None:
        """Draw what every subject adds to all environments, (W, N, P)."""
        scales = self.layout.scales(np.ascontiguousarray(points.T))
        if scales.shared is None:
            return None
        blocks = self.cell_blocks(scales)
        return draw_subject_effects(self.statistics, scales.shared, blocks, locations, rng)

    def with_bias_prior(self, alpha_sd: float) -> CollapsedDensity:
        """Return the same model with another prior of the common bias."""
        priors = dataclasses.replace(self.priors, alpha_sd=alpha_sd)
        return CollapsedDensity(self.statistics, priors, self.layout.options, self.resolution)

    def draw_prior(self, draws: int, rng: np.random.Generator) -> PriorDraws:
        """Draw scales, population means and new users before any data."""
        statistics = self.statistics
        # Without observed scatter every coordinate of log sigma is standard normal a priori, like
        # the rest.
        blank = dataclasses.replace(
            statistics,
            sd=np.zeros_like(statistics.sd),
            trial_rows=np.zeros_like(statistics.trial_rows),
        )
        layout = Layout(blank, self.priors, self.layout.options)
        scales = layout.scales(rng.standard_normal((layout.dimension, draws)))
        alpha = self.priors.alpha_sd * rng.standard_normal((layout.parameters, 1, draws))
        beta = np.repeat(alpha, layout.environments, axis=1)
        if scales.tau is not None:
            gamma = self.priors.gamma_sd * rng.standard_normal(alpha.shape)
            beta += gamma * statistics.x[..., None]
            beta += np.stack(scales.tau)[:, None] * rng.standard_normal(beta.shape)
        user = beta.copy()
        for column in scales.between.factor_columns():
            user += np.stack(column) * rng.standard_normal(beta.shape[1:])
        if scales.shared is not None:
            for column in scales.shared.factor_columns():
                user += np.stack(column)[:, None] * rng.standard_normal(beta.shape[1:])
        return PriorDraws(
            scales=draws_first(scales.named),
            means=beta.reshape(-1, draws).T,
            users=user.reshape(-1, draws).T,
        )

    def new_environment(
        self, points: Array, x: Array, repeats: int, rng: np.random.Generator
    ) -> dict[str, NewEnvironment]:
        """Laws of an untested environment, under an empty name."""
        if not self.layout.trend:
            raise RefusalError(ONE_ENVIRONMENT, hint=MORE_ENVIRONMENTS)

        def given(scales: Scales) -> tuple[Array, Array, Array]:
            mean, covariance = self._new_location(scales, x)
            population = _new_population(scales, x, repeats, rng)
            return (
                np.repeat(mean, repeats, axis=0),
                np.repeat(covariance, repeats, axis=0),
                population.reshape(-1, x.size, x.size),
            )

        return {"": NewEnvironment(*self.by_pass(points, given))}

    def _new_location(self, scales: Scales, x: Array) -> tuple[Array, Array]:
        """Mean (W, P) and covariance (W, P, P) of the location, which is normal given scales."""
        count = x.size
        # On alpha and gamma over their prior SDs.
        rows = np.zeros((count, 2 * count))
        rows[:, :count] = self.priors.alpha_sd * np.eye(count)
        rows[:, count:] = self.priors.gamma_sd * np.diag(x)
        mean, spread = self.locations(scales).trend(rows)
        covariance = np.einsum("qpw,qrw->wpr", spread, spread)
        tau = scales.named["tau"].T
        covariance[:, range(count), range(count)] += tau**2
        return mean.T, covariance

    def trends(self, points: Array) -> dict[str, TrendLaw]:
        """Law of bias over decades of the reference at coordinates (W, d), under an empty name."""
        if not self.layout.trend:
            raise RefusalError(ONE_ENVIRONMENT, hint=MORE_ENVIRONMENTS)
        count = self.layout.parameters
        prior_sds = np.repeat([self.priors.alpha_sd, self.priors.gamma_sd], count)

        def of_scales(scales: Scales) -> tuple[Array, Array]:
            mean, spread = self.locations(scales).trend(np.diag(prior_sds))
            mean = mean.reshape(2, count, -1)
            columns = spread.reshape(-1, *mean.shape)
            return mean.T, np.einsum("qapw,qbpw->wpab", columns, columns)

        return {"": TrendLaw(*self.by_pass(points, of_scales))}

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


def _new_population(
    scales: Scales,
    x: Array,
    repeats: int,
    rng: np.random.Generator,
) -> Array:
    """Covariances of users (W, R, P, P) at W sets of scales, log sigma drawn evenly."""
    count = x.size
    width = scales.log_prior.size
    named = scales.named
    kappa = named.get("kappa", 0.0)
    log_sigma = np.log(named["s"]) + kappa * x[:, None]
    omega = named.get("omega", np.zeros((count, 1)))
    normals = even_normals(repeats, count, width, rng)
    sigma = np.exp(log_sigma + omega * normals)
    population = covariances(np.moveaxis(sigma, -1, 0), named.get("rho_w"))
    if "sigma_u" not in named:
        return population
    sigma_u = named["sigma_u"].T[:, None]
    return population + covariances(sigma_u, named.get("rho_u"))


def _matrices(block: Block) -> Array:
    """Covariances (W, J, P, P) of a block of entries (J, W)."""
    columns = np.stack(block.factor_columns())
    products = np.einsum("rpjw,rqjw->jpqw", columns, columns)
    return np.moveaxis(products, -1, 0)
