"""Models of studies: what the sampler and reports need of a posterior.

A model has its locations integrated out. Its coordinates stand for scales and are near standard
normal under the prior. At coordinates x with scales s(x),

    log density(x) = log prior(x) + log p(cell means | s) + log p(scatter between trials | s)

`LinearModel` serves every study of subjects or published limits, whatever its design. Arrays have W
sets of d coordinates, P quantities, C cells, and L rows of weights on R locations, as `laws` says.
"""

from __future__ import annotations

import dataclasses
import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.errors import RefusalError
from percept.inference.model.blocks import Block
from percept.inference.model.design import Basis, Cells, Design, Factors, Options, design_of
from percept.inference.model.gaussian import Columns, Joint, Law, Moments, joined, user_columns
from percept.inference.model.one_row import OneRow, is_one_row
from percept.inference.model.patterns import SeveralPatterns
from percept.inference.model.priors import Named, Priors
from percept.inference.model.scales import CellScales, Coordinates
from percept.inference.model.statistics import Resolution, Statistics

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


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
    parts: list[LinearModel]  # Pooled models of which this is the product; none without pooling

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
        """Each of `parts` with its own of coordinates (W, d), views."""
        counts = [len(model.names) for model in self.parts]
        ends = np.cumsum(counts)
        coordinates = np.split(points, ends[:-1], axis=1)
        # Without parts there is one piece, of nothing.
        return list(zip(self.parts, coordinates, strict=False))

    def passes(self, points: Array) -> list[Array]:
        """Points in parts that the processor's cache holds."""
        starts = range(0, len(points), self.draws_per_pass)
        return [points[start : start + self.draws_per_pass] for start in starts]

    def moments(
        self,
        points: Array,
        rows: Array | None = None,
    ) -> Moments:
        """Laws of combinations, each by itself."""
        weights = self.cell_rows if rows is None else rows
        return self.joint(points, weights[:, None]).moments()

    def joint(
        self,
        points: Array,
        rows: Array,
    ) -> Joint:
        """Joint laws of groups of n combinations, (groups, n, R)."""
        laws = [self.law(part).joint(rows) for part in self.passes(points)]
        return joined(laws)

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
        laws = [self.law(part) for part in self.passes(points)]
        drawn = [law.draw(weights, rng, repeats) for law in laws]
        locations = [of_locations for of_locations, _ in drawn]
        users = [of_users for _, of_users in drawn]
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
    basis : Basis
        The locations as combinations of latents.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors | None = None,
        resolution: Resolution | None = None,
    ) -> None:
        self.parts = [self]
        self.statistics = statistics
        self.design = design
        self.priors = priors or Priors()
        self.resolution = resolution
        self.cells = tuple(itertools.product(statistics.parameters, design.cells.names))
        self.coordinates = Coordinates(statistics, design, self.priors)
        self.names = self.coordinates.names
        covariates = statistics.covariates.names if statistics.covariates else ()
        used = self.coordinates.priors_in_use | {term.prior for term in design.fixed}
        if covariates:
            used.add("covariate_sd")
        by_name = vars(self.priors).items()
        self.priors_in_force = {name: value for name, value in by_name if name in used}
        self.basis = Basis(design, len(covariates), self.priors.covariate_sd)
        self.locations = len(self.basis.matrix)
        self.cell_rows = np.eye(len(self.cells), self.locations)
        #: Density and latents given the scales.
        self._given_scales: OneRow | SeveralPatterns
        one_row = is_one_row(statistics, design) and not covariates
        form = OneRow if one_row else SeveralPatterns
        self._given_scales = form(statistics, design, self.basis)
        self.draws_per_pass = self._given_scales.draws_per_pass

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

    @property
    def slope_rows(self) -> Array:
        """Weights (P, R) of slopes over decades of the reference; for several environments."""
        # Coefficients of fixed terms are the last locations: levels, slopes, and others.
        levels = self.locations - len(self.basis.fixed)
        slopes = levels + self.design.parameters
        of_coefficients = np.eye(self.design.parameters, self.locations, slopes)
        return self.priors.gamma_sd * of_coefficients

    def scales(self, points: Array) -> Named:
        """Scales and correlations by name at coordinates: dimensions and values, draws first."""
        parts = [self.coordinates(part).named for part in self.passes(points)]
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
        values = []
        # Draws far out overflow; they become NaN, which has no density.
        with np.errstate(all="ignore"):
            for part in self.passes(points):
                scales = self.coordinates(part)
                values.append(scales.log_prior + self.log_likelihood(scales.cells))
        value = np.concatenate(values)
        return np.where(np.isfinite(value), value, -np.inf)

    def log_likelihood(self, scales: CellScales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        observed = self.with_resolution(scales)
        value = self.statistics.constant + self._given_scales.log_density(observed)
        if observed.trial is None:
            return value
        of_groups = self.statistics.scatter.minus_twice_log_density(observed.trial)
        return np.asarray(value - 0.5 * of_groups.sum(axis=0))

    def with_resolution(self, scales: CellScales) -> CellScales:
        """Scales of the adjustments as recorded: their resolution adds variance."""
        if self.resolution is None:
            return scales
        every_draw = self.resolution.between[..., None]
        between = scales.between + Block(tuple(every_draw))
        trial = scales.trial
        if trial is not None:
            by_group = self.resolution.trial[:, self.statistics.scatter.cell, None]
            trial = trial + Block(tuple(by_group))
        return dataclasses.replace(scales, between=between, trial=trial)

    def law(self, points: Array) -> Law:
        """Law of the locations and of users at coordinates (W, d) of one pass."""
        scales = self.coordinates(points).cells
        matrix = self._given_scales.matrix
        solved = self._given_scales.solve(self.with_resolution(scales))

        def columns(weights: Array) -> Array:
            return solved.columns((weights @ matrix).T[..., None]).T

        return Law((matrix @ solved.best).T, columns, partial(user_columns, scales))


def plain_model(
    statistics: Statistics,
    priors: Priors | None = None,
    options: Options | None = None,
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

    Returns
    -------
    LinearModel
    """
    priors = priors or Priors()
    options = options or Options()
    if not statistics.subjects:
        options = dataclasses.replace(options, subject_effect=False)
    names = statistics.environments
    cells = Cells(names, np.arange(len(names)), names, statistics.x)
    factors = Factors(levels={}, level={}, terms=())
    design = design_of(cells, factors, priors, options)
    return LinearModel(statistics, design, priors)


class Product(Model):
    """Product of independent models of different quantities.

    Coordinates, cells and locations of the models stand one after another, in their order.

    Parameters
    ----------
    models : iterable of Model
        Pooled ones.
    """

    def __init__(self, models: Iterable[Model]) -> None:
        self.parts = []
        self.names: list[str] = []
        self.cells: tuple[tuple[str, str], ...] = ()
        self.priors_in_force: dict[str, float] = {}
        for model in models:
            self.parts += model.parts
            self.names += model.names
            self.cells += model.cells
            self.priors_in_force |= model.priors_in_force
        rows = linalg.block_diag(*(model.cell_rows for model in self.parts))
        self.cell_rows = np.asarray(rows)
        self.draws_per_pass = min(model.draws_per_pass for model in self.parts)

    def identity(self) -> tuple[object, ...]:
        """Return what decides each of the models."""
        return ("product", *(model.identity() for model in self.parts))

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        values = [model(part) for model, part in self.split(points)]
        return np.sum(values, axis=0)

    def scales(self, points: Array) -> Named:
        """Scales of all models by name, quantities side by side; NaN where a model has none."""
        parts = [model.scales(coordinates) for model, coordinates in self.split(points)]
        named: Named = {}
        for name in dict.fromkeys(itertools.chain(*parts)):
            dimensions, example = next(part[name] for part in parts if name in part)
            columns = []
            for model, part in zip(self.parts, parts, strict=True):
                shape = (len(points), model.design.parameters, *example.shape[2:])
                missing = np.full(shape, np.nan)
                _, values = part.get(name, (dimensions, missing))
                columns.append(values)
            named[name] = (dimensions, np.hstack(columns) if dimensions else example)
        return named

    def law(self, points: Array) -> Law:
        """Law of all locations and of users at coordinates (W, d) of one pass."""
        laws = [model.law(part) for model, part in self.split(points)]
        ends = np.cumsum([model.locations for model in self.parts])

        def side_by_side(columns: list[Columns], weights: Array) -> Array:
            by_model = np.split(weights, ends[:-1], axis=1)
            parts = zip(columns, by_model, strict=True)
            return np.concatenate([of_model(part) for of_model, part in parts], axis=2)

        return Law(
            mean=np.hstack([law.mean for law in laws]),
            columns=partial(side_by_side, [law.columns for law in laws]),
            user_columns=partial(side_by_side, [law.user_columns for law in laws]),
        )


class Unpooled(Model):
    """Each cell by itself: y ~ N(beta, sigma²), beta and log sigma flat.

    Responses are standardised by the cell's own mean and SD, so that an offset costs no digits.
    With t = log(sigma/SD) and n subjects the posterior is exp(-nu t - nu exp(-2t)/2), nu = n - 1,
    and beta given sigma is N(0, exp(2t)/n). The coordinate is t in units of 1/sqrt(2 nu), the SD of
    t at the mode.

    Parameters
    ----------
    cells : tuple of (str, str)
        Parameter and environment of each of the C cells.
    counts : ndarray of int
        Subjects n of each cell, (C,).

    Raises
    ------
    RefusalError
        If a cell has one subject.
    """

    draws_per_pass = 1024

    def __init__(
        self,
        cells: tuple[tuple[str, str], ...],
        counts: NDArray[np.int64],
    ) -> None:
        if np.any(counts < 2):
            parameter, environment = cells[int(np.argmin(counts))]
            raise RefusalError(
                f"{parameter} in {environment} has one subject; the reference prior needs two.",
                hint='Add subjects, or use pooling = "partial".',
            )
        self.cells = cells
        self.cell_rows = np.eye(len(cells))
        self.parts = []
        self.names = [f"log sigma[{parameter},{environment}]" for parameter, environment in cells]
        self.priors_in_force: dict[str, float] = {}
        self._n = np.asarray(counts, dtype=float)
        self._nu = self._n - 1.0
        self._unit = 1.0 / np.sqrt(2.0 * self._nu)

    def identity(self) -> tuple[object, ...]:
        """Return cells and counts: the data are standardised."""
        return ("unpooled", self.cells, self._n)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, C), shape (W,)."""
        t = points * self._unit
        with np.errstate(over="ignore"):
            inverse_variance = np.exp(-2.0 * t)
            cost = self._nu * (t + 0.5 * inverse_variance)
        return -cost.sum(axis=1)

    def law(self, points: Array) -> Law:
        """Law of standardised cells, which are independent."""
        sigma = np.exp(points * self._unit)[:, None]
        sd = sigma / np.sqrt(self._n)
        return Law(
            mean=np.zeros_like(points),
            columns=lambda weights: weights * sd,
            user_columns=lambda weights: weights * sigma,
        )

    def scales(self, points: Array) -> Named:
        """Ratio of sigma to the sample SD per cell."""
        return {"sigma_ratio": (("cell",), np.exp(points * self._unit))}
