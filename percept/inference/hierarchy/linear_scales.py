"""The coordinates of a linear design, and the scales that they stand for.

The sampler moves in d coordinates, all near standard normal. `LinearCoordinates` names them and
maps W sets of them to SDs and correlations. In this order there are, with P quantities p, C cells
c, N subjects i and J environments:

    sigma[p,c], coefficients[p,·], omega[p], rho_w      SDs between subjects in each cell
    sigma_e[p,c], coefficients_e[p,·], omega_e[p], rho_e      SDs between trials, with repeats only
    phi[p,i], omega_s[p]        log ratios of subjects' trial SDs, if they have their own
    sigma_u[p], rho_u           covariance of the subjects' effects on all cells
    sigma_v:hand[p], rho_v:hand the same of their effects under the factor `hand`
    tau[p], tau:hand[p]         SDs of the environments' deviations
    eta:hand[p,·]               how the size of the subjects' effects differs between levels

Correlations exist with two quantities only. Under the prior every coordinate is standard normal and
independent, but for sigma, coefficients and phi: `CellSpreads` and `SubjectSpreads` shape these by
the data, and give their density.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, block
from percept.inference.hierarchy.cell_scales import CellScales
from percept.inference.hierarchy.cell_spreads import CellSpreads, numbered
from percept.inference.hierarchy.design import LEVEL, Design, Term
from percept.inference.hierarchy.priors import LIMIT, Priors, correlation, half_normal
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_spreads import SubjectSpreads
from percept.inference.hierarchy.ties import tie_trial
from percept.inference.hierarchy.trial_scatter import TrialScatter

__all__ = ["EffectScales", "LinearCoordinates", "LinearScales", "effect_columns"]

Array = NDArray[np.float64]

_LOG_2PI = float(np.log(2.0 * np.pi))

#: Names of the scales of a term that enters all cells; a factor adds its own name.
_OF_LEVEL = {"sigma": "sigma_u", "rho": "rho_u", "tau": "tau"}
_OF_FACTOR = {"sigma": "sigma_v", "rho": "rho_v", "tau": "tau"}


@dataclasses.dataclass(frozen=True, eq=False)
class EffectScales:
    """Scales of the subjects' effects at W sets of coordinates."""

    covariances: list[Block]  # (W,) Over the quantities, for each subject term of the design
    size_coefficients: list[
        Array
    ]  # (P, K, W) Coefficients of each effect size term, over their prior SD


@dataclasses.dataclass(frozen=True, eq=False)
class LinearScales:
    """Scales and correlations at W sets of coordinates."""

    named: dict[str, Array]  # By name: (W,), (P, W), (P, C, W), or (P, N, W) for phi
    cells: CellScales  # As the locations need them
    effects: EffectScales  # As the columns of an untested environment need them
    log_prior: Array  # (W,) Prior density of the coordinates


@dataclasses.dataclass(frozen=True, eq=False)
class _Correlation:
    """Correlation of two quantities."""

    rho: Array  # (W,)
    one_minus_size: Array  # (W,) 1 - abs(rho), with the digits that a rho near one loses


@dataclasses.dataclass(frozen=True, eq=False)
class _LevelSds:
    """SDs of cells at one level, between subjects or between trials."""

    log_sigma: Array  # (P, C, W)
    correlation: _Correlation | None  # None with one quantity
    named: dict[str, Array]
    log_density: Array  # (W,) Of the level's coordinates that are not standard normal


@dataclasses.dataclass(frozen=True, eq=False)
class _SubjectRatios:
    """Log ratios of subjects' trial SDs."""

    phi: Array  # (P, N, W)
    omega: Array  # (P, W) Their SD
    log_density: Array  # (W,) Of the coordinates of phi


def effect_columns(scales: EffectScales, design: Design) -> Array:
    """Columns Z (q, P, C, W) of the subjects' effects in a design's cells.

    An effect of a term adds its column, times a column of the root of its covariance over the
    quantities, times the size of effects in the cell.
    """
    width = scales.covariances[0].leading.shape[-1]
    log_size = np.zeros((*design.cells.x.shape, width))
    for term, coefficients in zip(design.effect_size, scales.size_coefficients, strict=True):
        log_size += np.einsum("kpc,pkw->pcw", term.columns, coefficients)
    size = np.exp(log_size)
    columns = []
    for term, covariance in zip(design.subject, scales.covariances, strict=True):
        for column in term.columns:
            for root in covariance.factor_columns():
                of_quantity = np.stack(root)[:, None]
                columns.append(column[..., None] * of_quantity * size)
    return np.stack(columns)


