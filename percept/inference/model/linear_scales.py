"""The coordinates of a linear design, and the scales that they stand for.

The sampler moves in d coordinates, all near standard normal. `LinearCoordinates` names them and
maps W sets of them to SDs and correlations. In this order there are, with P quantities p, C cells
c, N subjects i and J environments:

    sigma[p,c], log_s[p], kappa[p], omega[p], rho_w     SDs between subjects in each cell
    sigma_e[p,c], log_s_e[p], …, omega_e[p], rho_e      SDs between trials, with repeats only
    phi[p,i], omega_s[p]        log ratios of subjects' trial SDs, if they have their own
    sigma_u[p], rho_u           covariance of the subjects' effects on all cells
    sigma_v:hand[p], rho_v:hand the same of their effects under the factor `hand`
    tau[p], tau:hand[p]         SDs of the environments' deviations
    eta:hand[p,·]               how the size of the subjects' effects differs between levels

Correlations exist with two quantities only. With more than two columns of log SDs their
coefficients are `coefficients[p,·]`, quantity by quantity. Under the prior every coordinate is
standard normal and independent, but for sigma, these coefficients and phi: `CellSpreads` and
`SubjectSpreads` shape them by the data, and give their density.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block, block
from percept.inference.model.cell_scales import CellScales
from percept.inference.model.cell_spreads import CellSpreads, numbered
from percept.inference.model.design import LEVEL, Design, Term
from percept.inference.model.priors import LIMIT, Priors, correlation, half_normal
from percept.inference.model.statistics import Statistics
from percept.inference.model.subject_spreads import SubjectSpreads
from percept.inference.model.ties import tie_trial
from percept.inference.model.trial_scatter import TrialScatter

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


def effect_columns(scales: EffectScales, design: Design, width: int) -> Array:
    """Columns Z (q, P, C, W) of the subjects' effects in a design's cells.

    An effect of a term adds its column, times a column of the root of its covariance over the
    quantities, times the size of effects in the cell.
    """
    count = design.parameters * sum(len(term.columns) for term in design.subject)
    columns = np.empty((count, *design.cells.x.shape, width))
    number = 0
    for term, covariance in zip(design.subject, scales.covariances, strict=True):
        for column in term.columns:
            for root in covariance.factor_columns():
                of_quantity = np.stack(root)[:, None]
                np.multiply(column[..., None], of_quantity, out=columns[number])
                number += 1
    if design.effect_size:
        log_size = np.zeros((*design.cells.x.shape, width))
        for term, coefficients in zip(design.effect_size, scales.size_coefficients, strict=True):
            log_size += np.einsum("kpc,pkw->pcw", term.columns, coefficients)
        columns *= np.exp(log_size)
    return columns


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
        self.between = CellSpreads(statistics, design, priors, "")
        self.trial: CellSpreads | None = None
        self._subject_spreads: SubjectSpreads | None = None
        if statistics.repeats:
            self.trial = CellSpreads(statistics, design, priors, "_e")
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
        #: SDs under half-normal priors, and correlations: each kind is mapped at once.
        self._half_normals = self._half_normal_scales()
        scales = [np.full(self._count(name), scale) for name, scale in self._half_normals.items()]
        self._half_normal_scale = np.concatenate(scales)[:, None] if scales else np.zeros((0, 1))
        self._correlations = [name for name in self.slots if name.startswith("rho")]

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
            self._name_level(level)
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

    def _name_level(self, level: CellSpreads) -> None:
        """Name the coordinates of log SDs, but for their correlation."""
        parameters = self._statistics.parameters
        if level.departures:
            cells = self._design.cells.names
            self._name(f"sigma{level.suffix}", parameters, cells, standard=False)
        if level.follows_trend:
            for coefficient in level.coefficients:
                self._name(coefficient, parameters)
        else:
            coefficients = f"coefficients{level.suffix}"
            self._name(coefficients, parameters, level.coefficients, standard=False)
        if level.departures and level.single_sd is None:
            self._name(f"omega{level.suffix}", parameters)

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
            # A rough likelihood of weight w shortens the unit of a coordinate by √(1 + w).
            if level.departures:
                units = np.sqrt(1.0 + level.weight.ravel())
                limits[self.slots[f"sigma{level.suffix}"]] *= units
            if not level.follows_trend:
                # All cells inform a coefficient: their weights add up.
                unit = np.sqrt(1.0 + level.weight.sum(axis=1).max())
                limits[self.slots[f"coefficients{level.suffix}"]] *= unit
        if self._subject_spreads is not None:
            units = np.sqrt(1.0 + self._subject_spreads.weight.max())
            limits[self.slots["phi"]] *= units
        return limits

    def __call__(self, points: Array) -> LinearScales:
        """Map coordinates (W, d) to scales."""
        coordinates = np.ascontiguousarray(points.T)
        standard = coordinates[self._standard]
        squares = np.einsum("dw,dw->w", standard, standard)
        constant = _LOG_2PI * len(standard)
        log_prior = -0.5 * (squares + constant)
        named: dict[str, Array] = {}
        sds = half_normal(self._rows(self._half_normals, coordinates), self._half_normal_scale)
        first = 0
        for name in self._half_normals:
            last = first + self._count(name)
            named[name] = sds[first:last]
            first = last
        rests: dict[str, Array] = {}
        rows = self._rows(self._correlations, coordinates)
        values, left = correlation(rows, self._priors.rho_shape)
        for number, name in enumerate(self._correlations):
            named[name] = values[number]
            rests[name] = left[number]
        for term in self._design.effect_size:
            eta = self._by_quantity(f"eta:{term.name}", coordinates)
            named[f"eta:{term.name}"] = self._priors.psi_sd * eta
        unmoved = np.zeros((self._design.parameters, 1, len(points)))
        log_prior += self._level_sds(self.between, coordinates, unmoved, named)
        if self.trial is not None:
            shift = unmoved
            if self._subject_spreads is not None:
                of_subjects = self._by_quantity("phi", coordinates)
                named["phi"], log_density = self._subject_spreads(of_subjects, named["omega_s"])
                log_prior += log_density
                shift = self._subject_spreads.cells_given(named["phi"])
            log_prior += self._level_sds(self.trial, coordinates, shift, named)
        effects = self._effects(named, rests)
        return LinearScales(named, self.cell_scales(named, rests), effects, log_prior)

    def cell_scales(self, named: Mapping[str, Array], rests: Mapping[str, Array]) -> CellScales:
        """Scales of the cells from scales and correlations by name.

        Parameters
        ----------
        named : mapping
            Values as `LinearScales.named` has them. Of log SDs it needs the SDs alone.
        rests : mapping
            1 - abs(rho) of every correlation, with the digits that one near one loses.
        """
        sigma = named["sigma"]
        width = sigma.shape[-1]
        trial: Block | None = None
        if self.trial is not None:
            # Of each group of trials, entries (T, W).
            of_groups = named["sigma_e"][:, self._scatter.cell]
            if self._scatter.subject is not None:
                of_groups = of_groups * np.exp(named["phi"][:, self._scatter.subject])
            trial = _covariance(of_groups, "rho_e", named, rests)
        taus = []
        for term in self._design.deviation:
            # A term may have several columns.
            taus += [named[_name_of("tau", term)]] * len(term.columns)
        effects = self._effects(named, rests)
        return CellScales(
            between=_covariance(sigma, "rho_w", named, rests),
            trial=trial,
            covariances=effects.covariances,
            effects=effect_columns(effects, self._design, width),
            tau=np.reshape(taus, (len(taus), self._design.parameters, width)),
        )

    def _count(self, name: str) -> int:
        """Count the coordinates of a scale."""
        slot = self.slots[name]
        return slot.stop - slot.start

    def _rows(self, names: Iterable[str], coordinates: Array) -> Array:
        """Coordinates of several scales below one another."""
        rows = [coordinates[self.slots[name]] for name in names]
        return np.concatenate([coordinates[:0], *rows])

    def _half_normal_scales(self) -> dict[str, float]:
        """Scales of half-normal priors, by the names of the SDs."""
        priors = self._priors
        scales = {"omega": priors.omega_scale, "omega_e": priors.omega_e_scale}
        scales["omega_s"] = priors.omega_s_scale
        for term in self._design.subject:
            scales[_name_of("sigma", term)] = priors.sigma_u_scale
        for term in self._design.deviation:
            scales[_name_of("tau", term)] = priors.tau_scale
        return {name: scale for name, scale in scales.items() if name in self.slots}

    def _by_quantity(self, name: str, coordinates: Array) -> Array:
        """Coordinates of a scale, (P, count, W)."""
        flat = coordinates[self.slots[name]]
        return flat.reshape(self._design.parameters, -1, flat.shape[-1])

    def _level_sds(
        self, level: CellSpreads, coordinates: Array, shift: Array, named: dict[str, Array]
    ) -> Array:
        """Name the SDs of one level, and return the log density of their coordinates, (W,).

        The rough likelihood is moved by a shift (P, C or 1, W).
        """
        suffix = level.suffix
        columns = self._coefficient_coordinates(level, coordinates)
        if level.departures:
            of_cells = self._by_quantity(f"sigma{suffix}", coordinates)
            alone = np.full((len(of_cells), coordinates.shape[1]), level.single_sd or 0.0)
            omega = named.get(f"omega{suffix}", alone)
            spreads = level(columns, of_cells, omega, shift)
        else:
            spreads = level.without_departures(columns)
        for k, name in enumerate(level.coefficients):
            named[name] = spreads.multiples[:, k] * self.coefficient_sd(name)
        named[f"sigma{suffix}"] = np.exp(spreads.log_sigma)
        return spreads.log_density

    def _coefficient_coordinates(self, level: CellSpreads, coordinates: Array) -> Array:
        """Coordinates of the coefficients of log SDs, (P, K, W)."""
        if not level.follows_trend:
            return self._by_quantity(f"coefficients{level.suffix}", coordinates)
        shape = (self._design.parameters, len(level.coefficients), coordinates.shape[1])
        columns = np.empty(shape)
        for k, name in enumerate(level.coefficients):
            columns[:, k] = coordinates[self.slots[name]]
        return columns

    def coefficient_sd(self, name: str) -> float:
        """Prior SD of a coefficient of log sigma."""
        if name.startswith("psi"):
            return self._priors.psi_sd
        return float(getattr(self._priors, f"{name}_sd"))

    def _effects(self, named: Mapping[str, Array], rests: Mapping[str, Array]) -> EffectScales:
        """Scales of the subjects' effects."""
        size_coefficients = []
        for term in self._design.effect_size:
            size_coefficients.append(named[f"eta:{term.name}"] / self._priors.psi_sd)
        covariances = []
        for term in self._design.subject:
            sd = named[_name_of("sigma", term)]
            covariances.append(_covariance(sd, _name_of("rho", term), named, rests))
        return EffectScales(covariances, size_coefficients)


def _name_of(symbol: str, term: Term) -> str:
    """Name of a scale of a term: sigma_u, and sigma_v:hand for the factor `hand`."""
    if term.name == LEVEL:
        return _OF_LEVEL[symbol]
    return f"{_OF_FACTOR[symbol]}:{term.name}"


def _covariance(
    sd: Array, rho: str, named: Mapping[str, Array], rests: Mapping[str, Array]
) -> Block:
    """Covariance over the quantities of SDs (P, ..., W) and a correlation."""
    if rho not in named:
        return block(tuple(sd))
    return block(tuple(sd), named[rho], rests[rho])
