"""The density of a linear design, and the laws of its locations.

A linear design covers cells, factors, groups and covariates. `design` says which columns there are,
`linear_scales` maps coordinates to scales, and `cell_information` integrates the locations out of
the responses given scales. `LinearModel` joins the three: at coordinates x with scales s(x),

    log density(x) = log prior(x) + log p(cell means | s) + log p(scatter between trials | s)

The shapes of arrays use these numbers throughout:

    W  sets of coordinates            P  quantities              C  cells
    d  coordinates                    T  groups of trials        q  columns of subjects' effects
    R  locations: P C cells, quantity by quantity, then the slopes of covariates
    L  combinations of locations, each a row of R weights

One user differs from the locations by effects on all cells, which have the columns Z, and by a
departure in each cell with the covariance S over the quantities. A combination of cells with
weights w varies between users by |Z'w|² + w'Sw.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.model.cell_information import CellLaw, log_density
from percept.inference.model.cell_problem import CellProblem
from percept.inference.model.cell_scales import CellScales
from percept.inference.model.covariates import Covariates
from percept.inference.model.design import TREND, Design
from percept.inference.model.laws import ConditionalMoments, joined
from percept.inference.model.linear_scales import LinearCoordinates, LinearScales
from percept.inference.model.model import Model, Resolution
from percept.inference.model.priors import Named, Priors, draws_first
from percept.inference.model.statistics import Statistics
from percept.inference.model.trial_scatter import TrialScatter

__all__ = ["LinearModel"]

Array = NDArray[np.float64]

_LOG_2PI = float(np.log(2.0 * np.pi))


class LinearModel(Model):
    """Posterior of the scales and correlations of a linear design.

    Parameters
    ----------
    statistics : Statistics
        Of the responses; its environments are the design's cells.
    design : Design
        The columns.
    priors : Priors, optional
        Prior scales.
    covariates : Covariates, optional
        Covariates of trials or subjects.
    scatter : TrialScatter, optional
        Scatter between trials: of every subject if subjects have their own trial SDs, pooled with
        covariates. Without either, it comes from the statistics.
    resolution : Resolution, optional
        Variance that the adjustment's resolution adds to cell means and trials.

    Attributes
    ----------
    coordinates : LinearCoordinates
        Names of the coordinates, and their map to scales.
    problem : CellProblem
        What the data and the design say of the locations before any scale is known.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors | None = None,
        covariates: Covariates | None = None,
        scatter: TrialScatter | None = None,
        resolution: Resolution | None = None,
    ) -> None:
        self.statistics = statistics
        self.design = design
        self.priors = priors or Priors()
        self.covariates = covariates
        self.scatter = scatter or _pooled(statistics)
        self.resolution = resolution or Resolution()
        cells = itertools.product(statistics.parameters, design.cells.names)
        self.cells = tuple(cells)
        self.coordinates = LinearCoordinates(statistics, design, self.priors, self.scatter)
        self.names = self.coordinates.names
        self.priors_in_force = self._priors_in_use()
        covariate_sd = self.priors.covariate_sd
        compares = bool(design.factors.terms) or design.factors.slopes or covariates is not None
        self.takes_options = not compares and self.scatter.subject is None
        self.problem = CellProblem(statistics, design, self.scatter, covariate_sd, covariates)
        effects = 0
        for term in design.subject:
            effects += len(term.columns) * design.parameters
        self._draws_per_pass = self.problem.draws_per_pass(effects)
        trials = 0.0
        for pattern in statistics.patterns:
            trials += pattern.subjects * pattern.trials.sum()
        log_powers = 0.5 * _LOG_2PI * trials * design.parameters
        self._constant = statistics.constant - log_powers

    def _priors_in_use(self) -> dict[str, float]:
        """Priors the model uses, by their names in `Priors`."""
        scales = list(self.coordinates.slots)
        for level in self.coordinates.levels:
            scales += [f"log_s{level.suffix}", *level.coefficients]
        used = {name.partition(":")[0] for name in scales}
        used.add("alpha")
        if any(term.name == TREND for term in self.design.fixed):
            used.add("gamma")
        if any(name.startswith("rho") for name in used):
            used.add("rho")
        if self.design.factors.terms:
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

    def identity(self) -> tuple[object, ...]:
        """Return what decides density and locations."""
        covariates: tuple[object, ...] | None = None
        if self.covariates is not None:
            covariates = dataclasses.astuple(self.covariates)
        return (
            "linear",
            dataclasses.astuple(self.statistics),
            self.design.identity(),
            dataclasses.astuple(self.priors),
            covariates,
            dataclasses.astuple(self.scatter),
            dataclasses.astuple(self.resolution),
        )

    @property
    def locations_count(self) -> int:
        """Number R of locations: cells, quantity by quantity, and slopes of covariates."""
        return self.problem.locations

    @property
    def cell_rows(self) -> Array:
        """Weights (P C, R) of each cell's location by itself."""
        return np.eye(len(self.cells), self.locations_count)

    def passes(self, points: Array) -> list[Array]:
        """Points in parts that the processor's cache holds."""
        parts = []
        for start in range(0, len(points), self._draws_per_pass):
            end = start + self._draws_per_pass
            parts.append(points[start:end])
        return parts

    def linear_scales(self, points: Array) -> LinearScales:
        """Map coordinates (W, d) to scales."""
        return self.coordinates(points)

    def scales(self, points: Array) -> Named:
        """Scales and correlations by name at coordinates: dimensions and values, draws first."""
        parts = []
        for part in self.passes(points):
            parts.append(draws_first(self.linear_scales(part).named))
        named: Named = {}
        for name, (dimensions, _) in parts[0].items():
            values = np.concatenate([part[name][1] for part in parts])
            named[name] = (dimensions, values)
        # The last dimension of these is not the environment.
        last_dimensions = {"phi": "subject"}
        for term in self.design.effect_size:
            last_dimensions[f"eta:{term.name}"] = f"{term.name} column"
        for name, last in last_dimensions.items():
            if name in named:
                _, values = named[name]
                named[name] = (("parameter", last), values)
        prior_means = {"": self.priors.log_s_mean, "_e": self.priors.log_s_e_mean}
        for level in self.coordinates.levels:
            if f"log_s{level.suffix}" not in named:
                continue
            # Typical SDs themselves.
            dimensions, deviation = named.pop(f"log_s{level.suffix}")
            typical_sd = np.exp(prior_means[level.suffix] + deviation)
            named[f"s{level.suffix}"] = (dimensions, typical_sd)
        return named

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        count = len(points)
        if count % self._draws_per_pass == 1:
            # Sums over a single column run in another order: keep values independent of the batch.
            points = np.concatenate([points, points[-1:]])
        inside = np.all(np.abs(points) <= self.coordinates.limits, axis=1)
        # Points outside are computed at zero, so that no pass depends on how many there are.
        coordinates = np.where(inside[:, None], points, 0.0)
        values = []
        # Draws far out overflow; they become NaN, which has no density.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            for part in self.passes(coordinates):
                scales = self.linear_scales(part)
                values.append(scales.log_prior + self.log_likelihood(scales.cells))
        value = np.concatenate(values)[:count]
        possible = inside[:count] & ~np.isnan(value)
        return np.where(possible, value, -np.inf)

    def log_likelihood(self, scales: CellScales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        observed = self.with_resolution(scales)
        value = self._constant + log_density(self.problem, observed)
        if observed.trial is None:
            return value
        rows = tuple(self.scatter.rows[..., None])
        squares = observed.trial.distance(rows).sum(axis=0)
        determinants = self.scatter.df @ observed.trial.log_determinant()
        return np.asarray(value - 0.5 * (squares + determinants))

    def with_resolution(self, scales: CellScales) -> CellScales:
        """Scales of the adjustments as recorded: their resolution adds variance."""
        if self.resolution.between is None and self.resolution.trial is None:
            return scales
        between = scales.between
        trial = scales.trial
        if self.resolution.between is not None:
            every_draw = self.resolution.between[..., None]
            between = between.plus_diagonal(tuple(every_draw))
        if trial is not None and self.resolution.trial is not None:
            by_group = self.resolution.trial[:, self.scatter.cell, None]
            trial = trial.plus_diagonal(tuple(by_group))
        return dataclasses.replace(scales, between=between, trial=trial)

    def locations(self, scales: CellScales) -> CellLaw:
        """Law of the locations given scales and data."""
        return CellLaw(self.problem, self.with_resolution(scales))

    def laws(self, points: Array) -> ConditionalMoments:
        """Law of every cell's location and of its users at coordinates (W, d)."""
        return self.laws_of(self.cell_rows, points)

    def laws_of(self, rows: Array, points: Array) -> ConditionalMoments:
        """Law of combinations of the locations, and of the same combinations of one user's cells.

        Parameters
        ----------
        rows : ndarray
            Weights of cells, quantity by quantity, and then of slopes of covariates, (L, R).
        points : ndarray
            Coordinates (W, d).
        """
        laws = []
        for part in self.passes(points):
            laws.append(self.laws_given(rows, self.linear_scales(part).cells))
        return joined(laws)

    def laws_given(self, rows: Array, scales: CellScales) -> ConditionalMoments:
        """Law of combinations (L, R) of the locations and of one user's cells, given scales."""
        law = self.locations(scales)
        return ConditionalMoments(
            mean=law.mean @ rows.T,
            sd=np.sqrt(law.variances_of(rows)),
            population_sd=np.sqrt(self._user_variance(rows, scales)),
        )

    def log_user_sds(self, rows: Array, points: Array) -> Array:
        """Log SDs of one user's combinations about the locations', at (W, d): shape (W, L)."""
        log_sds = []
        for part in self.passes(points):
            scales = self.linear_scales(part).cells
            user_variance = self._user_variance(rows, scales)
            log_sds.append(0.5 * np.log(user_variance))
        return np.concatenate(log_sds)

    def cell_weights(self, rows: Array) -> Array:
        """Weights (L, P, C) of the cells among those (L, R) of all locations."""
        size, cells = self.design.cells.x.shape
        of_cells = rows[:, : size * cells]
        return of_cells.reshape(-1, size, cells)

    def _user_variance(self, rows: Array, scales: CellScales) -> Array:
        """Variance of one user's combinations about the locations', (W, L)."""
        weights = self.cell_weights(rows)
        count, size, cells = weights.shape
        # Most combinations are of few cells.
        flat = sparse.csr_array(weights.reshape(count, size * cells))
        width = scales.effects.shape[-1]
        variance = np.zeros((count, width))
        for column in scales.effects:
            variance += (flat @ column.reshape(size * cells, width)) ** 2
        row, cell = np.nonzero(weights.any(axis=1))
        terms = np.arange(len(row))
        of_row = sparse.csr_array((np.ones(len(row)), (row, terms)), shape=(count, len(row)))
        for parts in scales.between.factor_columns():
            factor_column = np.stack(parts)[:, cell]  # (P, terms, W)
            departures = np.einsum("np,pnw->nw", weights[row, :, cell], factor_column)
            variance += of_row @ departures**2
        return np.asarray(variance.T)


def _pooled(statistics: Statistics) -> TrialScatter:
    """Scatter between trials of subjects pooled, as the statistics hold it."""
    size, cells = statistics.x.shape
    return TrialScatter(
        cell=np.arange(cells),
        subject=None,
        df=statistics.trial_df,
        rows=statistics.trial_rows,
        covariate_rows=np.zeros((0, 0, cells)),
        response_rows=np.zeros((0, size, cells)),
    )