class LinearCoordinates:
    """Names of the coordinates of a linear design, and their map to scales.

    Parameters
    ----------
    statistics : Statistics
        Of the responses; its environments are the design's cells.
    design : Design
        The columns.
    priors : Priors
        Prior scales.
    scatter : TrialScatter
        Scatter between trials, in T groups.

    Attributes
    ----------
    names : list of str
        Of the d coordinates.
    slots : dict
        Coordinates of each scale.
    limits : ndarray
        Distance from zero beyond which a coordinate has no mass, (d,).
    between, trial : CellSpreads
        Map of the SDs between subjects; of those between trials, None without repeats.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors,
        scatter: TrialScatter,
    ) -> None:
        self._statistics = statistics
        self._design = design
        self._priors = priors
        self._scatter = scatter
        self.between = CellSpreads(statistics, design.sd_between, priors, "")
        self.trial: CellSpreads | None = None
        self._subject_spreads: SubjectSpreads | None = None
        if statistics.repeats:
            self.trial = CellSpreads(statistics, design.sd_trial, priors, "_e")
            if scatter.subject is not None:
                self._subject_spreads = SubjectSpreads(
                    scatter,
                    len(statistics.subjects),
                    len(statistics.environments),
                    tie_trial(statistics),
                )
        self.names: list[str] = []
        self.slots: dict[str, slice] = {}
        #: Coordinates that are standard normal under the prior, whatever the rest.
        self._standard: list[int] = []
        self._name_coordinates()
        self.limits = self._limits()

    @property
    def levels(self) -> list[CellSpreads]:
        """Maps of the SDs of all levels."""
        if self.trial is None:
            return [self.between]
        return [self.between, self.trial]

    def _name_coordinates(self) -> None:
        """Give every coordinate its name, and every scale its coordinates."""
        design = self._design
        parameters = self._statistics.parameters
        pair = len(parameters) == 2
        for level in self.levels:
            self._name(f"sigma{level.suffix}", parameters, design.cells.names, standard=False)
            self._name(
                f"coefficients{level.suffix}", parameters, level.coefficients, standard=False
            )
            self._name(f"omega{level.suffix}", parameters)
            if pair:
                self._name(level.rho)
        if self._subject_spreads is not None:
            self._name("phi", parameters, self._statistics.subjects, standard=False)
            self._name("omega_s", parameters)
        for term in design.subject:
            self._name(_name_of("sigma", term), parameters)
            if pair:
                self._name(_name_of("rho", term))
        for term in design.deviation:
            self._name(_name_of("tau", term), parameters)
        for term in design.effect_size:
            self._name(f"eta:{term.name}", parameters, numbered("column", len(term.columns)))

    def _name(
        self,
        scale: str,
        *axes: Sequence[str],
        standard: bool = True,
    ) -> None:
        """Append the coordinates of a scale, one for each combination of labels."""
        first = len(self.names)
        for labels in itertools.product(*axes):
            joined = ",".join(labels)
            self.names.append(f"{scale}[{joined}]" if joined else scale)
        end = len(self.names)
        self.slots[scale] = slice(first, end)
        if standard:
            self._standard += range(first, end)

    def _limits(self) -> Array:
        limits = np.full(len(self.names), LIMIT)
        for level in self.levels:
            # A rough likelihood of weight w shortens the unit of a coordinate by √(1 + w). All
            # cells inform a coefficient: their weights add up.
            units = np.sqrt(1.0 + level.weight.sum(axis=1).max())
            limits[self.slots[f"sigma{level.suffix}"]] *= units
            limits[self.slots[f"coefficients{level.suffix}"]] *= units
        if self._subject_spreads is not None:
            units = np.sqrt(1.0 + self._subject_spreads.weight.max())
            limits[self.slots["phi"]] *= units
        return limits

    def __call__(self, points: Array) -> LinearScales:
        """Map coordinates (W, d) to scales."""
        coordinates = np.ascontiguousarray(points.T)
        named: dict[str, Array] = {}
        log_prior = np.zeros(len(points))
        ratios: _SubjectRatios | None = None
        if self._subject_spreads is not None:
            ratios = self._subject_ratios(self._subject_spreads, coordinates)
            named |= {"omega_s": ratios.omega, "phi": ratios.phi}
            log_prior = log_prior + ratios.log_density
        unmoved = np.zeros((self._design.parameters, 1, len(points)))
        between = self._level_sds(self.between, coordinates, unmoved)
        named |= between.named
        log_prior = log_prior + between.log_density
        trial_covariance: Block | None = None
        if self.trial is not None:
            shift = unmoved
            if self._subject_spreads is not None and ratios is not None:
                shift = self._subject_spreads.cells_given(ratios.phi)
            trial = self._level_sds(self.trial, coordinates, shift)
            named |= trial.named
            log_prior = log_prior + trial.log_density
            trial_covariance = self._trial_covariance(trial, ratios)
        taus = self._taus(coordinates)
        named |= taus
        effects = self._effects(coordinates, named)
        standard = coordinates[self._standard]
        squares = np.einsum("dw,dw->w", standard, standard)
        constant = _LOG_2PI * len(standard)
        log_prior = log_prior - 0.5 * (squares + constant)
        cells = CellScales(
            between=_covariance(np.exp(between.log_sigma), between.correlation),
            trial=trial_covariance,
            effects=effect_columns(effects, self._design),
            tau=self._tau_by_column(taus, len(points)),
        )
        return LinearScales(named, cells, effects, log_prior)

    def _half_normal(self, name: str, coordinates: Array, prior_scale: float) -> Array:
        """SDs (P, W) under a half-normal prior."""
        return half_normal(coordinates[self.slots[name]], prior_scale)

    def _correlation(self, name: str, coordinates: Array) -> _Correlation | None:
        """Correlation of the quantities, where there are two."""
        if name not in self.slots:
            return None
        (coordinate,) = coordinates[self.slots[name]]
        rho, one_minus_size = correlation(coordinate, self._priors.rho_shape)
        return _Correlation(rho, one_minus_size)

    def _by_quantity(self, name: str, coordinates: Array) -> Array:
        """Coordinates of a scale, (P, count, W)."""
        flat = coordinates[self.slots[name]]
        return flat.reshape(self._design.parameters, -1, flat.shape[-1])

    def _subject_ratios(self, spreads: SubjectSpreads, coordinates: Array) -> _SubjectRatios:
        omega = self._half_normal("omega_s", coordinates, self._priors.omega_s_scale)
        phi, log_density = spreads(self._by_quantity("phi", coordinates), omega)
        return _SubjectRatios(phi, omega, log_density)

    def _level_sds(self, level: CellSpreads, coordinates: Array, shift: Array) -> _LevelSds:
        """SDs of one level, whose rough likelihood is moved by a shift (P, C or 1, W)."""
        suffix = level.suffix
        prior_scale = getattr(self._priors, f"omega{suffix}_scale")
        omega = self._half_normal(f"omega{suffix}", coordinates, prior_scale)
        of_coefficients = self._by_quantity(f"coefficients{suffix}", coordinates)
        of_cells = self._by_quantity(f"sigma{suffix}", coordinates)
        spreads = level(of_coefficients, of_cells, omega, shift)
        named = {f"omega{suffix}": omega}
        for k, name in enumerate(level.coefficients):
            named[name] = spreads.multiples[:, k] * self.coefficient_sd(name)
        named[f"sigma{suffix}"] = np.exp(spreads.log_sigma)
        rho = self._correlation(level.rho, coordinates)
        if rho is not None:
            named[level.rho] = rho.rho
        return _LevelSds(spreads.log_sigma, rho, named, spreads.log_density)

    def coefficient_sd(self, name: str) -> float:
        """Prior SD of a coefficient of log sigma."""
        if name.startswith("psi"):
            return self._priors.psi_sd
        return float(getattr(self._priors, f"{name}_sd"))

    def _trial_covariance(self, trial: _LevelSds, ratios: _SubjectRatios | None) -> Block:
        """Covariance between trials of each group, entries (T, W)."""
        log_sigma = trial.log_sigma[:, self._scatter.cell]
        if ratios is not None:
            log_sigma = log_sigma + ratios.phi[:, self._scatter.subject]
        return _covariance(np.exp(log_sigma), trial.correlation)

    def _taus(self, coordinates: Array) -> dict[str, Array]:
        """SDs (P, W) of the environments' deviations, by name."""
        taus = {}
        for term in self._design.deviation:
            name = _name_of("tau", term)
            taus[name] = self._half_normal(name, coordinates, self._priors.tau_scale)
        return taus

    def _tau_by_column(self, taus: dict[str, Array], width: int) -> Array:
        """SDs (o, P, W) of the o columns of deviations, of which a term may have several."""
        by_column = np.zeros((0, self._design.parameters, width))
        for term, tau in zip(self._design.deviation, taus.values(), strict=True):
            of_term = np.repeat(tau[None], len(term.columns), axis=0)
            by_column = np.concatenate([by_column, of_term])
        return by_column

    def _effects(self, coordinates: Array, named: dict[str, Array]) -> EffectScales:
        """Scales of the subjects' effects; they join the named ones."""
        size_coefficients = []
        for term in self._design.effect_size:
            eta = self._by_quantity(f"eta:{term.name}", coordinates)
            named[f"eta:{term.name}"] = self._priors.psi_sd * eta
            size_coefficients.append(eta)
        covariances = []
        for term in self._design.subject:
            name = _name_of("sigma", term)
            sd = self._half_normal(name, coordinates, self._priors.sigma_u_scale)
            named[name] = sd
            rho_name = _name_of("rho", term)
            rho = self._correlation(rho_name, coordinates)
            if rho is not None:
                named[rho_name] = rho.rho
            covariances.append(_covariance(sd, rho))
        return EffectScales(covariances, size_coefficients)


def _name_of(symbol: str, term: Term) -> str:
    """Name of a scale of a term: sigma_u, and sigma_v:hand for the factor `hand`."""
    if term.name == LEVEL:
        return _OF_LEVEL[symbol]
    return f"{_OF_FACTOR[symbol]}:{term.name}"


def _covariance(sd: Array, rho: _Correlation | None) -> Block:
    """Covariance over the quantities of SDs (P, ..., W)."""
    if rho is None:
        return block(tuple(sd))
    return block(tuple(sd), rho.rho, rho.one_minus_size)
