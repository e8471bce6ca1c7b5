"""Bands of a study's intervals against the size of its environments, and the laws they follow."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from percept.boundary.band import (
    BandOwner,
    band_laws,
    determines_laws,
    size_name,
)
from percept.boundary.law import BEYOND
from percept.boundary.shares import score_of
from percept.haptics import Device, Loop, magnitude_envelope
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.classical.moments import Moments
from percept.inference.record import Family, Method
from percept.results import Band, BandLaw, BandRow, IntervalRow, Skipped, WeberTrend
from percept.scene import InferenceTable
from percept.study.basics import FAMILIES, Array, Stream, claim_of, generator
from percept.study.data import Data
from percept.study.regions import displayable

if TYPE_CHECKING:
    from percept.study.fit import Fit


#: Environments that laws of the band need: two parameters, and one to leave out.
_FEWEST_ENVIRONMENTS = 3
#: Simulated studies, from which a law's interval comes.
_BOOTSTRAP = 1000
#: Posterior draws, about: a law's interval needs no more.
_DRAWS = 2000
#: Radians between samples at which abs(Z_h) of no device is abs(Z_e), to a double's digits.
_SAMPLED = 1e-8

#: Lower and upper limits, scalars or one per replicate, by parameter and environment.
CellLimits = Mapping[tuple[str, str], tuple[Array, Array]]
#: Limits that other studies, or posterior draws, would have: by method and family.
Replicates = dict[tuple[Method, Family], CellLimits]


@dataclasses.dataclass(frozen=True)
class Banded:
    """Environments with bands against one size: the impedance, or a parameter's reference."""

    parameter: str | None  # None for abs(Z_e)
    size: dict[str, float]  # By environment, N·s/m or in the parameter's unit; above zero
    omega: float | None = None  # rad/s, of abs(Z_e)

    def cells(self, known: Collection[tuple[str, str]]) -> dict[str, list[tuple[str, str]]]:
        """Return the cells of each environment whose band is known, of all that are."""
        parameters = ("k", "b") if self.parameter is None else (self.parameter,)
        cells = {}
        for environment in self.size:
            of_environment = [(parameter, environment) for parameter in parameters]
            if all(cell in known for cell in of_environment):
                cells[environment] = of_environment
        return cells

    def ends(self, limits: CellLimits) -> dict[str, tuple[Array, Array]]:
        """Return the range of the size over limits of each parameter, by environment."""
        ranges = {}
        for environment, cells in self.cells(limits).items():
            # Of a few subjects some studies have SDs whose limits no double holds.
            sides = [(displayable(limits[cell][0]), displayable(limits[cell][1])) for cell in cells]
            if self.omega is None:
                ranges[environment] = sides[0]
                continue
            k, b = sides
            loop = Loop(Device(0.0, 0.0), _SAMPLED / self.omega)
            ranges[environment] = magnitude_envelope(loop, self.omega, k, b)
        return ranges


def with_band(data: Data, environments: Sequence[str]) -> Iterator[Banded | Skipped]:
    """Yield what bands are set against: the impedance, or each parameter's reference.

    A band is of users; without their intervals there is none.
    """
    if "user" not in data.asked.kinds:
        return
    reference = data.reference
    if data.is_impedance:
        omega = data.scene.frequency.read_at
        size = {
            name: float(np.hypot(reference["b", name], reference["k", name] / omega))
            for name in environments
        }
        yield from _band_of(Banded(None, size, omega), "")
        return
    for parameter in data.parameters:
        size = {environment: reference[parameter, environment] for environment in environments}
        of_parameter = "" if len(data.parameters) == 1 else f" of {parameter}"
        yield from _band_of(Banded(parameter, size), of_parameter)


def _band_of(banded: Banded, of_parameter: str) -> Iterator[Banded | Skipped]:
    """Yield environments of positive size, and say which have no band and which laws lack."""
    name = size_name(banded.parameter)
    what = "the impedance of its reference" if banded.parameter is None else "its reference"
    positive = {environment: size for environment, size in banded.size.items() if size > 0}
    for environment, size in banded.size.items():
        if environment not in positive:
            sign = "negative" if size < 0 else "zero"
            yield Skipped(f"band{of_parameter} of {environment}", f"{what} is {sign}")
    if positive:
        yield dataclasses.replace(banded, size=positive)
    if len(banded.size) < 2:
        return
    law = f"band law{of_parameter}"
    if len(positive) < _FEWEST_ENVIRONMENTS:
        why = f"it needs at least {_FEWEST_ENVIRONMENTS} positive {name}s"
        yield Skipped(law, why)
    elif not determines_laws(list(positive.values())):
        yield Skipped(law, f"without one environment all {name}s lie within 5 % of each other")


def classical_replicates(data: Data, banded: Sequence[Banded]) -> Replicates:
    """Simulate the means and SDs that other studies of these users would find, and their limits.

    Environments without a band are left out: what others draw must not depend on them.
    """
    rng = generator(data.asked.seed, Stream.CLASSICAL_BANDS)
    return {
        ("classical", family): {
            cell: _redrawn_limits(of_cell, family, data.asked, rng)
            for cell, of_cell in data.moments(family).items()
            if any(cell[1] in one_band.size for one_band in banded)
        }
        for family in FAMILIES
    }


