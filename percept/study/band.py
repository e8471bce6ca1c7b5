"""Bands of a study's intervals against the impedance of its environments, and the laws they follow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from percept.boundary.band import (
    BandLaw,
    BandStatement,
    BandStudy,
    band_laws,
    band_statements,
    environment_magnitude_range,
)
from percept.inference.classical.intervals import interval_of
from percept.inference.classical.moments import Moments
from percept.inference.record import Family, Kind
from percept.scene import InferenceTable
from percept.study.basics import Array, References, Skipped, Stream, claim_of, generator
from percept.study.intervals import Cell, known_moments, paired_limits
from percept.study.regions import displayable

if TYPE_CHECKING:
    from percept.study.fit import Fit

#: Environments that laws of the band need.
FEWEST = 3
_BOOTSTRAP = 1000
# A law's interval needs no more posterior draws than that either.
_DRAWS = 2000


class Redrawn(NamedTuple):
    """Bands (S, J), N·s/m, of some environments, in the order of the study."""

    environments: tuple[str, ...]
    bands: Array


#: By method, kind and family.
Replicates = dict[tuple[str, str, str], Redrawn]


def with_band(
    reference: References, environments: Sequence[str], asked: InferenceTable, omega: float
) -> Iterator[str | Skipped]:
    """Yield the environments whose band can be set against their impedance at `omega`, one above zero."""
    count = 0
    for environment in environments:
        if np.hypot(reference["b", environment], reference["k", environment] / omega) > 0:
            count += 1
            yield environment
        else:
            yield Skipped(f"band of {environment}", "the impedance of its reference is zero")
    if len(environments) > 1 and count < FEWEST:
        yield Skipped("band law", f"it needs {FEWEST} environments whose impedance is not zero")
    elif count >= FEWEST and asked.method != "classical" and "share" in asked.kinds:
        yield Skipped(
            "Bayesian band law, kind share", "no posterior draw has a band of its own that holds a share"
        )


def classical_replicates(
    cells: Mapping[Family, Sequence[Cell]],
    asked: InferenceTable,
    environments: Sequence[str],
    omega: float,
) -> Replicates:
    """Simulate the means and SDs that other studies of these users would find, and their bands."""
    rng = generator(asked.seed, Stream.CLASSICAL_BANDS)
    found: Replicates = {}
    for family, of_family in cells.items():
        known = known_moments(of_family, family)
        names = tuple(e for e in environments if ("k", e) in known and ("b", e) in known)
        if not names:
            continue
        known = {cell: moments for cell, moments in known.items() if cell[1] in names}
        drawn = {cell: _redrawn(moments, rng) for cell, moments in known.items()}
        for kind in asked.kinds:
            limits = {cell: _limits(known[cell], *drawn[cell], kind, family, asked) for cell in known}
            found["classical", kind, family] = _bands(names, limits, omega)
    return found


def posterior_replicates(
    fit: Fit, asked: InferenceTable, environments: Sequence[str], omega: float
) -> Replicates:
    """Bands of the central interval given each posterior draw: of the population's mean, or of its users.

    Limits that hold a share of users with a stated confidence belong to the posterior as a whole: there are
    none given a draw, and no law of theirs.
    """
    names = tuple(e for e in environments if ("k", e) in fit.column)
    if not names:
        return {}
    points = fit.points[:: max(1, len(fit.points) // _DRAWS)]
    means, _ = fit.model.draw(points, generator(asked.seed, Stream.POSTERIOR_BANDS))
    laws = fit.model.laws(points)
    out = -special.ndtri(0.5 * (1.0 - asked.level))
    found: Replicates = {}
    for kind, centre, sd in (("mean", laws.mean, laws.sd), ("user", means, laws.population_sd)):
        if kind in asked.kinds:
            lower, upper = fit.scale.native(centre - out * sd), fit.scale.native(centre + out * sd)
            limits = {cell: (lower[:, c], upper[:, c]) for cell, c in fit.column.items()}
            found["bayesian", kind, asked.family] = _bands(names, limits, omega)
    return found


def _bands(
    names: tuple[str, ...], limits: Mapping[tuple[str, str], tuple[Array, Array]], omega: float
) -> Redrawn:
    bands = []
    for environment in names:
        # Of a few subjects some studies have SDs whose limits no double holds.
        k, b = (
            (displayable(low), displayable(high))
            for low, high in (limits["k", environment], limits["b", environment])
        )
        lower, upper = environment_magnitude_range(omega, k, b)
        bands.append(upper - lower)
    return Redrawn(names, np.stack(bands, axis=1))


def _redrawn(moments: Moments, rng: np.random.Generator) -> tuple[Array, Array]:
    """Means and SDs of studies of a population that has these, SDs unbiased in their logarithm.

    Laws are fitted to logarithms over all environments: left in, the bias of each, about -1/(2n), would soon
    outweigh the error of a law that many environments share.
    """
    n, sd = int(np.asarray(moments.n)), float(moments.sd)
    half = 0.5 * (n - 1)
    mean = float(moments.mean) + sd / np.sqrt(n) * rng.standard_normal(_BOOTSTRAP)
    expected = np.exp(0.5 * (special.digamma(half) - np.log(half)))
    return mean, sd / expected * np.sqrt(rng.chisquare(n - 1, _BOOTSTRAP) / (n - 1))


def _limits(
    moments: Moments, mean: Array, sd: Array, kind: Kind, family: Family, asked: InferenceTable
) -> tuple[Array, Array]:
    """Limits about redrawn means and SDs: an interval's half-width in SDs depends on n alone."""
    factor = interval_of(kind, moments, **claim_of(asked), family=family).factor
    assert factor is not None
    lower, upper = mean - float(factor) * sd, mean + float(factor) * sd
    if family == "normal":
        return lower, upper
    with np.errstate(over="ignore"):
        return np.exp(lower), np.exp(upper)


