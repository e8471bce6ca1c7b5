"""The posterior of every linear design: cells, factors, groups and covariates, without locations.

`design` says which columns there are, `log_linear` maps coordinates to SDs of cells, and
`cell_information` integrates the locations out. This module names the coordinates and joins the
three.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, block
from percept.inference.hierarchy.cell_information import CellLaw, CellProblem
from percept.inference.hierarchy.covariates import Covariates
from percept.inference.hierarchy.density import ConditionalMoments, Model
from percept.inference.hierarchy.design import LEVEL, TREND, Design, Term
from percept.inference.hierarchy.log_linear import LogLinear
from percept.inference.hierarchy.one_pattern import CellScales, OnePattern
from percept.inference.hierarchy.priors import LIMIT, Named, Priors, correlation, half_normal
from percept.inference.hierarchy.spreads import (
    rough_between,
    rough_trial,
    tie_between,
    tie_trial,
)
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["LinearModel", "LinearScales"]

Array = NDArray[np.float64]

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclasses.dataclass(frozen=True, eq=False)
class LinearScales:
    """Scales and correlations at W sets of coordinates."""

    named: dict[str, Array]  # By name, draws last
    cells: CellScales  # As the locations need them
    log_prior: Array  # (W,) Prior density of the coordinates


@dataclasses.dataclass(frozen=True)
class _Level:
    """SDs between subjects or between trials."""

    suffix: str  # Of names: none between subjects, "_e" between trials
    terms: tuple[Term, ...]
    maps: tuple[LogLinear, ...]  # One for each quantity
    slope: Array  # (C, 1) Of the second quantity's rough log SDs on those of the first
    rough_mean: Array  # (C, 1) Of the first quantity
    weight: Array  # (P, C) Of the rough likelihoods

    @property
    def coefficients(self) -> list[str]:
        """Names of the coefficients of log sigma, one for each column."""
        names = {LEVEL: f"log_s{self.suffix}", TREND: f"kappa{self.suffix}"}
        found = []
        for term in self.terms:
            name = names.get(term.name, f"psi{self.suffix}:{term.name}")
            found += _numbered(name, len(term.columns))
        return found


def _numbered(name: str, count: int) -> list[str]:
    """Names of the columns of a term: numbered where there are several."""
    if count == 1:
        return [name]
    return [f"{name}:{k + 1}" for k in range(count)]


def _effect_name(greek: str, term: Term) -> str:
    """Name of a scale of a term, such as sigma_u, and sigma_v:hand."""
    if term.name == LEVEL:
        return {"sigma": "sigma_u", "rho": "rho_u", "tau": "tau"}[greek]
    return {"sigma": "sigma_v", "rho": "rho_v", "tau": "tau"}[greek] + f":{term.name}"


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
    """

    takes_options = False

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors | None = None,
        covariates: Covariates | None = None,
    ) -> None:
        self.statistics = statistics
        self.design = design
        self.priors = priors or Priors()
        self.covariates = covariates
        self.priors_in_force = dataclasses.asdict(self.priors)
        self.cells = tuple(itertools.product(statistics.parameters, design.cells.names))
        self._levels = [self._level("", design.between)]
        if statistics.repeats:
            self._levels.append(self._level("_e", design.trial))
        self.names: list[str] = []
        self._slots: dict[str, slice] = {}
        self._name_coordinates()
        self._problem = CellProblem(statistics, design, self.priors.covariate_sd, covariates)
        self._one_pattern: OnePattern | None = None
        if covariates is None and len(statistics.patterns) == 1:
            self._one_pattern = OnePattern(statistics, design)
        self._limits = self._coordinate_limits()
        effects = sum(len(term.columns) for term in design.subject) * design.parameters
        self._draws_per_pass = self._problem.draws_per_pass(effects)
        trials = 0.0
        for pattern in statistics.patterns:
            trials += pattern.subjects * pattern.trials.sum()
        self._constant = statistics.constant - 0.5 * _LOG_2PI * trials * design.parameters

    def identity(self) -> tuple[object, ...]:
        """Return what decides density and locations."""
        covariates = None if self.covariates is None else dataclasses.astuple(self.covariates)
        return (
            "linear",
            dataclasses.astuple(self.statistics),
            dataclasses.astuple(self.design),
            dataclasses.astuple(self.priors),
            covariates,
        )

    def _level(self, suffix: str, terms: tuple[Term, ...]) -> _Level:
        """Shape the coordinates of one level's SDs by what the data roughly say of them."""
        statistics = self.statistics
        centre = getattr(self.priors, f"log_s{suffix}_mean")
        columns = np.concatenate([term.columns for term in terms])
        if suffix:
            mean, weight = rough_trial(statistics)
            tie = tie_trial(statistics)
        else:
            loadings = np.moveaxis(columns, 1, 0)
            log_s_sd = self.priors.log_s_sd
            mean, weight = rough_between(
                statistics, loadings, centre, log_s_sd, subject_effect=True
            )
            tie = tie_between(statistics, subject_effect=True)
        # What the first quantity says of the second: near a correlation of one their ratio is
        # known far better than either.
        known = (weight > 0).all(axis=0)
        ratio = weight[0] / np.where(known, weight[-1], 1.0)
        slope = np.where(known, tie * np.sqrt(ratio), 0.0)
        weight = weight.copy()
        weight[1:] /= np.where(known, 1.0 - tie * tie, 1.0)
        maps = tuple(
            LogLinear(centre, columns[:, p], mean[p], weight[p]) for p in range(len(weight))
        )
        return _Level(suffix, terms, maps, slope[:, None], mean[0][:, None], weight)

    def _name_coordinates(self) -> None:
        """Give every coordinate its name, and every scale its coordinates."""
        design = self.design
        parameters = self.statistics.parameters
        pair = len(parameters) == 2
        for level in self._levels:
            self._name(f"sigma{level.suffix}", parameters, design.cells.names)
            self._name(f"coefficients{level.suffix}", parameters, level.coefficients)
            self._name(f"omega{level.suffix}", parameters)
            if pair:
                self._name(f"rho{level.suffix or '_w'}")
        for term in design.subject:
            self._name(_effect_name("sigma", term), parameters)
            if pair:
                self._name(_effect_name("rho", term))
        for term in design.own:
            self._name(_effect_name("tau", term), parameters)
        for term in design.stretch:
            self._name(f"eta:{term.name}", parameters, _numbered("column", len(term.columns)))

    def _name(self, scale: str, *axes: Sequence[str]) -> None:
        """Append the coordinates of a scale, one for each combination of labels."""
        labels = [",".join(label) for label in itertools.product(*axes)]
        first = len(self.names)
        self._slots[scale] = slice(first, first + len(labels))
        self.names += [f"{scale}[{label}]" if label else scale for label in labels]

    def _coordinate_limits(self) -> Array:
        """Distance from zero beyond which a coordinate has no mass, (d,)."""
        limits = np.full(len(self.names), LIMIT)
        for level in self._levels:
            # A unit of these is as short as the rough likelihood is narrow.
            stretch = np.sqrt(1.0 + level.weight.sum(axis=1).max())
            limits[self._slots[f"sigma{level.suffix}"]] *= stretch
            limits[self._slots[f"coefficients{level.suffix}"]] *= stretch
        return limits

    def linear_scales(self, points: Array) -> LinearScales:
        """Map coordinates (W, d) to scales."""
        coords = np.ascontiguousarray(points.T)
        named: dict[str, Array] = {}
        log_prior = np.zeros(len(points))
        blocks: dict[str, Block] = {}
        for level in self._levels:
            sigma, log_density = self._sigma(level, coords, named)
            log_prior = log_prior + log_density
            blocks[level.suffix] = self._block(sigma, f"rho{level.suffix or '_w'}", coords, named)
        taus = []
        for term in self.design.own:
            name = _effect_name("tau", term)
            tau = self._half_normal(name, self.priors.tau_scale, coords, named)
            taus.append(np.repeat(tau[None], len(term.columns), axis=0))
        # Own scales in log_prior: all but those of the levels' SDs are standard normal.
        standard = np.concatenate([coords[part] for part in self._standard_slots()])
        log_prior -= 0.5 * (np.einsum("dw,dw->w", standard, standard) + _LOG_2PI * len(standard))
        cells = CellScales(
            between=blocks[""],
            trial=blocks.get("_e"),
            effects=self._effects(coords, named),
            tau=np.concatenate(taus) if taus else np.zeros((0, 1, len(log_prior))),
        )
        return LinearScales(named, cells, log_prior)

    def _standard_slots(self) -> Iterator[slice]:
        """Coordinates that are standard normal under the prior, whatever the rest."""
        for name, part in self._slots.items():
            if not name.startswith("coefficients") and name not in ("sigma", "sigma_e"):
                yield part

    def _sigma(self, level: _Level, coords: Array, named: dict[str, Array]) -> tuple[Array, Array]:
        """SDs of one level, (P, C, W), and the log density of their coordinates."""
        suffix = level.suffix
        size = self.design.parameters
        width = coords.shape[1]
        scale = getattr(self.priors, f"omega{suffix}_scale")
        omega = self._half_normal(f"omega{suffix}", scale, coords, named)
        own = coords[self._slots[f"sigma{suffix}"]].reshape(size, -1, width)
        joint = coords[self._slots[f"coefficients{suffix}"]].reshape(size, -1, width)
        first = level.maps[0](joint[0], own[0], omega[0])
        spreads = [first]
        if size == 2:
            shift = level.slope * (first.log_sigma - level.rough_mean)
            spreads.append(level.maps[1](joint[1], own[1], omega[1], shift))
        multiples = np.stack([spread.multiples for spread in spreads])  # (P, K, W)
        for k, name in enumerate(level.coefficients):
            named[name] = multiples[:, k] * self._prior_sd(name)
        sigma = np.exp(np.stack([spread.log_sigma for spread in spreads]))
        named[f"sigma{suffix}"] = sigma
        log_density = np.sum([spread.log_density for spread in spreads], axis=0)
        return sigma, log_density

    def _prior_sd(self, name: str) -> float:
        """Prior SD of a coefficient of log sigma."""
        if name.startswith("psi"):
            return self.priors.psi_sd
        return float(getattr(self.priors, f"{name}_sd"))

    def _half_normal(
        self, name: str, scale: float, coords: Array, named: dict[str, Array]
    ) -> Array:
        named[name] = half_normal(coords[self._slots[name]], scale)
        return named[name]

    def _block(self, sd: Array, rho: str, coords: Array, named: dict[str, Array]) -> Block:
        """Covariance over the quantities of SDs (P, ..., W)."""
        if len(sd) == 1:
            return block(tuple(sd))
        named[rho], rest = correlation(coords[self._slots[rho].start], self.priors.rho_shape)
        return block(tuple(sd), named[rho], rest)

    def _effects(self, coords: Array, named: dict[str, Array]) -> Array:
        """Columns of the subjects' effects on their settings, (q, P, C, W)."""
        design = self.design
        stretch = np.zeros((*design.cells.x.shape, coords.shape[1]))
        for term in design.stretch:
            name = f"eta:{term.name}"
            flat = coords[self._slots[name]]
            eta = flat.reshape(design.parameters, len(term.columns), -1)
            named[name] = self.priors.psi_sd * eta
            stretch += np.einsum("kpc,pkw->pcw", term.columns, eta)
        stretch = np.exp(stretch)
        effects = []
        for term in design.subject:
            scale = self.priors.sigma_u_scale
            sd = self._half_normal(_effect_name("sigma", term), scale, coords, named)
            covariance = self._block(sd, _effect_name("rho", term), coords, named)
            for column in term.columns:
                for root in covariance.factor_columns():
                    effects.append(column[..., None] * np.stack(root)[:, None] * stretch)
        return np.stack(effects)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        inside = np.all(np.abs(points) <= self._limits, axis=1)
        coords = np.where(inside[:, None], points, 0.0)
        values = []
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            for part in self._passes(coords):
                scales = self.linear_scales(part)
                values.append(scales.log_prior + self.log_likelihood(scales.cells))
        value = np.concatenate(values)
        return np.where(inside & ~np.isnan(value), value, -np.inf)

    def _passes(self, points: Array) -> list[Array]:
        """Points in parts that the processor's cache holds."""
        count = self._draws_per_pass
        return [points[start : start + count] for start in range(0, len(points), count)]

    def log_likelihood(self, scales: CellScales) -> Array:
        """Log density of the data given scales, locations and subject effects integrated out."""
        if self._one_pattern is not None:
            value = self._constant + self._one_pattern.log_density(scales)
        else:
            value = self._constant + CellLaw(self._problem, scales).log_density
        if scales.trial is None:
            return value
        statistics = self.statistics
        rows = tuple(statistics.trial_rows[..., None])
        squares = scales.trial.distance(rows).sum(axis=0)
        determinants = statistics.trial_df @ scales.trial.log_determinant()
        return np.asarray(value - 0.5 * (squares + determinants))

    def locations(self, scales: CellScales) -> CellLaw:
        """Law of the locations given scales."""
        return CellLaw(self._problem, scales)

    def laws(self, points: Array) -> ConditionalMoments:
        """Law of every cell's location and of its users at coordinates (W, d)."""
        rows = np.eye(len(self.cells), self._problem.basis.shape[0])
        return self.laws_of(rows, points)

    def laws_of(self, rows: Array, points: Array) -> ConditionalMoments:
        """Law of linear combinations of the locations, and of one user's own combinations.

        Parameters
        ----------
        rows : ndarray
            Weights of cells, quantity by quantity, and then of slopes of covariates, (L, R).
        points : ndarray
            Coordinates (W, d).
        """
        parts = [self._laws_of(rows, part).pack() for part in self._passes(points)]
        return ConditionalMoments.unpack(np.concatenate(parts))

    def _laws_of(self, rows: Array, points: Array) -> ConditionalMoments:
        scales = self.linear_scales(points).cells
        law = CellLaw(self._problem, scales)
        spread = rows @ law.columns
        users = self._user_variance(rows, scales)
        return ConditionalMoments(
            mean=law.mean @ rows.T,
            sd=np.sqrt(np.einsum("wlq,wlq->wl", spread, spread)),
            population_sd=np.sqrt(users),
        )

    def log_user_sds(self, rows: Array, points: Array) -> Array:
        """Log SDs of one user's own combinations at coordinates (W, d), shape (W, L)."""
        parts = []
        for part in self._passes(points):
            scales = self.linear_scales(part).cells
            parts.append(0.5 * np.log(self._user_variance(rows, scales)))
        return np.concatenate(parts)

    def _user_variance(self, rows: Array, scales: CellScales) -> Array:
        """Variance of one user's own combinations about those of the locations, (W, L)."""
        size, cells = self.design.cells.x.shape
        weights = rows[:, : size * cells].reshape(-1, size, cells)
        shared = np.einsum("lpc,qpcw->qlw", weights, scales.effects)
        variance = np.einsum("qlw,qlw->lw", shared, shared)
        for column in scales.between.factor_columns():
            own = np.einsum("lpc,pcw->lcw", weights, np.stack(column))
            variance += np.einsum("lcw,lcw->lw", own, own)
        return variance.T

    def scales(self, points: Array) -> Named:
        """Scales and correlations by name at coordinates: dimensions and values, draws first."""
        parts = [self.linear_scales(part).named for part in self._passes(points)]
        dimensions = {1: (), 2: ("parameter",), 3: ("parameter", "cell")}
        named: Named = {}
        for name in parts[0]:
            value = np.concatenate([np.moveaxis(part[name], -1, 0) for part in parts])
            named[name] = (dimensions[value.ndim], value)
        return named
