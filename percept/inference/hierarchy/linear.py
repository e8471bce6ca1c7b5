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
from percept.inference.hierarchy.cell_information import CellLaw
from percept.inference.hierarchy.cell_problem import CellProblem
from percept.inference.hierarchy.cell_scales import CellScales
from percept.inference.hierarchy.cell_spreads import CellSpreads, numbered
from percept.inference.hierarchy.covariates import Covariates
from percept.inference.hierarchy.design import LEVEL, Design, Term
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.model import Model
from percept.inference.hierarchy.one_pattern import OnePattern
from percept.inference.hierarchy.priors import LIMIT, Named, Priors, correlation, half_normal
from percept.inference.hierarchy.rough_spreads import tie_trial
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_spreads import SubjectSpreads
from percept.inference.hierarchy.trial_scatter import TrialScatter

__all__ = ["LinearModel", "LinearScales"]

Array = NDArray[np.float64]

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclasses.dataclass(frozen=True, eq=False)
class LinearScales:
    """Scales and correlations at W sets of coordinates."""

    named: dict[str, Array]  # By name, draws last
    cells: CellScales  # As the locations need them
    log_prior: Array  # (W,) Prior density of the coordinates


@dataclasses.dataclass(frozen=True, eq=False)
class Reading:
    """Coordinates by scale, and the scales that are worked out from them as they are read."""

    coords: Array  # (d, W)
    slots: dict[str, slice]  # Coordinates of each scale
    named: dict[str, Array] = dataclasses.field(default_factory=dict)

    @property
    def width(self) -> int:
        """Number W of sets of coordinates."""
        return self.coords.shape[1]

    def by_quantity(self, scale: str, size: int) -> Array:
        """Coordinates of a scale, (P, count, W)."""
        flat = self.coords[self.slots[scale]]
        return flat.reshape(size, -1, self.width)

    def half_normal(self, name: str, prior_scale: float) -> Array:
        """Read SDs (P, W) under a half-normal prior."""
        coordinates = self.coords[self.slots[name]]
        sd = half_normal(coordinates, prior_scale)
        self.named[name] = sd
        return sd

    def block(self, sd: Array, rho: str, rho_shape: float) -> Block:
        """Read the covariance over the quantities of SDs (P, ..., W)."""
        variances = tuple(sd)
        if len(variances) == 1:
            return block(variances)
        (coordinate,) = self.coords[self.slots[rho]]
        rho_value, rest = correlation(coordinate, rho_shape)
        self.named[rho] = rho_value
        return block(variances, rho_value, rest)


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
    scatter : TrialScatter, optional
        Scatter between trials: of every subject for trial SDs of their own, pooled for covariates.
        Without covariates and trial SDs of subjects the statistics hold it.
    """

    takes_options = False

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors | None = None,
        covariates: Covariates | None = None,
        scatter: TrialScatter | None = None,
    ) -> None:
        self.statistics = statistics
        self.design = design
        self.priors = priors or Priors()
        self.covariates = covariates
        self.priors_in_force = dataclasses.asdict(self.priors)
        self.cells = tuple(itertools.product(statistics.parameters, design.cells.names))
        scatter = scatter or _pooled(statistics)
        self.scatter = scatter
        self._levels = [CellSpreads(statistics, design.between, self.priors, "")]
        self._subject_spreads: SubjectSpreads | None = None
        if statistics.repeats:
            self._levels.append(CellSpreads(statistics, design.trial, self.priors, "_e"))
            if scatter.subject is not None:
                self._subject_spreads = SubjectSpreads(
                    scatter,
                    len(statistics.subjects),
                    len(statistics.environments),
                    tie_trial(statistics),
                )
        self.names: list[str] = []
        self._slots: dict[str, slice] = {}
        self._name_coordinates()
        self._problem = CellProblem(
            statistics, design, scatter, self.priors.covariate_sd, covariates
        )
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
            self.design.identity(),
            dataclasses.astuple(self.priors),
            covariates,
            dataclasses.astuple(self.scatter),
        )

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
                self._name(level.rho)
        if self._subject_spreads is not None:
            self._name("phi", parameters, self.statistics.subjects)
            self._name("omega_s", parameters)
        for term in design.subject:
            self._name(_effect_name("sigma", term), parameters)
            if pair:
                self._name(_effect_name("rho", term))
        for term in design.own:
            self._name(_effect_name("tau", term), parameters)
        for term in design.stretch:
            self._name(f"eta:{term.name}", parameters, numbered("column", len(term.columns)))

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
        if self._subject_spreads is not None:
            limits[self._slots["phi"]] *= np.sqrt(1.0 + self._subject_spreads.weight.max())
        return limits

    def linear_scales(self, points: Array) -> LinearScales:
        """Map coordinates (W, d) to scales."""
        reading = self.reading(points)
        ratios, log_prior = self._subject_ratios(reading)
        blocks: dict[str, Block] = {}
        for level in self._levels:
            shift = np.zeros((self.design.parameters, 1, reading.width))
            if level.suffix and self._subject_spreads is not None:
                shift = self._subject_spreads.cells_given(ratios)
            log_sigma, log_density = self._log_sigma(level, reading, shift)
            log_prior = log_prior + log_density
            if level.suffix:
                log_sigma = log_sigma[:, self.scatter.cell]
                if self.scatter.subject is not None:
                    log_sigma = log_sigma + ratios[:, self.scatter.subject]
            sd = np.exp(log_sigma)
            blocks[level.suffix] = reading.block(sd, level.rho, self.priors.rho_shape)
        taus = [np.zeros((0, self.design.parameters, reading.width))]
        for term in self.design.own:
            name = _effect_name("tau", term)
            tau = reading.half_normal(name, self.priors.tau_scale)
            of_columns = np.repeat(tau[None], len(term.columns), axis=0)
            taus.append(of_columns)
        # All coordinates but those of the levels' SDs and of phi are standard normal.
        standard = np.concatenate([reading.coords[part] for part in self._standard_slots()])
        squares = np.einsum("dw,dw->w", standard, standard)
        constant = _LOG_2PI * len(standard)
        log_prior = log_prior - 0.5 * (squares + constant)
        cells = CellScales(
            between=blocks[""],
            trial=blocks.get("_e"),
            effects=self.effects(reading, self.design),
            tau=np.concatenate(taus),
        )
        return LinearScales(reading.named, cells, log_prior)

    def _standard_slots(self) -> Iterator[slice]:
        """Coordinates that are standard normal under the prior, whatever the rest."""
        for name, part in self._slots.items():
            if not name.startswith("coefficients") and name not in ("sigma", "sigma_e", "phi"):
                yield part

    def _subject_ratios(self, reading: Reading) -> tuple[Array, Array]:
        """Log ratios of subjects' trial SDs, (P, N, W), and log density of their coordinates."""
        size = self.design.parameters
        if self._subject_spreads is None:
            nobody = np.zeros((size, 0, reading.width))
            return nobody, np.zeros(reading.width)
        omega = reading.half_normal("omega_s", self.priors.omega_s_scale)
        coordinates = reading.by_quantity("phi", size)
        phi, log_density = self._subject_spreads(coordinates, omega)
        reading.named["phi"] = phi
        return phi, log_density

    def _log_sigma(
        self,
        level: CellSpreads,
        reading: Reading,
        shift: Array,
    ) -> tuple[Array, Array]:
        """Log SDs of one level, (P, C, W), and the log density of their coordinates."""
        suffix = level.suffix
        size = self.design.parameters
        scale = getattr(self.priors, f"omega{suffix}_scale")
        omega = reading.half_normal(f"omega{suffix}", scale)
        own = reading.by_quantity(f"sigma{suffix}", size)
        joint = reading.by_quantity(f"coefficients{suffix}", size)
        spreads = level(joint, own, omega, shift)
        for k, name in enumerate(level.coefficients):
            multiple = spreads.multiples[:, k]
            reading.named[name] = multiple * self._prior_sd(name)
        reading.named[f"sigma{suffix}"] = np.exp(spreads.log_sigma)
        return spreads.log_sigma, spreads.log_density

    def _prior_sd(self, name: str) -> float:
        """Prior SD of a coefficient of log sigma."""
        if name.startswith("psi"):
            return self.priors.psi_sd
        return float(getattr(self.priors, f"{name}_sd"))

    def reading(self, points: Array) -> Reading:
        """Coordinates (W, d) by scale."""
        return Reading(np.ascontiguousarray(points.T), self._slots)

    def effects(self, reading: Reading, design: Design) -> Array:
        """Columns of the subjects' effects on their settings in a design's cells, (q, P, C, W)."""
        stretch = np.zeros((*design.cells.x.shape, reading.width))
        for term in design.stretch:
            name = f"eta:{term.name}"
            eta = reading.by_quantity(name, design.parameters)
            reading.named[name] = self.priors.psi_sd * eta
            stretch += np.einsum("kpc,pkw->pcw", term.columns, eta)
        stretch = np.exp(stretch)
        effects = []
        for term in design.subject:
            name = _effect_name("sigma", term)
            rho = _effect_name("rho", term)
            sd = reading.half_normal(name, self.priors.sigma_u_scale)
            covariance = reading.block(sd, rho, self.priors.rho_shape)
            for column in term.columns:
                for root in covariance.factor_columns():
                    of_quantity = np.stack(root)[:, None]
                    effects.append(column[..., None] * of_quantity * stretch)
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
        law = CellLaw(self._problem, scales)
        # Unequal cells have no orthogonal fallback. Draws whose digits are lost are refused: their
        # scales lie far from any that data allow. One pattern has a fallback for the density and
        # none for the locations, so draws whose locations are lost are refused there too.
        value = np.where(law.sound, self._constant + law.log_density, -np.inf)
        lost = np.flatnonzero(law.laws_sound & ~law.sound)
        if self._one_pattern is not None and lost.size:
            value[lost] = self._constant + self._one_pattern.log_density(scales.at(lost))
        if scales.trial is None:
            return value
        rows = tuple(self.scatter.rows[..., None])
        squares = scales.trial.distance(rows).sum(axis=0)
        determinants = self.scatter.df @ scales.trial.log_determinant()
        return np.asarray(value - 0.5 * (squares + determinants))

    def locations(self, scales: CellScales) -> CellLaw:
        """Law of the locations given scales."""
        return CellLaw(self._problem, scales)

    def laws(self, points: Array) -> ConditionalMoments:
        """Law of every cell's location and of its users at coordinates (W, d)."""
        rows = np.eye(len(self.cells), self._problem.locations)
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
        law = self.locations(scales)
        users = self._user_variance(rows, scales)
        return ConditionalMoments(
            mean=law.mean @ rows.T,
            sd=np.sqrt(law.variances_of(rows)),
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
        """Variance of one user's own combinations about the locations', (W, L)."""
        size, cells = self.design.cells.x.shape
        weights = rows[:, : size * cells].reshape(-1, size, cells)
        shared = np.einsum("lpc,qpcw->qlw", weights, scales.effects)
        variance = np.einsum("qlw,qlw->lw", shared, shared)
        for parts in scales.between.factor_columns():
            factor_column = np.einsum("lpc,pcw->lcw", weights, np.stack(parts))
            variance += np.einsum("lcw,lcw->lw", factor_column, factor_column)
        return variance.T

    def scales(self, points: Array) -> Named:
        """Scales and correlations by name at coordinates: dimensions and values, draws first."""
        parts = [self.linear_scales(part).named for part in self._passes(points)]
        dimensions = {1: (), 2: ("parameter",), 3: ("parameter", "environment")}
        named: Named = {}
        for name in parts[0]:
            value = np.concatenate([np.moveaxis(part[name], -1, 0) for part in parts])
            named[name] = (dimensions[value.ndim], value)
        if "phi" in named:
            named["phi"] = (("parameter", "subject"), named["phi"][1])
        for term in self.design.stretch:
            name = f"eta:{term.name}"
            # A coefficient per column of the term, not per environment.
            named[name] = (("parameter", f"{term.name} column"), named[name][1])
        return named


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
