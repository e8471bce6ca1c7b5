"""The coordinates of a linear design, and the scales that they stand for.

The sampler moves in d coordinates, all near standard normal. `Coordinates` names them and
maps W sets of them to SDs and correlations. In this order there are, with P quantities p, C cells
c, N subjects i and J environments:

    sigma[p,c], log_s[p], kappa[p], omega[p], rho_w     SDs between subjects in each cell
    sigma_e[p,c], log_s_e[p], …, omega_e[p], rho_e      SDs between trials, with repeats only
    phi[p,i], omega_s[p]        log ratios of subjects' trial SDs, if they have their own
    sigma_u[p], rho_u           covariance of the subjects' effects on all cells
    sigma_v:hand[p], rho_v:hand the same of their effects under the factor `hand`, and of their own
                                slopes of a covariate that varies within subjects
    tau[p], tau:hand[p]         SDs of the environments' deviations
    eta:hand[p,·]               how the size of the subjects' effects differs between levels

Correlations exist with two quantities only. Columns of log SDs for factors have the coefficients
psi:hand[p]. Under the prior every coordinate is standard normal and independent, but for sigma and
phi: `CellSpreads` and `SubjectSpreads` shape these by the data, and give their density.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block, block
from percept.inference.model.design import LEVEL, TREND, Design, Term
from percept.inference.model.priors import Priors, correlation, half_normal
from percept.inference.model.spreads import CellSpreads, LogSpreads, numbered
from percept.inference.model.statistics import Statistics
from percept.inference.model.subject_spreads import SubjectSpreads

Array = NDArray[np.float64]
#: A dimension and its labels.
Axis = tuple[str, Sequence[str]]

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclasses.dataclass(frozen=True, eq=False)
class CellScales:
    """All that the laws of the locations and of users depend on, at W sets of coordinates.

    There are T groups of trials, q columns of a subject's effects, and a columns of the
    environments' own deviations.
    """

    between: Block  # (C, W) Covariance between subjects within a cell
    trial: Block | None  # (T, W) Covariance between the trials of a group; None without repeats
    effects: Array  # (q, P, C, W) Columns Z: what a unit of each subject's effect adds to a cell
    slopes: list[Block]  # (W,) Of subjects' own slopes of covariates over the quantities
    tau: Array  # (a, W) SDs of the environments' own deviations, one for each column


@dataclasses.dataclass(frozen=True, eq=False)
class Scales:
    """Scales and correlations at W sets of coordinates."""

    named: dict[str, Array]  # By name: (W,), (P, W), (P, C, W), or (P, N, W) for phi
    rests: dict[str, Array]  # (W,) 1 - abs(rho) of every correlation
    cells: CellScales  # As the locations need them
    multiples: Array  # (P, K, W) Coefficients of log SDs between subjects over their prior SDs
    log_prior: Array  # (W,) Prior density of the coordinates


class Coordinates:
    """Names of the coordinates of a linear design, and their map to scales.

    Parameters
    ----------
    statistics : Statistics
        Of the responses; its environments are the design's cells.
    design : Design
        The columns.
    priors : Priors
        Prior scales.

    Attributes
    ----------
    names : list of str
        Of the d coordinates.
    slots : dict
        Coordinates of each scale.
    dimensions : dict
        What the axes of each scale are, by its name.
    priors_in_use : set of str
        Fields of `Priors` that the scales have.
    between, trial : CellSpreads
        Maps of the SDs between subjects, and between trials; the second is None without repeats.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors,
    ) -> None:
        covariates = statistics.covariates
        own_slopes = covariates.within if covariates is not None else ()
        #: Ends of the names of scales of subjects' effects, and then of their own slopes.
        self._effects = ["u" if term.name == LEVEL else f"v:{term.name}" for term in design.subject]
        self._effects += [f"v:{name}" for name in own_slopes]
        self._design = design
        self._priors = priors
        self._scatter = statistics.scatter
        self.between = CellSpreads(statistics, design, priors, "")
        self.trial: CellSpreads | None = None
        self._subject_spreads: SubjectSpreads | None = None
        if statistics.repeats:
            self.trial = CellSpreads(statistics, design, priors, "_e")
            if self._scatter.subject is not None:
                self._subject_spreads = SubjectSpreads(statistics)
        self.names: list[str] = []
        self.slots: dict[str, slice] = {}
        self.dimensions: dict[str, tuple[str, ...]] = {}
        self.priors_in_use: set[str] = set()
        #: Scales of half-normal priors, by the names of the SDs.
        self._half_normals: dict[str, float] = {}
        #: Coordinates that are standard normal under the prior, whatever the rest.
        self._standard: list[int] = []
        self._name_coordinates(statistics)
        self._correlations = [name for name in self.slots if name.startswith("rho")]

    @property
    def levels(self) -> list[CellSpreads]:
        """Maps of the SDs of all levels."""
        if self.trial is None:
            return [self.between]
        return [self.between, self.trial]

    def _name_coordinates(self, statistics: Statistics) -> None:
        """Give every coordinate its name, and every scale its coordinates."""
        design = self._design
        quantities = ("parameter", statistics.parameters)
        pair = design.parameters == 2
        for level in self.levels:
            self._name_level(level, quantities)
            if pair:
                self._append(level.rho, prior="rho_shape")
        if self._subject_spreads is not None:
            subjects = ("subject", statistics.subjects)
            self._append("phi", quantities, subjects)
            self._append("omega_s", quantities, prior="omega_s_scale")
        for suffix in self._effects:
            of_trend = suffix == f"v:{TREND}"
            prior = "sigma_trend_scale" if of_trend else "sigma_u_scale"
            self._append(f"sigma_{suffix}", quantities, prior=prior)
            if pair:
                self._append(f"rho_{suffix}", prior="rho_shape")
        for term in design.deviation:
            self._append(_tau(term), quantities, prior="tau_scale")
        for term in design.effect_size:
            columns = (f"{term.name} column", numbered("column", len(term.columns)))
            self._append(f"eta:{term.name}", quantities, columns, prior="psi_sd")

    def _name_level(
        self,
        level: CellSpreads,
        quantities: Axis,
    ) -> None:
        """Name the coordinates of log SDs, but for their correlation."""
        suffix = level.suffix
        self.priors_in_use |= {f"log_s{suffix}_mean", f"log_s{suffix}_sd"}
        self.dimensions[f"sigma{suffix}"] = ("parameter", "environment")
        if level.departures:
            cells = ("environment", self._design.cells.names)
            self._append(f"sigma{suffix}", quantities, cells)
        for coefficient, prior in level.coefficients.items():
            self._append(coefficient, quantities, prior=prior)
        if level.departures and level.single_sd is None:
            self._append(f"omega{suffix}", quantities, prior=f"omega{suffix}_scale")

    def _append(
        self,
        scale: str,
        *axes: Axis,
        prior: str = "",
    ) -> None:
        """Append the coordinates of a scale, one for each combination of labels.

        Those with a prior of their own are standard normal, whatever the rest.
        """
        if prior.endswith("_scale"):
            self._half_normals[scale] = getattr(self._priors, prior)
        first = len(self.names)
        for labels in itertools.product(*(labels for _, labels in axes)):
            joined = ",".join(labels)
            self.names.append(f"{scale}[{joined}]" if joined else scale)
        end = len(self.names)
        self.slots[scale] = slice(first, end)
        self.dimensions[scale] = tuple(dimension for dimension, _ in axes)
        if prior:
            self.priors_in_use.add(prior)
            self._standard += range(first, end)

    def __call__(self, points: Array) -> Scales:
        """Map coordinates (W, d) to scales."""
        coordinates = np.ascontiguousarray(points.T)
        standard = coordinates[self._standard]
        squares = np.einsum("dw,dw->w", standard, standard)
        log_prior = -0.5 * (squares + _LOG_2PI * len(standard))
        named: dict[str, Array] = {}
        for name, scale in self._half_normals.items():
            named[name] = half_normal(coordinates[self.slots[name]], scale)
        rests: dict[str, Array] = {}
        for name in self._correlations:
            (row,) = coordinates[self.slots[name]]
            named[name], rests[name] = correlation(row, self._priors.rho_shape)
        for term in self._design.effect_size:
            eta = self._by_quantity(f"eta:{term.name}", coordinates)
            named[f"eta:{term.name}"] = self._priors.psi_sd * eta
        between = self._level_sds(self.between, coordinates, 0.0, named)
        log_prior += between.log_density
        if self.trial is not None:
            shift: Array | float = 0.0
            if self._subject_spreads is not None:
                of_subjects = self._by_quantity("phi", coordinates)
                named["phi"], log_density = self._subject_spreads(of_subjects, named["omega_s"])
                log_prior += log_density
                shift = self._subject_spreads.cells_given(named["phi"])
            log_prior += self._level_sds(self.trial, coordinates, shift, named).log_density
        return Scales(
            named=named,
            rests=rests,
            cells=self.cell_scales(named, rests, self._design),
            multiples=between.multiples,
            log_prior=log_prior,
        )

    def cell_scales(
        self,
        named: Mapping[str, Array],
        rests: Mapping[str, Array],
        design: Design,
    ) -> CellScales:
        """Scales of cells from scales and correlations by name.

        Parameters
        ----------
        named : mapping
            Values as `Scales.named` has them. Of log SDs it needs the SDs alone.
        rests : mapping
            1 - abs(rho) of every correlation, with the digits that one near one loses.
        design : Design
            Of these cells: other ones than the coordinates' may have the same terms.
        """
        width = named["sigma"].shape[-1]
        trial: Block | None = None
        if self.trial is not None:
            # Of each group of trials, entries (T, W).
            of_groups = named["sigma_e"][:, self._scatter.cell]
            if self._scatter.subject is not None:
                of_groups = of_groups * np.exp(named["phi"][:, self._scatter.subject])
            trial = _covariance(of_groups, "rho_e", named, rests)
        # A term may have several columns, each once for every quantity.
        taus = [named[_tau(term)] for term in design.deviation for _ in term.columns]
        covariances = []
        for suffix in self._effects:
            sd = named[f"sigma_{suffix}"]
            covariances.append(_covariance(sd, f"rho_{suffix}", named, rests))
        columns = []
        for term, covariance in zip(design.subject, covariances, strict=False):
            roots = [np.stack(root)[:, None] for root in covariance.factor_columns()]
            for column in term.columns:
                columns += [column[..., None] * root for root in roots]
        effects = np.reshape(columns, (len(columns), *design.cells.x.shape, width))
        for term in design.effect_size:
            log_size = np.einsum("kpc,pkw->pcw", term.columns, named[f"eta:{term.name}"])
            effects = effects * np.exp(log_size)
        return CellScales(
            between=_covariance(named["sigma"], "rho_w", named, rests),
            trial=trial,
            effects=effects,
            slopes=covariances[len(design.subject) :],
            tau=np.reshape(taus, (len(taus) * design.parameters, width)),
        )

    def _by_quantity(
        self,
        name: str,
        coordinates: Array,
    ) -> Array:
        """Coordinates of a scale, (P, count, W)."""
        flat = coordinates[self.slots[name]]
        return flat.reshape(self._design.parameters, -1, flat.shape[-1])

    def _level_sds(
        self,
        level: CellSpreads,
        coordinates: Array,
        shift: Array | float,
        named: dict[str, Array],
    ) -> LogSpreads:
        """Name the SDs of one level, and return them.

        The rough likelihood is moved by a shift (P, C, W).
        """
        suffix = level.suffix
        width = coordinates.shape[1]
        of_columns = [coordinates[self.slots[name]] for name in level.coefficients]
        shape = (len(of_columns), self._design.parameters, width)
        columns = np.reshape(of_columns, shape).swapaxes(0, 1)
        if level.departures:
            of_cells = self._by_quantity(f"sigma{suffix}", coordinates)
            omega = named.get(f"omega{suffix}")
            if omega is None:
                omega = np.full((len(of_cells), width), level.single_sd)
            spreads = level(columns, of_cells, omega, shift)
        else:
            spreads = level.without_departures(columns)
        for k, (name, prior) in enumerate(level.coefficients.items()):
            named[name] = spreads.multiples[:, k] * getattr(self._priors, prior)
        named[f"sigma{suffix}"] = np.exp(spreads.log_sigma)
        return spreads


def _tau(term: Term) -> str:
    """Name of the SD of the environments' deviations under a term."""
    return "tau" if term.name == LEVEL else f"tau:{term.name}"


def _covariance(
    sd: Array,
    rho: str,
    named: Mapping[str, Array],
    rests: Mapping[str, Array],
) -> Block:
    """Covariance over the quantities of SDs (P, ..., W) and a correlation."""
    if rho not in named:
        return block(tuple(sd))
    return block(tuple(sd), named[rho], rests[rho])