def band_study(
    intervals: pd.DataFrame,
    environments: Sequence[str],
    cells: Mapping[Family, Sequence[Cell]],
    fit: Fit | None,
    asked: InferenceTable,
    omega: float,
) -> BandStudy:
    """Band of abs(Z_e) over each environment's rectangle of intervals, and the laws bands follow."""
    level = asked.level
    replicates: Replicates = {}
    if asked.method != "bayesian":
        replicates |= classical_replicates(cells, asked, environments, omega)
    if fit is not None:
        replicates |= posterior_replicates(fit, asked, environments, omega)
    kappa = None if fit is None else weber_trend(fit, level=level)
    table = pd.DataFrame(_rows(intervals[intervals["environment"].isin(environments)], omega))
    laws: list[BandLaw] = []
    statements: list[BandStatement] = []
    for found, part in table.groupby(["method", "kind", "family"], sort=False) if len(table) else ():
        method, kind, family = (str(label) for label in found)
        redrawn = replicates.get((method, kind, family))
        impedance, bands = part["impedance"].to_numpy(), part["band"].to_numpy()
        names = tuple(part["environment"])
        if redrawn is None or names != redrawn.environments or len(names) < FEWEST:
            continue
        drawn = redrawn.bands
        # Draws of a posterior have laws of their own; a bootstrap's scatter about that of the study's bands.
        fitted = None if method == "bayesian" else bands
        laws += band_laws(
            names, impedance, fitted, drawn, method=method, kind=kind, family=family, level=level
        )
        statements += band_statements(impedance, drawn, method=method, kind=kind, family=family)
    return BandStudy(omega, table, tuple(laws), tuple(statements), kappa)


def _rows(intervals: pd.DataFrame, omega: float) -> Iterator[dict[str, object]]:
    labels = ("environment", "method", "kind", "family")
    for cell, limits in paired_limits(intervals[intervals["joint"] == "marginal"], labels):
        lower, upper = (float(end) for end in environment_magnitude_range(omega, *limits))
        impedance = float(np.hypot(cell["b"]["reference"], cell["k"]["reference"] / omega))
        yield {
            **{label: cell["k"][label] for label in labels},
            "impedance": impedance,
            "lower": lower,
            "upper": upper,
            "band": upper - lower,
            "relative": (upper - lower) / impedance,
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
