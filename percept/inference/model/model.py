"""Models of studies: what the sampler and reports need of a posterior.

A model has its locations integrated out. Its coordinates are those of the scales, near standard
normal under the prior; at coordinates x with scales s(x),

    log density(x) = log prior(x) + log p(cell means | s) + log p(scatter between trials | s)

`LinearModel` serves every study of subjects or published limits, whatever its design. Arrays have W
sets of d coordinates, P quantities, C cells, and L rows of weights on R locations, as `laws` says.
"""

from __future__ import annotations

import dataclasses
import itertools
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.design import (
    TREND,
    Cells,
    Design,
    Factors,
    Options,
    design_of,
)
from percept.inference.model.laws import Joint, Law, LinearLaw, Moments, joined
from percept.inference.model.one_row import OneRow, is_one_row
from percept.inference.model.patterns import SeveralPatterns
from percept.inference.model.priors import Named, Priors
from percept.inference.model.rows import Rows
from percept.inference.model.scales import CellScales, Coordinates, Scales
from percept.inference.model.statistics import Statistics

__all__ = ["LinearModel", "Model", "Resolution", "plain_model"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True)
class Resolution:
    """Variance that a finite resolution of the adjustment adds, on the response scale."""

    between: Array  # (P, C)
    trial: Array  # (P, C)


