"""Bands of a study's intervals against the size of its environments, and the laws they follow."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from percept.boundary.band import (
    BandLaw,
    BandStatement,
    BandStudy,
    band_laws,
    band_statements,
    determines_laws,
    size_name,
)
from percept.haptics import Device, magnitude_envelope
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.classical.moments import Moments
from percept.inference.record import Family, Kind
from percept.scene import InferenceTable
from percept.sessions.quantities import is_impedance
from percept.study.basics import Array, References, Skipped, Stream, claim_of, generator
from percept.study.intervals import Cell, known_moments
from percept.study.regions import displayable

if TYPE_CHECKING:
    from percept.study.fit import Fit

#: Environments that laws of the band need.
FEWEST = 3
_BOOTSTRAP = 1000
_LABELS = ["method", "kind", "family"]
# A law's interval needs no more posterior draws than that either.
_DRAWS = 2000
#: Lower and upper limits, scalars or one per replicate, by parameter and environment.
CellLimits = Mapping[tuple[str, str], tuple[Array, Array]]
#: Limits that other studies, or posterior draws, would have: by method, kind and family.
Replicates = dict[tuple[str, str, str], CellLimits]


class Banded(NamedTuple):
    """Environments whose bands are set against one size: the impedance, or the reference of a parameter."""

    parameter: str | None  # None for abs(Z_e)
    size: dict[str, float]  # By environment, N·s/m or in the parameter's unit; above zero
    omega: float | None = None  # rad/s, of abs(Z_e)

    def cells(self, known: Collection[tuple[str, str]]) -> dict[str, list[tuple[str, str]]]:
        """Cells of each environment whose band is known, of all that are."""
        parameters = ("k", "b") if self.parameter is None else (self.parameter,)
        own = {environment: [(p, environment) for p in parameters] for environment in self.size}
        return {
            environment: cells
            for environment, cells in own.items()
            if all(c in known for c in cells)
        }

    def ends(self, limits: CellLimits) -> dict[str, tuple[Array, Array]]:
        """Range of the size over limits of each parameter, of every environment that has them."""
        found = {}
        for environment, cells in self.cells(limits).items():
            # Of a few subjects some studies have SDs whose limits no double holds.
            own = [(displayable(limits[cell][0]), displayable(limits[cell][1])) for cell in cells]
            if self.omega is None:
                found[environment] = own[0]
            else:
                # Sampled this fast abs(Z_h) of no device is abs(Z_e), to a double's digits.
                k, b = own
                found[environment] = magnitude_envelope(
                    self.omega, Device(0.0, 0.0), k, b, 1e-8 / self.omega
                )
        return found


def with_band(
    reference: References,
    parameters: Sequence[str],
    environments: Sequence[str],
    omega: float,
    *,
    no_share: bool,
) -> Iterator[Banded | Skipped]:
    """Yield what bands can be set against: the impedance at `omega`, or the reference of each parameter."""
    banded = [Banded(p, {e: reference[p, e] for e in environments}) for p in parameters]
    what = "its reference"
    if is_impedance(parameters):
        size = {
            e: float(np.hypot(reference["b", e], reference["k", e] / omega)) for e in environments
        }
        banded, what = [Banded(None, size, omega)], "the impedance of its reference"
    for one in banded:
        name, of = size_name(one.parameter), "" if len(banded) == 1 else f" of {one.parameter}"
        kept = {environment: value for environment, value in one.size.items() if value > 0}
        for environment, value in one.size.items():
            if environment not in kept:
                sign = "negative" if value < 0 else "zero"
                yield Skipped(f"band{of} of {environment}", f"{what} is {sign}")
        if kept:
            yield one._replace(size=kept)
        if len(environments) < 2:
            continue
        if len(kept) < FEWEST:
            yield Skipped(
                f"band law{of}", f"it needs {FEWEST} environments whose {name} is positive"
            )
        elif not determines_laws(list(kept.values())):
            yield Skipped(f"band law{of}", f"without one environment the others share one {name}")
        elif no_share:
            why = "a single posterior draw has no band that holds a share of users"
            yield Skipped(f"Bayesian band law{of}, kind share", why)


def classical_replicates(
    cells: Mapping[Family, Sequence[Cell]], asked: InferenceTable, banded: Sequence[Banded]
) -> Replicates:
    """Simulate the means and SDs that other studies of these users would find, and their limits."""
    rng = generator(asked.seed, Stream.CLASSICAL_BANDS)
    found: Replicates = {}
    for family, of_family in cells.items():
        every = known_moments(of_family, family)
        needed = {cell for one in banded for own in one.cells(every).values() for cell in own}
        drawn = {
            cell: (every[cell], *_redrawn(every[cell], rng)) for cell in every if cell in needed
        }
        for kind in asked.kinds:
            limits = {
                cell: _limits(*of_cell, kind, family, asked) for cell, of_cell in drawn.items()
            }
            found["classical", kind, family] = limits
    return found


def posterior_replicates(fit: Fit, asked: InferenceTable) -> Replicates:
    """Limits of the central interval given each posterior draw: of the population's mean, or of its users."""
    points = fit.points[:: max(1, len(fit.points) // _DRAWS)]
    means, _ = fit.model.draw(points, generator(asked.seed, Stream.POSTERIOR_BANDS))
    laws = fit.model.laws(points)
    out = -special.ndtri(0.5 * (1.0 - asked.level))
    found: Replicates = {}
    for kind, centre, sd in (("mean", laws.mean, laws.sd), ("user", means, laws.population_sd)):
        if kind in asked.kinds:
            lower, upper = fit.scale.native(centre - out * sd), fit.scale.native(centre + out * sd)
            limits = {cell: (lower[:, c], upper[:, c]) for cell, c in fit.column.items()}
            found["bayesian", kind, asked.family] = limits
    return found


def _redrawn(moments: Moments, rng: np.random.Generator) -> tuple[Array, Array]:
    """Means and SDs of studies of a population that has these, SDs unbiased in their logarithm."""
    # Over many environments a law's error would soon be less than the bias of each, about -1/(2n).
    n, sd = int(np.asarray(moments.n)), float(moments.sd)
    half = 0.5 * (n - 1)
    mean = float(moments.mean) + sd / np.sqrt(n) * rng.standard_normal(_BOOTSTRAP)
    expected = np.exp(0.5 * (special.digamma(half) - np.log(half)))
    return mean, sd / expected * np.sqrt(rng.chisquare(n - 1, _BOOTSTRAP) / (n - 1))


def _limits(
    moments: Moments, mean: Array, sd: Array, kind: Kind, family: Family, asked: InferenceTable
) -> tuple[Array, Array]:
    """Limits about redrawn means and SDs: an interval's half-width in SDs depends on n alone."""
    factor = interval_of(kind, moments, Claim(**claim_of(asked), family=family)).factor
    assert factor is not None
    lower, upper = mean - float(factor) * sd, mean + float(factor) * sd
    if family == "normal":
        return lower, upper
    with np.errstate(over="ignore"):
        return np.exp(lower), np.exp(upper)


def band_study(
    intervals: pd.DataFrame,
    banded: Sequence[Banded],
    cells: Mapping[Family, Sequence[Cell]],
    fit: Fit | None,
    asked: InferenceTable,
) -> BandStudy:
    """Band of every size over each environment's intervals, and the laws bands follow."""
    replicates: Replicates = {}
    if asked.method != "bayesian":
        replicates |= classical_replicates(cells, asked, banded)
    if fit is not None:
        replicates |= posterior_replicates(fit, asked)
    tables, laws, statements = [], list[BandLaw](), list[BandStatement]()
    for one in banded:
        table = pd.DataFrame(_rows(intervals, one))
        tables.append(table)
        for labels, part in table.groupby(_LABELS, sort=False) if len(table) else ():
            method, kind, family = map(str, labels)
            drawn = one.ends(replicates.get((method, kind, family), {}))
            size, bands = part[size_name(one.parameter)].to_numpy(), part["band"].to_numpy()
            names = tuple(part["environment"])
            if names != tuple(drawn) or not determines_laws(size):
                continue
            redrawn = np.stack([upper - lower for lower, upper in drawn.values()], axis=1)
            # Draws of a posterior have laws of their own; a bootstrap's scatter about the study's
            # bands.
            fitted = None if method == "bayesian" else bands
            of: dict[str, Any] = {
                **dict(zip(_LABELS, labels, strict=True)),
                "parameter": one.parameter,
            }
            laws += band_laws(names, size, fitted, redrawn, level=asked.level, **of)
            statements += band_statements(size, redrawn, **of)
    rows = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    kappa = None if fit is None else weber_trend(fit, level=asked.level)
    return BandStudy(banded[0].omega, rows, tuple(laws), tuple(statements), kappa)


def _rows(intervals: pd.DataFrame, banded: Banded) -> Iterator[dict[str, object]]:
    """Yield the band of each environment, method, kind and family with limits of every parameter."""
    names = ["environment", *_LABELS]
    of = {} if banded.parameter is None else {"parameter": banded.parameter}
    for labels, rows in intervals[intervals["joint"] == "marginal"].groupby(names, sort=False):
        cells = zip(rows["parameter"], rows["environment"], strict=True)
        ends = zip(rows["lower"].to_numpy(), rows["upper"].to_numpy(), strict=True)
        limits = dict(zip(cells, ends, strict=True))
        for environment, span in banded.ends(limits).items():
            lower, upper = map(float, span)
            size, band = banded.size[environment], upper - lower
            yield {
                **dict(zip(names, labels, strict=True)),
                **of,
                size_name(banded.parameter): size,
                "lower": lower,
                "upper": upper,
                "band": band,
                "relative": band / size,
            }


def weber_trend(fit: Fit, *, level: float) -> pd.DataFrame | None:
    """Give the trend of log spread per decade of the reference, which Weber's law sets to zero."""
    named = fit.model.scales(fit.points)
    if "kappa" not in named:
        return None
    drawn = named["kappa"][1]
    lower, upper = np.quantile(drawn, [0.5 * (1.0 - level), 0.5 * (1.0 + level)], axis=0)
    return pd.DataFrame(
        {
            "parameter": fit.parameters,
            "lower": lower,
            "value": drawn.mean(axis=0),
            "upper": upper,
            "below_zero": (drawn < 0).mean(axis=0),
        }
    )
