"""Laws of cells, users and pairs of quantities under the posterior of a linear design.

`linear` has the density; intervals, curves and verdicts rest on the laws here. Given the scales at
one set of coordinates, all laws are normal:

    location of a combination with weights w    mean w'm, variance |w'K|²
    a user about it                             variance |w'Z|² + |w'F|²

with m the mean of the locations and K columns whose products are their covariance, both from
`CellLaw`. Z are the columns of the subjects' effects, and F is a factor of the covariance between
subjects within cells.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.cell_information import CellLaw
from percept.inference.hierarchy.cell_scales import CellScales
from percept.inference.hierarchy.covariates import Covariates
from percept.inference.hierarchy.design import (
    TREND,
    Design,
    cell_columns,
    new_cells,
    trend_rows,
)
from percept.inference.hierarchy.laws import (
    NewEnvironment,
    PairLaws,
    PriorDraws,
    SubjectLaws,
    TrendLaw,
    covariances,
    even_normals,
)
from percept.inference.hierarchy.linear import LinearModel, LinearScales
from percept.inference.hierarchy.model import MORE_ENVIRONMENTS, ONE_ENVIRONMENT, Pooled, Resolution
from percept.inference.hierarchy.priors import Named, Priors
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_covariance import SubjectCovariance
from percept.inference.hierarchy.subject_effects import draw_effects_of
from percept.inference.hierarchy.trial_scatter import TrialScatter

__all__ = ["LinearPosterior"]

Array = NDArray[np.float64]


class LinearPosterior(LinearModel, Pooled):
    """Posterior of a linear design, with the laws of its cells and of their users.

    Parameters
    ----------
    statistics : Statistics
        Of the responses; its environments are the design's cells.
    design : Design
        The columns.
    priors : Priors
        Prior scales.
    covariates : Covariates, optional
        Covariates of trials or subjects.
    scatter : TrialScatter, optional
        Scatter between trials, as `LinearModel` takes it.
    resolution : Resolution, optional
        Variance that the adjustment's resolution adds to cell means and trials.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors,
        covariates: Covariates | None = None,
        scatter: TrialScatter | None = None,
        resolution: Resolution | None = None,
    ) -> None:
        super().__init__(statistics, design, priors, covariates, scatter)
        self.resolution = resolution or Resolution()
        self.priors_in_force = self._priors_in_use()

    def _priors_in_use(self) -> dict[str, float]:
        """Priors the model uses, by their names in `Priors`."""
        design = self.design
        coefficients = list(self._slots)
        for level in self._levels:
            coefficients += level.coefficients
        used = {name.partition(":")[0] for name in coefficients}
        used.add("alpha")
        if any(term.name == TREND for term in design.fixed):
            used.add("gamma")
        if any(name.startswith("rho") for name in used):
            used.add("rho")
        if design.factors.terms:
            used.add("lambda")
        if self.covariates is not None:
            used.add("covariate")
        in_use = {}
        for name, value in vars(self.priors).items():
            # "log_s_mean" and "log_s_sd" are priors of "log_s".
            quantity, _, _ = name.rpartition("_")
            if quantity in used:
                in_use[name] = value
        return in_use

    @property
    def linear_parts(self) -> tuple[LinearPosterior, ...]:
        """Return itself: it is one model."""
        return (self,)

    @property
    def locations_count(self) -> int:
        """Number R of locations: cells, quantity by quantity, and slopes of covariates."""
        return self._problem.locations

    def identity(self) -> tuple[object, ...]:
        """Return what decides density and locations."""
        return (*super().identity(), dataclasses.astuple(self.resolution))

    def log_likelihood(self, scales: CellScales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        return super().log_likelihood(self._observed(scales))

    def locations(self, scales: CellScales) -> CellLaw:
        """Law of the locations given scales."""
        return super().locations(self._observed(scales))

    def _observed(self, scales: CellScales) -> CellScales:
        """Scales of the adjustments as recorded: their resolution adds variance."""
        between = scales.between
        trial = scales.trial
        if self.resolution.between is not None:
            between = between.plus_diagonal(tuple(self.resolution.between[..., None]))
        if trial is not None and self.resolution.trial is not None:
            by_group = self.resolution.trial[:, self.scatter.cell, None]
            trial = trial.plus_diagonal(tuple(by_group))
        return dataclasses.replace(scales, between=between, trial=trial)

    def scales(self, points: Array) -> Named:
        """Scales and correlations by name, with the typical SDs under the names of all models."""
        named = super().scales(points)
        prior_means = {"": self.priors.log_s_mean, "_e": self.priors.log_s_e_mean}
        for suffix, prior_mean in prior_means.items():
            if f"log_s{suffix}" in named:
                dimensions, deviation = named.pop(f"log_s{suffix}")
                named[f"s{suffix}"] = (dimensions, np.exp(prior_mean + deviation))
        return named

    def pairs(self, points: Array) -> PairLaws:
        """Joint law of the quantities in each cell, at coordinates (W, d)."""
        parts = [self._pairs(part) for part in self._passes(points)]
        return PairLaws(
            mean=np.concatenate([part.mean for part in parts]),
            location=np.concatenate([part.location for part in parts]),
            users=np.concatenate([part.users for part in parts]),
        )

    def _pairs(self, points: Array) -> PairLaws:
        """Joint laws of one pass."""
        scales = self.linear_scales(points).cells
        law = self.locations(scales)
        width = len(points)
        count = len(self.cells)
        size = self.design.parameters
        mean = law.mean[:, :count].reshape(width, size, -1)
        cell_rows = np.eye(count, self.locations_count)
        columns = law.columns_of(cell_rows).reshape(width, size, count // size, -1)
        users = np.einsum("qpcw,qrcw->wcpr", scales.effects, scales.effects)
        for parts in scales.between.factor_columns():
            column = np.stack(parts)
            users += np.einsum("pcw,rcw->wcpr", column, column)
        return PairLaws(
            mean=mean.swapaxes(1, 2),
            location=np.einsum("wpcq,wrcq->wcpr", columns, columns),
            users=users,
        )

    @property
    def trial_group(self) -> NDArray[np.intp]:
        """Group of trials of every subject in every cell, (N, C)."""
        subjects = len(self.statistics.subjects)
        groups = np.zeros((subjects, self._problem.cells), dtype=np.intp)
        for g, pattern in enumerate(self.statistics.patterns):
            groups[pattern.members] = self._groups_of(g)
        return groups

    def _groups_of(self, pattern: int) -> NDArray[np.intp]:
        """Group of trials of every cell of a pattern, (C,)."""
        groups = self._problem.trial_group
        # One column serves all patterns where subjects share their trial SDs.
        return np.asarray(groups[:, min(pattern, groups.shape[1] - 1)])

    def subject_laws(self, points: Array) -> SubjectLaws:
        """Laws of every subject's cell means at coordinates (W, d)."""
        scales = self.linear_scales(points).cells
        observed = self._observed(scales)
        law = self.locations(scales)
        count = len(self.cells)
        by_cell = (*self.design.cells.x.shape, len(points))  # (P, C, W)
        noise = []
        covariances = []
        for g, pattern in enumerate(self.statistics.patterns):
            present = pattern.environments
            pattern_noise = observed.between[present]
            if observed.trial is not None:
                per_trial = observed.trial[self._groups_of(g)[present]]
                trials = pattern.trials[:, None]
                pattern_noise = pattern_noise + per_trial.scaled(1.0 / trials)
            effects = scales.effects[:, :, present]
            noise.append(pattern_noise)
            covariances.append(SubjectCovariance(pattern_noise, effects))
        mean = law.mean[:, :count].T
        cell_rows = np.eye(count, self.locations_count)
        columns = law.columns_of(cell_rows).transpose(2, 1, 0)
        return SubjectLaws(
            mean=mean.reshape(by_cell),
            columns=columns.reshape(-1, *by_cell),
            effects=scales.effects,
            noise=tuple(noise),
            covariances=tuple(covariances),
            trial=observed.trial,
        )

    def draw_subject_effects(
        self, points: Array, locations: Array, rng: np.random.Generator
    ) -> Array | None:
        """Draw what every subject adds, averaged over all cells, (W, N, P).

        None with covariates: `locations` are of cells only, and hold no slopes.
        """
        if self.covariates is not None:
            return None
        effects = []
        first = 0
        for part in self._passes(points):
            last = first + len(part)
            laws = self.subject_laws(part)
            effects.append(draw_effects_of(laws, self.statistics, locations[first:last], rng))
            first = last
        return np.concatenate(effects)

    def with_bias_prior(self, alpha_sd: float) -> LinearPosterior:
        """Return the same model with another prior of the common bias."""
        priors = dataclasses.replace(self.priors, alpha_sd=alpha_sd)
        return LinearPosterior(
            self.statistics,
            self.design.under(priors),
            priors,
            self.covariates,
            self.scatter,
            self.resolution,
        )

    def draw_prior(self, draws: int, rng: np.random.Generator) -> PriorDraws:
        """Draw scales, population means and new users before any data."""
        statistics = dataclasses.replace(
            self.statistics,
            sd=np.zeros_like(self.statistics.sd),
            trial_rows=np.zeros_like(self.statistics.trial_rows),
        )
        scatter = dataclasses.replace(
            self.scatter,
            rows=np.zeros_like(self.scatter.rows),
            response_rows=np.zeros_like(self.scatter.response_rows),
        )
        # Without observed scatter every coordinate is standard normal a priori.
        blank = LinearPosterior(statistics, self.design, self.priors, self.covariates, scatter)
        points = rng.standard_normal((draws, len(blank.names)))
        means = []
        users = []
        for part in blank._passes(points):
            scales = blank.linear_scales(part).cells
            location = self._draw_locations(scales, rng)
            means.append(location)
            users.append(location + self._draw_departures(scales, rng))
        return PriorDraws(blank.scales(points), np.concatenate(means), np.concatenate(users))

    def _draw_locations(self, scales: CellScales, rng: np.random.Generator) -> Array:
        """Draw the locations of all cells before any data, (W, P C)."""
        problem = self._problem
        column_sd = problem.own_sd(scales.tau)
        deviation_sd = np.repeat(column_sd, problem.environments, axis=0)  # (a J, W)
        width = deviation_sd.shape[1]
        latents = rng.standard_normal((problem.basis.shape[1], width))
        latents[: problem.deviations] *= deviation_sd
        return np.asarray((problem.basis @ latents).T)

    def _draw_departures(self, scales: CellScales, rng: np.random.Generator) -> Array:
        """Draw what a new user adds to the locations of all cells, (W, P C)."""
        count, *_, width = scales.effects.shape
        effects = rng.standard_normal((count, width))
        departures = np.einsum("qpcw,qw->pcw", scales.effects, effects)
        for parts in scales.between.factor_columns():
            factor_column = np.stack(parts)  # (P, C, W)
            departures += factor_column * rng.standard_normal(factor_column.shape[1:])
        return departures.reshape(-1, width).T

    def trends(self, points: Array) -> dict[str, TrendLaw]:
        """Law of bias over decades of the reference at coordinates (W, d), by condition."""
        self._refuse_one_environment()
        rows = trend_rows(self.design, self.priors)
        stacked = np.concatenate(list(rows.values()))
        means = []
        covariances_of_parts = []
        for part in self._passes(points):
            law = self.locations(self.linear_scales(part).cells)
            mean, columns = law.fixed(stacked)
            shape = (len(part), len(rows), 2, self.design.parameters)
            by_line = columns.reshape(*shape, -1)
            means.append(mean.reshape(shape).swapaxes(2, 3))
            covariances_of_parts.append(np.einsum("wcapk,wcbpk->wcpab", by_line, by_line))
        mean = np.concatenate(means)
        covariance = np.concatenate(covariances_of_parts)
        laws = {}
        for number, name in enumerate(rows):
            laws[name] = TrendLaw(mean[:, number], covariance[:, number])
        return laws

    def _refuse_one_environment(self) -> None:
        """Refuse a trend over references where there is one environment."""
        if len(self.design.cells.environments) < 2:
            raise RefusalError(ONE_ENVIRONMENT, hint=MORE_ENVIRONMENTS)

    def new_environment(
        self, points: Array, x: Array, repeats: int, rng: np.random.Generator
    ) -> dict[str, NewEnvironment]:
        """Laws of an untested environment, by the levels of all factors."""
        self._refuse_one_environment()
        design = new_cells(self.design, x, self.priors)
        laws = {}
        for number, name in enumerate(design.cells.names):
            cell = design.at(np.array([number]))
            parts = []
            for part in self._passes(points):
                parts.append(self._new_cell(part, cell, repeats, rng))
            laws[name] = NewEnvironment(
                mean=np.concatenate([part.mean for part in parts]),
                covariance=np.concatenate([part.covariance for part in parts]),
                population=np.concatenate([part.population for part in parts]),
            )
        return laws

    def _new_cell(
        self, points: Array, cell: Design, repeats: int, rng: np.random.Generator
    ) -> NewEnvironment:
        """Laws of the one new cell of a design."""
        linear = self.linear_scales(points)
        mean, covariance = self._new_location(linear, cell)
        reading = self.reading(points)
        effects = self.effects(reading, cell)[:, :, 0]  # (q, P, W)
        of_effects = np.einsum("qpw,qrw->wpr", effects, effects)
        within_cell = self._new_spread(linear, cell, repeats, rng)
        population = of_effects[:, None] + within_cell
        return NewEnvironment(
            mean=np.repeat(mean, repeats, axis=0),
            covariance=np.repeat(covariance, repeats, axis=0),
            population=population.reshape(-1, *of_effects.shape[1:]),
        )

    def _new_location(self, linear: LinearScales, cell: Design) -> tuple[Array, Array]:
        """Mean (W, P) and covariance (W, P, P) of the location of a new cell."""
        rows = [np.diag(column) for column in cell_columns(cell.fixed)]
        law = self.locations(linear.cells)
        mean, columns = law.fixed(np.concatenate(rows, axis=1))
        covariance = np.einsum("wpq,wrq->wpr", columns, columns)
        deviation_columns = cell_columns(cell.own)
        deviation_variance = linear.cells.tau**2
        of_deviations = np.einsum("op,opw->wp", np.square(deviation_columns), deviation_variance)
        diagonal = np.arange(self.design.parameters)
        covariance[:, diagonal, diagonal] += of_deviations
        return mean, covariance

    def _new_spread(
        self, linear: LinearScales, cell: Design, repeats: int, rng: np.random.Generator
    ) -> Array:
        """Covariances (W, R, P, P) of users within the cell, log sigma drawn about its columns."""
        level = self._levels[0]
        named = linear.named
        columns = cell_columns(cell.between)
        log_sigma = np.asarray(self.priors.log_s_mean)
        for name, column in zip(level.coefficients, columns, strict=True):
            # The columns carry the prior SDs of their coefficients.
            over_prior_sd = named[name] / self._prior_sd(name)
            log_sigma = log_sigma + column[:, None] * over_prior_sd
        size = self.design.parameters
        normals = even_normals(repeats, size, len(linear.log_prior), rng)  # (R, P, W)
        sigma = np.exp(log_sigma + named["omega"] * normals)
        by_draw = np.moveaxis(sigma, -1, 0)
        return covariances(by_draw, named.get(level.rho))

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the locations of all cells jointly and one new user of all cells, each (W, P C)."""
        cells = np.eye(len(self.cells), self.locations_count)
        return self.draw_of(cells, points, rng)

    def draw_of(
        self, rows: Array, points: Array, rng: np.random.Generator, *, repeats: int = 1
    ) -> tuple[Array, Array]:
        """Draw combinations (L, R) of the locations jointly, and those of new users.

        Parameters
        ----------
        rows : ndarray
            Weights, as `laws_of` takes them.
        points : ndarray
            Coordinates (W, d).
        rng : Generator
            Where draws come from.
        repeats : int
            Draws for each set of coordinates.

        Returns
        -------
        locations, users : ndarray
            Shape (W repeats, L) each. Coordinates are worked on in passes. A pass gives one draw
            for each of its coordinates, then another for each, before the next pass begins.
        """
        locations = []
        users = []
        for part in self._passes(points):
            location, user = self._draw_of(rows, part, rng, repeats)
            locations.append(location)
            users.append(user)
        return np.concatenate(locations), np.concatenate(users)

    def _draw_of(
        self, rows: Array, points: Array, rng: np.random.Generator, repeats: int
    ) -> tuple[Array, Array]:
        """Draws of one pass."""
        scales = self.linear_scales(points).cells
        law = self.locations(scales)
        size, cells = self.design.cells.x.shape
        width = len(points)
        columns = law.columns_of(rows)
        latents = rng.standard_normal((repeats, width, columns.shape[2]))
        locations = law.mean @ rows.T + np.einsum("wlq,rwq->rwl", columns, latents)
        weights = rows[:, : len(self.cells)].reshape(-1, size, cells)
        effect_columns = np.einsum("lpc,qpcw->wlq", weights, scales.effects)
        effects = rng.standard_normal((repeats, width, effect_columns.shape[2]))
        users = locations + np.einsum("wlq,rwq->rwl", effect_columns, effects)
        for parts in scales.between.factor_columns():
            factor_column = np.einsum("lpc,pcw->wlc", weights, np.stack(parts))
            normals = rng.standard_normal((repeats, width, cells))
            users += np.einsum("wlc,rwc->rwl", factor_column, normals)
        count = repeats * width
        return locations.reshape(count, -1), users.reshape(count, -1)