class Model(ABC):
    """A posterior over scales, its locations integrated out: what sampler and reports need of it.

    Coordinates are (W, d), near standard normal under the prior. Cells are sorted by quantity.
    Combinations of locations, and of new users, are rows of weights (L, R); by default each cell.
    """

    names: list[str]  # Of the coordinates
    cells: tuple[tuple[str, str], ...]  # Quantity and cell of the design, by quantity
    cell_rows: Array  # (cells, R) Weights of each cell's location by itself
    draws_per_pass: int  # Sets of coordinates worked on at once, so that the cache holds them
    priors_in_force: dict[str, float]  # By their names in `Priors`
    takes_options: bool = True  # Whether `Options` make it simpler

    @abstractmethod
    def identity(self) -> tuple[object, ...]:
        """Everything that decides density and locations: a posterior is found again by it."""

    @abstractmethod
    def __call__(self, points: Array) -> Array:
        """Log density at coordinates (W, d), up to a constant, shape (W,)."""

    @abstractmethod
    def scales(self, points: Array) -> Named:
        """Scales and correlations by name, as dimensions and values, at coordinates (W, d)."""

    @abstractmethod
    def law(self, points: Array) -> Law:
        """Law of the locations and of users at coordinates (W, d) of one pass."""

    def split(self, points: Array) -> list[tuple[LinearModel, Array]]:
        """Pooled models of which this is the product, each with its part of coordinates (W, d)."""
        return []

    def passes(self, points: Array) -> list[Array]:
        """Points in parts that the processor's cache holds."""
        starts = range(0, len(points), self.draws_per_pass)
        return [points[start : start + self.draws_per_pass] for start in starts]

    def moments(self, points: Array, rows: Array | None = None) -> Moments:
        """Laws of combinations, each by itself."""
        weights = self.cell_rows if rows is None else rows
        return joined([self.law(part).moments(weights) for part in self.passes(points)])

    def user_sds(self, points: Array, rows: Array) -> Array:
        """SDs of one user's combinations about the locations', (W, L)."""
        return np.concatenate([self.law(part).user_sd(rows) for part in self.passes(points)])

    def joint(self, points: Array, rows: Array) -> Joint:
        """Joint laws of groups of n combinations, (groups, n, R)."""
        return joined([self.law(part).joint(rows) for part in self.passes(points)])

    def draw(
        self,
        points: Array,
        rng: np.random.Generator,
        rows: Array | None = None,
        *,
        repeats: int = 1,
    ) -> tuple[Array, Array]:
        """Draw combinations of the locations jointly, and the same of new users.

        Parameters
        ----------
        points : ndarray
            Coordinates (W, d).
        rng : Generator
            Where draws come from.
        rows : ndarray, optional
            Weights (L, R); of all cells by default.
        repeats : int
            Draws for each set of coordinates.

        Returns
        -------
        locations, users : ndarray
            Shape (W repeats, L) each. A pass gives one draw for each of its coordinates, then
            another for each, before the next pass begins.
        """
        weights = self.cell_rows if rows is None else rows
        locations = []
        users = []
        for part in self.passes(points):
            location, user = self.law(part).draw(weights, rng, repeats)
            locations.append(location.reshape(-1, len(weights)))
            users.append(user.reshape(-1, len(weights)))
        return np.concatenate(locations), np.concatenate(users)


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
    resolution : Resolution, optional
        Variance that the adjustment's resolution adds to cell means and trials.

    Attributes
    ----------
    coordinates : Coordinates
        Names of the coordinates, and their map to scales.
    rows : Rows
        What the data and the design say of the locations before any scale is known.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors | None = None,
        resolution: Resolution | None = None,
    ) -> None:
        self.statistics = statistics
        self.design = design
        self.priors = priors or Priors()
        self.resolution = resolution
        self.cells = tuple(itertools.product(statistics.parameters, design.cells.names))
        self.coordinates = Coordinates(statistics, design, self.priors)
        self.names = self.coordinates.names
        self.priors_in_force = self._priors_in_use()
        covariates = statistics.covariates
        compares = bool(design.factors.terms) or covariates is not None
        self.takes_options = not compares and statistics.scatter.subject is None
        self.rows = Rows(statistics, design, self.priors.covariate_sd)
        self.locations = self.rows.locations
        self.cell_rows = np.eye(len(self.cells), self.locations)
        effect_count = len(self.coordinates.own_slopes) * design.parameters
        for term in design.subject:
            effect_count += len(term.columns) * design.parameters
        #: Density and latents given the scales.
        self._given_scales: OneRow | SeveralPatterns
        if covariates is None and is_one_row(statistics, design):
            self._given_scales = OneRow(statistics, design, self.rows.own, self.rows.fixed)
            self.draws_per_pass = self._given_scales.draws_per_pass(effect_count)
        else:
            self._given_scales = SeveralPatterns(statistics, self.rows, effect_count)
            self.draws_per_pass = self._given_scales.draws_per_pass
        self._constant = statistics.constant

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
        if "sigma_v:trend" in scales:
            used.add("sigma_trend")
        if self.design.factors.terms:
            used.add("lambda")
        if self.statistics.covariates is not None:
            used.add("covariate")
        # "log_s_mean" and "log_s_sd" are priors of "log_s".
        fields = vars(self.priors).items()
        return {name: value for name, value in fields if name.rpartition("_")[0] in used}

    def identity(self) -> tuple[object, ...]:
        """Return what decides density and locations."""
        return (
            "linear",
            dataclasses.astuple(self.statistics),
            self.design.identity(),
            dataclasses.astuple(self.priors),
            self.resolution and dataclasses.astuple(self.resolution),
        )

    @property
    def pair_rows(self) -> Array:
        """Weights (C, P, R) of the quantities of each cell."""
        by_quantity = self.cell_rows.reshape(self.design.parameters, -1, self.locations)
        return by_quantity.swapaxes(0, 1)

    def split(self, points: Array) -> list[tuple[LinearModel, Array]]:
        """Return the model itself."""
        return [(self, points)]

    def linear_scales(self, points: Array) -> Scales:
        """Map coordinates (W, d) to scales."""
        return self.coordinates(points)

    def scales(self, points: Array) -> Named:
        """Scales and correlations by name at coordinates: dimensions and values, draws first."""
        parts = [self.linear_scales(part).named for part in self.passes(points)]
        named: Named = {}
        for name, dimensions in self.coordinates.dimensions.items():
            values = [np.moveaxis(part[name], -1, 0) for part in parts]
            named[name] = (dimensions, np.concatenate(values))
        for level in self.coordinates.levels:
            if f"log_s{level.suffix}" in named:
                # Typical SDs themselves.
                dimensions, deviation = named.pop(f"log_s{level.suffix}")
                named[f"s{level.suffix}"] = (dimensions, np.exp(level.centre + deviation))
        return named

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        count = len(points)
        if count % self.draws_per_pass == 1:
            # Sums over a single column run in another order: keep values independent of the batch.
            points = np.concatenate([points, points[-1:]])
        inside = np.all(np.abs(points) <= self.coordinates.limits, axis=1)
        # Points outside are computed at zero, so that no pass depends on how many there are.
        inner_points = np.where(inside[:, None], points, 0.0)
        values = []
        # Draws far out overflow; they become NaN, which has no density.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            for part in self.passes(inner_points):
                scales = self.linear_scales(part)
                values.append(scales.log_prior + self.log_likelihood(scales.cells))
        value = np.concatenate(values)[:count]
        possible = inside[:count] & ~np.isnan(value)
        return np.where(possible, value, -np.inf)

    def log_likelihood(self, scales: CellScales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        observed = self.with_resolution(scales)
        value = self._constant + self._given_scales.log_density(observed)
        if observed.trial is None:
            return value
        scatter = self.statistics.scatter
        rows = tuple(scatter.rows[..., None])
        squares = observed.trial.distance(rows).sum(axis=0)
        determinants = scatter.df @ observed.trial.log_determinant()
        return np.asarray(value - 0.5 * (squares + determinants))

    def with_resolution(self, scales: CellScales) -> CellScales:
        """Scales of the adjustments as recorded: their resolution adds variance."""
        if self.resolution is None:
            return scales
        every_draw = self.resolution.between[..., None]
        between = scales.between.plus_diagonal(tuple(every_draw))
        trial = scales.trial
        if trial is not None:
            by_group = self.resolution.trial[:, self.statistics.scatter.cell, None]
            trial = trial.plus_diagonal(tuple(by_group))
        return dataclasses.replace(scales, between=between, trial=trial)

    def law(self, points: Array) -> Law:
        """Law of the locations and of users at coordinates (W, d) of one pass."""
        scales = self.linear_scales(points).cells
        observed = self.with_resolution(scales)
        return LinearLaw(self.rows, scales, lambda: self._given_scales.solve(observed))


def plain_model(
    statistics: Statistics,
    priors: Priors | None = None,
    options: Options | None = None,
    resolution: Resolution | None = None,
) -> LinearModel:
    """Build the model of environments without factors, which are its cells.

    Parameters
    ----------
    statistics : Statistics
        Of the responses, or of published limits: these show no effects of subjects.
    priors : Priors, optional
        Prior scales.
    options : Options, optional
        Simpler models.
    resolution : Resolution, optional
        Variance that the adjustment's resolution adds.

    Returns
    -------
    LinearModel
    """
    priors = priors or Priors()
    options = options or Options()
    if statistics.summary:
        options = dataclasses.replace(options, subject_effect=False)
    names = statistics.environments
    cells = Cells(names, np.arange(len(names)), names, statistics.x)
    factors = Factors(levels={}, level={}, terms=())
    design = design_of(cells, factors, priors, options)
    return LinearModel(statistics, design, priors, resolution)
