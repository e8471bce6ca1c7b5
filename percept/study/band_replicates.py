"""Draws of a study's bands: of its posterior, and of a parametric bootstrap of its classical intervals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.band import environment_magnitude_range
from percept.inference.classical.moments import Moments
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.bayesian import Fit
from percept.study.classical import FAMILIES, cell_interval, cell_moments
from percept.study.posterior import thinned_points
from percept.study.regions import displayable
from percept.study.streams import Stream, generator

Array = NDArray[np.float64]


class Redrawn(NamedTuple):
    """Bands (S, J), N·s/m, of some environments, in the order of the study."""

    environments: tuple[str, ...]
    bands: Array


#: By method, kind and family.
Replicates = dict[tuple[str, str, str], Redrawn]
_BOOTSTRAP = 1000
# A law's interval needs no more posterior draws than that either.
_DRAWS = 2000


def classical_replicates(
    sessions: Sessions, scene: Scene, environments: tuple[str, ...], omega: float
) -> Replicates:
    """Simulate the means and SDs that other studies of these users would find, and their bands."""
    rng = generator(scene.inference.seed, Stream.CLASSICAL_BANDS)
    found: Replicates = {}
    for family in FAMILIES:
        cells = {(c.parameter, c.environment): c.moments for c in cell_moments(sessions, ("k", "b"), family)}
        known = {cell: moments for cell, moments in cells.items() if moments is not None}
        names = tuple(e for e in environments if ("k", e) in known and ("b", e) in known)
        if not names:
            continue
        known = {cell: moments for cell, moments in known.items() if cell[1] in names}
        drawn = {cell: _redrawn(moments.on_scale(family), rng) for cell, moments in known.items()}
        for kind in scene.inference.kinds:
            limits = {cell: _limits(known[cell], drawn[cell], kind, family, scene, cell[0]) for cell in known}
            bands = [_bands(omega, limits["k", e], limits["b", e]) for e in names]
            found["classical", kind, family] = Redrawn(names, np.stack(bands, axis=1))
    return found


def posterior_replicates(fit: Fit, scene: Scene, environments: tuple[str, ...], omega: float) -> Replicates:
    """Bands of the central interval given each posterior draw: of the population's mean, or of its users.

    Limits that hold a share of users with a stated confidence belong to the posterior as a whole: there are
    none given a draw, and no law of theirs.
    """
    asked = scene.inference
    model, scale = fit.prepared.model, fit.prepared.scale
    names = tuple(e for e in environments if ("k", e) in model.cells)
    if not names:
        return {}
    points = thinned_points(fit)[0]
    points = points[:: max(1, len(points) // _DRAWS)]
    rng = generator(asked.seed, Stream.POSTERIOR_BANDS)
    means, _ = model.draw(points, rng)
    laws = model.laws(points)
    found: Replicates = {}
    reach = -special.ndtri(0.5 * (1.0 - asked.level))
    for kind in asked.kinds:
        if kind == "share":
            continue
        centre, spread = (laws.mean, laws.sd) if kind == "mean" else (means, laws.population_sd)
        ends = scale.native(centre - reach * spread), scale.native(centre + reach * spread)
        limits = {cell: (ends[0][:, c], ends[1][:, c]) for c, cell in enumerate(model.cells)}
        bands = [_bands(omega, limits["k", e], limits["b", e]) for e in names]
        found["bayesian", kind, asked.family] = Redrawn(names, np.stack(bands, axis=1))
    return found


def _bands(omega: float, stiffness: tuple[Array, Array], damping: tuple[Array, Array]) -> Array:
    # Of a few subjects some studies have SDs whose limits no double holds.
    k, b = ((displayable(low), displayable(high)) for low, high in (stiffness, damping))
    lower, upper = environment_magnitude_range(omega, k, b)
    return upper - lower


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
    moments: Moments, drawn: tuple[Array, Array], kind: str, family: str, scene: Scene, parameter: str
) -> tuple[Array, Array]:
    interval = cell_interval(moments, kind, family, scene, parameter, "marginal")
    assert interval.factor is not None
    mean, reach = drawn[0], float(interval.factor) * drawn[1]
    if family == "lognormal":
        with np.errstate(over="ignore"):
            return np.exp(mean - reach), np.exp(mean + reach)
    return mean - reach, mean + reach
