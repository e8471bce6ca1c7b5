"""The collapsed posterior of environments without factors: locations integrated out exactly.

The response of subject i in environment j, trial t, is beta_j + u_i + w_ij + e_ijt, with one entry
for each of P quantities. u, w and e are normal about zero with the covariances shared, between and
trial of `Scales`; beta has the trend and the environments' biases that `regression` states. Given
the scales all is normal, so beta and u are integrated out, and the sampler sees scales only.

The cell means of patterns have two forms of the density. `regression` is orthogonal and serves one
pattern, and draws of any size. `information` is faster with several patterns; where it says that a
draw has lost its digits, the regression takes that draw. The scatter of trials within cells, and
that of subjects within patterns, holds no location.

Shapes: P quantities, J environments, E of them in a pattern, N subjects, C = P J cells, quantity by
quantity, W sets of d coordinates.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.blocks import Block
from percept.inference.hierarchy.information import Information
from percept.inference.hierarchy.information_problem import InformationProblem
from percept.inference.hierarchy.laws import (
    ConditionalMoments,
    NewEnvironment,
    PairLaws,
    PriorDraws,
    SubjectLaws,
    TrendLaw,
    joined,
)
from percept.inference.hierarchy.model import (
    MORE_ENVIRONMENTS,
    ONE_ENVIRONMENT,
    Pooled,
    Resolution,
)
from percept.inference.hierarchy.prior_draws import draw_prior_of
from percept.inference.hierarchy.priors import Named, Priors, draws_first
from percept.inference.hierarchy.regression import LocationProblem, Regression
from percept.inference.hierarchy.scales import Layout, Options, Scales
from percept.inference.hierarchy.shared_covariance import SharedCovariance
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_effects import draw_subject_effects
from percept.inference.hierarchy.trend_laws import new_environment_given, trend_given

__all__ = ["CollapsedDensity"]

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)
#: Coordinates times draws of a pass: fewer waste calls, and more leave the processor's cache.
_NUMBERS_PER_PASS = 49152
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

    Attributes
    ----------
    layout : Layout
        Names of the d coordinates, and their map to scales.
    dimension : int
        Their number d.
    draws_per_pass : int
        Draws that are computed at once.
    regression : LocationProblem
        The orthogonal form of the cell means.
    information : InformationProblem or None
        The faster form for several patterns and several environments.
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
        options = options or Options()
        self.layout = Layout(statistics, self.priors, options)
        self.names = self.layout.names
        self.dimension = self.layout.dimension
        self.priors_in_force = self.layout.priors_in_force
        cells = itertools.product(statistics.parameters, statistics.environments)
        self.cells = tuple(cells)
        self.regression = LocationProblem(statistics, self.layout, self.priors)
        self.information: InformationProblem | None = None
        draws = max(_FEWEST_DRAWS, _NUMBERS_PER_PASS // self.dimension)
        self.draws_per_pass = min(_MOST_DRAWS, draws)
        if self.layout.trend and len(statistics.patterns) > 1:
            self.information = InformationProblem(statistics.patterns, self.regression.trend)
            self.draws_per_pass = self.information.draws_per_pass
        trials = 0.0
        for pattern in statistics.patterns:
            trials += pattern.subjects * pattern.trials.sum()
        responses = len(statistics.parameters) * float(trials)
        log_powers = 0.5 * _LOG_2PI * responses
        self._constant = statistics.constant - log_powers

    def identity(self) -> tuple[object, ...]:
        """Return statistics, priors, options and resolution: they decide everything."""
        return (
            "pooled",
            dataclasses.astuple(self.statistics),
            dataclasses.astuple(self.priors),
            dataclasses.astuple(self.layout.options),
            dataclasses.astuple(self.resolution),
        )

    def _scales_at(self, points: Array) -> Scales:
        """Scales at coordinates (W, d), all at once."""
        return self.layout.scales(np.ascontiguousarray(points.T))

    def _passes(self, points: Array) -> Iterator[Scales]:
        """Scales at coordinates (W, d), some draws at a time."""
        for start in range(0, len(points), self.draws_per_pass):
            end = start + self.draws_per_pass
            yield self._scales_at(points[start:end])

    def __call__(self, points: Array) -> Array:
        """Log posterior density of coordinates (W, d), up to the evidence, shape (W,)."""
        count = len(points)
        if count % self.draws_per_pass == 1:
            # Sums over a single column run in another order: keep values independent of the batch.
            points = np.concatenate([points, points[-1:]])
        inside = np.all(np.abs(points) <= self.layout.limits, axis=1)
        # Points outside are computed at zero, so that no pass depends on how many there are.
        coordinates = np.where(inside[:, None], points, 0.0)
        values = []
        # Draws far out overflow; they become NaN, which has no density.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            for scales in self._passes(coordinates):
                values.append(scales.log_prior + self.log_likelihood(scales))
        value = np.concatenate(values)[:count]
        possible = inside[:count] & ~np.isnan(value)
        return np.where(possible, value, -np.inf)

    def log_likelihood(self, scales: Scales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        value = np.full(scales.log_prior.shape, self._constant)
        trial = self._trial_covariance(scales)
        if trial is not None:
            rows = tuple(self.statistics.trial_rows[..., None])
            squares = trial.distance(rows).sum(axis=0)
            by_environment = trial.log_determinant()
            determinants = np.einsum("j,jw->w", self.statistics.trial_df, by_environment)
            value = value - 0.5 * (squares + determinants)
        return value + self._of_cell_means(scales)

    def _of_cell_means(self, scales: Scales) -> Array:
        """Log density of the cell means, (W,)."""
        if self.information is None:
            return self._by_regression(scales)
        law = self._by_information(self.information, scales)
        if not law.sound.all():
            lost = np.flatnonzero(~law.sound)
            law.log_density[lost] = self._by_regression(scales[lost])
        return law.log_density

    def _by_regression(self, scales: Scales) -> Array:
        """Log density of the cell means, by the orthogonal form."""
        cell_noise = self.cell_noise(scales)
        about_means = np.zeros(scales.log_prior.shape)
        for pattern, noise in zip(self.statistics.patterns, cell_noise, strict=True):
            if pattern.subjects > 1:
                covariance = SharedCovariance(noise, scales.shared)
                df = pattern.subjects - 1.0
                determinants = df * covariance.log_determinant()
                squares = covariance.scatter_distance(pattern.rows)
                about_means -= 0.5 * (determinants + squares)
        law = Regression(self.regression, scales, cell_noise, merge=True)
        return about_means + law.log_density

    def _by_information(self, problem: InformationProblem, scales: Scales) -> Information:
        """Locations by their information, which may lack digits."""
        noise = self._noise_of(scales, problem.environment, problem.trials)
        return Information(problem, scales, noise)

    def locations(self, scales: Scales) -> Regression | Information:
        """Law of beta given W sets of scales and the data: exactly Gaussian."""
        if self.information is not None:
            law = self._by_information(self.information, scales)
            if law.sound.all():
                return law
        return Regression(self.regression, scales, self.cell_noise(scales))

    def population(self, scales: Scales) -> Block:
        """Covariance of users about beta in each environment, entries (J, W)."""
        if scales.shared is None:
            return scales.between
        shape = (self.layout.environments, scales.log_prior.size)
        shared = scales.shared.mapped(lambda part: np.broadcast_to(part, shape))
        return shared + scales.between

    def _trial_covariance(self, scales: Scales) -> Block | None:
        """Covariance between trials with the resolution's share, entries (J, W)."""
        if scales.trial is None or self.resolution.trial is None:
            return scales.trial
        resolution = self.resolution.trial[..., None]
        return scales.trial.plus_diagonal(tuple(resolution))

    def cell_noise(self, scales: Scales) -> list[Block]:
        """Covariance of a subject's cell means about beta + u, per pattern, entries (E, W)."""
        noise = []
        for pattern in self.statistics.patterns:
            noise.append(self._noise_of(scales, pattern.environments, pattern.trials))
        return noise

    def _noise_of(
        self,
        scales: Scales,
        environments: NDArray[np.intp],
        trials: Array,
    ) -> Block:
        """Covariance of cell means of so many trials about beta + u, entries (E, W)."""
        noise = scales.between[environments]
        if self.resolution.between is not None:
            resolution = self.resolution.between[:, environments, None]
            noise = noise.plus_diagonal(tuple(resolution))
        trial = self._trial_covariance(scales)
        if trial is not None:
            share = 1.0 / trials[:, None]
            noise = noise + trial[environments].scaled(share)
        return noise

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of beta and of the population at coordinates (W, d), each (W, C)."""
        return joined([self.moments(scales) for scales in self._passes(points)])

    def moments(self, scales: Scales) -> ConditionalMoments:
        """Moments of beta and of the population given scales, each (W, C)."""
        law = self.locations(scales)
        variance = np.concatenate(law.covariance.diagonal())
        population_variance = np.concatenate(self.population(scales).diagonal())
        mean = np.concatenate(law.mean)
        return ConditionalMoments(
            mean=mean.T,
            sd=np.sqrt(variance).T,
            population_sd=np.sqrt(population_variance).T,
        )

    def pairs(self, points: Array) -> PairLaws:
        """Joint law of both quantities in each environment, at coordinates (W, d)."""
        return joined([self._pairs(scales) for scales in self._passes(points)])

    def _pairs(self, scales: Scales) -> PairLaws:
        law = self.locations(scales)
        return PairLaws(
            mean=np.stack(law.mean).T,
            location=_matrices(law.covariance),
            users=_matrices(self.population(scales)),
        )

    @property
    def trial_group(self) -> NDArray[np.intp]:
        """Group of trials of every subject in every environment, (N, J): its environment."""
        subjects = len(self.statistics.subjects)
        environments = np.arange(self.layout.environments)
        return np.tile(environments, (subjects, 1))

    def subject_laws(self, points: Array) -> SubjectLaws:
        """Say what coordinates (W, d) tell of every subject's cell means."""
        return self.subject_laws_at(self._scales_at(points))

    def subject_laws_at(self, scales: Scales) -> SubjectLaws:
        """Say what W sets of scales tell of every subject's cell means."""
        law = self.locations(scales)
        mean = np.stack(law.mean)
        effects = np.zeros((0, *mean.shape))
        if scales.shared is not None:
            columns = []
            for column in scales.shared.factor_columns():
                by_quantity = np.stack(column)[:, None]
                columns.append(np.broadcast_to(by_quantity, mean.shape))
            effects = np.stack(columns)
        noise = self.cell_noise(scales)
        covariances = [SharedCovariance(of_pattern, scales.shared) for of_pattern in noise]
        return SubjectLaws(
            mean=mean,
            columns=law.columns(),
            effects=effects,
            noise=tuple(noise),
            covariances=tuple(covariances),
            trial=self._trial_covariance(scales),
        )

    def draw_subject_effects(
        self, points: Array, locations: Array, rng: np.random.Generator
    ) -> Array | None:
        """Draw what every subject adds to all environments, (W, N, P)."""
        scales = self._scales_at(points)
        if scales.shared is None:
            return None
        noise = self.cell_noise(scales)
        return draw_subject_effects(self.statistics, scales.shared, noise, locations, rng)

    def draw_prior(self, draws: int, rng: np.random.Generator) -> PriorDraws:
        """Draw scales, population means and new users before any data."""
        options = self.layout.options
        return draw_prior_of(self.statistics, self.priors, options, draws, rng)

    def new_environment(
        self,
        points: Array,
        x: Array,
        repeats: int,
        rng: np.random.Generator,
    ) -> dict[str, NewEnvironment]:
        """Laws of an untested environment, under an empty name."""
        self._refuse_one_environment()
        parts = []
        for scales in self._passes(points):
            law = self.locations(scales)
            of_pass = new_environment_given(law, scales, x, repeats, self.priors, rng)
            parts.append(of_pass)
        return {"": joined(parts)}

    def trends(self, points: Array) -> dict[str, TrendLaw]:
        """Law of bias over decades of the reference at coordinates (W, d), under an empty name."""
        self._refuse_one_environment()
        parts = []
        for scales in self._passes(points):
            law = self.locations(scales)
            parts.append(trend_given(law, self.priors, self.layout.parameters))
        return {"": joined(parts)}

    def _refuse_one_environment(self) -> None:
        if not self.layout.trend:
            raise RefusalError(ONE_ENVIRONMENT, hint=MORE_ENVIRONMENTS)

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw beta of all cells jointly and one new user of each environment, each (W, C)."""
        locations = []
        users = []
        cells = len(self.cells)
        for scales in self._passes(points):
            beta = self.locations(scales).draw(rng)
            user = beta.copy()
            for column in self.population(scales).factor_columns():
                normals = rng.standard_normal(beta.shape[1:])
                user += np.stack(column) * normals
            locations.append(beta.reshape(cells, -1).T)
            users.append(user.reshape(cells, -1).T)
        return np.concatenate(locations), np.concatenate(users)

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