def posterior_replicates(fit: Fit) -> Replicates:
    """Return limits of the central interval of users given each posterior draw."""
    asked = fit.data.asked
    stride = max(1, len(fit.points) // _DRAWS)
    points = fit.points[::stride]
    means, _ = fit.model.draw(points, generator(asked.seed, Stream.POSTERIOR_BANDS))
    laws = fit.model.moments(points)
    score = score_of(asked.level)
    lower = fit.scale.native(means - score * laws.population_sd)
    upper = fit.scale.native(means + score * laws.population_sd)
    limits = {cell: (lower[:, number], upper[:, number]) for cell, number in fit.column.items()}
    return {("bayesian", asked.family): limits}


def _redrawn_limits(
    moments: Moments, family: Family, asked: InferenceTable, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Limits that other studies of a population with these means and SDs would give.

    A half-width in SDs depends on n alone. Redrawn SDs are unbiased in their logarithm: over many
    environments a law's error would soon be less than the bias of each, about -1/(2n).
    """
    n = int(np.asarray(moments.n))
    df = n - 1
    half_df = 0.5 * df
    mean = float(moments.mean) + float(moments.sd) / np.sqrt(n) * rng.standard_normal(_BOOTSTRAP)
    log_bias = 0.5 * (special.digamma(half_df) - np.log(half_df))
    sd_ratio = np.sqrt(rng.chisquare(df, _BOOTSTRAP) / df)
    interval = interval_of("user", moments, Claim(**claim_of(asked), family=family))
    assert interval.factor is not None
    half_width = float(interval.factor) * (float(moments.sd) / np.exp(log_bias) * sd_ratio)
    lower = mean - half_width
    upper = mean + half_width
    if family == "normal":
        return lower, upper
    with np.errstate(over="ignore"):
        return np.exp(lower), np.exp(upper)


def band_study(
    intervals: Sequence[IntervalRow], banded: Sequence[Banded], data: Data, fit: Fit | None
) -> Band:
    """Band of every size over each environment's intervals, and the laws bands follow."""
    asked = data.asked
    replicates: Replicates = {}
    if asked.method != "bayesian":
        replicates |= classical_replicates(data, banded)
    if fit is not None:
        replicates |= posterior_replicates(fit)
    tails = [0.5 * (1.0 - asked.level), 0.5 * (1.0 + asked.level)]
    rows_of_all: list[BandRow] = []
    laws: list[BandLaw] = []
    for one_band, (method, family) in itertools.product(banded, replicates):
        owner = BandOwner(method=method, family=family, parameter=one_band.parameter)
        rows = list(_rows(intervals, one_band, owner))
        environments = tuple(row.environment for row in rows)
        sizes = np.array([one_band.size[name] for name in environments])
        bands = np.array([row.band for row in rows])
        drawn_ends = one_band.ends(replicates[method, family])
        # Of a family that no environment has an interval of, there is nothing to fit.
        if (
            environments == tuple(drawn_ends)
            and determines_laws(sizes)
            and np.isfinite(bands).all()
        ):
            redrawn = np.stack([upper - lower for lower, upper in drawn_ends.values()], axis=1)
            ends = np.quantile(redrawn, tails, axis=0).T.tolist()
            rows = [
                dataclasses.replace(row, band_lower=lower, band_upper=upper)
                for row, (lower, upper) in zip(rows, ends, strict=True)
            ]
            # Draws of a posterior have laws of their own; a bootstrap's scatter about the study's
            # bands.
            own = None if method == "bayesian" else bands
            laws += band_laws(environments, sizes, own, redrawn, owner, level=asked.level)
        rows_of_all += rows
    trends = None if fit is None else weber_trend(fit, level=asked.level)
    return Band(banded[0].omega, tuple(rows_of_all), tuple(laws), trends)


def _rows(intervals: Sequence[IntervalRow], banded: Banded, owner: BandOwner) -> Iterator[BandRow]:
    """Yield the band of users of each environment that has all its limits."""
    users: CellLimits = {
        (row.parameter, row.environment): (np.asarray(row.lower), np.asarray(row.upper))
        for row in intervals
        if (row.method, row.family) == (owner.method, owner.family)
        and (row.kind, row.joint) == ("user", "marginal")
    }
    cells = banded.cells(users)
    for environment, (lower, upper) in banded.ends(users).items():
        size = banded.size[environment]
        sides = np.array([users[cell] for cell in cells[environment]])
        if np.abs(sides).max() >= BEYOND:
            # Of two or three subjects the logarithms leave a limit open.
            upper = np.array(np.inf)
        band = float(upper) - float(lower)
        yield BandRow(
            **vars(owner),
            environment=environment,
            impedance=size if banded.parameter is None else None,
            reference=None if banded.parameter is None else size,
            lower=float(lower),
            upper=float(upper),
            band=band,
            relative=band / size,
        )


def weber_trend(fit: Fit, *, level: float) -> tuple[WeberTrend, ...] | None:
    """Give the trend of log spread per decade of the reference, which Weber's law sets to zero."""
    named = fit.model.scales(fit.points)
    if "kappa" not in named:
        return None
    _, drawn = named["kappa"]
    tail = 0.5 * (1.0 - level)
    trends = []
    for parameter, kappa in zip(fit.parameters, drawn.T, strict=True):
        lower, upper = np.quantile(kappa, [tail, 1.0 - tail]).tolist()
        trends.append(
            WeberTrend(
                parameter=parameter,
                lower=lower,
                value=float(kappa.mean()),
                upper=upper,
                below_zero=float((kappa < 0).mean()),
            )
        )
    return tuple(trends)
