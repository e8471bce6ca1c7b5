"""Boundaries of a study: curves around every region of (k, b), and through draws of (k, b)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from percept.boundary.curves import Grid, adaptive_grid, curve_gap
from percept.boundary.draws import DrawCurves, relative_error
from percept.boundary.records import Boundary, Shape
from percept.errors import UsageError
from percept.scene import Scene
from percept.study.basics import Array, Skipped
from percept.study.device import Setup
from percept.study.regions import Draws, Region

#: How k and b can be taken together: each by itself, both widened, one region, curves through draws.
JOINTS = ("marginal", "bonferroni", "hotelling", "joint")
# The proxies that a band through draws is followed by lie this many SDs out: about its usual half-width.
_PROXY = 3.0
# A close view shows this part of the frequency on either side: how closely the paper looks.
_LOOK_BY = 0.02


@dataclasses.dataclass(frozen=True)
class Range:
    """Frequencies of curves: a grid as asked, or as many as the curves need."""

    lower: float  # rad/s
    upper: float  # rad/s
    omega: Array | None = None  # The grid asked for, rad/s

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends, rad/s."""
        return self.lower, self.upper

    @classmethod
    def of(cls, omega: ArrayLike | Range) -> Range:
        """Take a grid (M,) as it is, rad/s; UsageError unless it is positive and increases."""
        if isinstance(omega, Range):
            return omega
        try:
            grid = np.asarray(omega, dtype=np.float64)
        except (TypeError, ValueError):
            grid = np.empty(0)
        if grid.ndim != 1 or not grid.size:
            raise UsageError("omega must be a list of frequencies in rad/s.", value=omega)
        if not (np.all(grid > 0) and np.all(np.diff(grid) > 0)):
            raise UsageError("omega must be positive and increase, in rad/s.", value=omega)
        return cls(float(grid[0]), float(grid[-1]), grid)


def zoom_windows(scene: Scene, environments: Sequence[str]) -> Iterator[tuple[str, list[float]] | Skipped]:
    """Yield the window of omega, rad/s, that each environment's close view shows."""
    table, zoom = scene.frequency, scene.report.zoom
    for name in zoom:
        if name not in environments:
            yield Skipped(f"zoom window of {name}", "no environment has this name")
    usual = (table.read_at * (1 - _LOOK_BY), table.read_at * (1 + _LOOK_BY))
    for environment in environments:
        low, high = zoom.get(environment, usual)
        low, high = max(low, table.lower), min(high, table.upper)
        if low < high:
            yield environment, [float(low), float(high)]
        elif environment in zoom:
            outside = f"it lies outside {table.lower:g} to {table.upper:g} rad/s"
            yield Skipped(f"zoom window of {environment}", outside)


def boundaries_of(
    setup: Setup,
    environments: Collection[str],
    regions: Collection[Region],
    draws: Collection[Draws],
    frequencies: Range,
) -> tuple[Boundary, ...]:
    """Draw every boundary of the environments."""
    found: list[Boundary] = []
    for environment in environments:
        around = [region for region in regions if region.environment == environment]
        through = [drawn for drawn in draws if environment in drawn.pairs]
        found += _around(setup, environment, around, frequencies)
        found += _through(setup, environment, through, frequencies)
    return tuple(found)


def _around(
    setup: Setup, environment: str, regions: Sequence[Region], frequencies: Range
) -> Iterator[Boundary]:
    shapes: tuple[Shape, ...] = ("corner", "envelope")
    for region in regions:
        for shape in shapes if region.ellipse is None else shapes[1:]:
            outline = partial(setup.outline, region, shape)
            shared, (lower, upper) = _sampled(setup, environment, frequencies, outline, (True, True))
            yield Boundary(
                lower=lower, upper=upper, shape=shape, joint=region.joint, **_labels(region), **shared
            )


def _through(
    setup: Setup, environment: str, draws: Sequence[Draws], frequencies: Range
) -> Iterator[Boundary]:
    for drawn in draws:
        k, b = drawn.pairs[environment]
        ensemble = DrawCurves(setup.device, k, b, setup.period, level=drawn.level, hold=setup.hold)

        def curves(omega: Array, ensemble: DrawCurves = ensemble) -> list[Array]:
            bands = ensemble.at(omega)
            out = _PROXY * bands.sd
            proxies = np.exp(bands.mean - out), np.exp(bands.mean + out)
            return [bands.lower, bands.upper, *bands.error, *proxies]

        # Quantiles of draws are rough on a small scale: the points follow the band's smooth proxies.
        smooth = (False, False, False, False, True, True)
        shared, (lower, upper, *errors) = _sampled(setup, environment, frequencies, curves, smooth)
        error, largest = relative_error(shared["omega"], (lower, upper), np.array(errors[:2])) or (None, None)
        yield Boundary(
            lower=lower,
            upper=upper,
            shape="pointwise",
            joint="joint",
            error=error,
            largest_error=largest,
            **_labels(drawn),
            **shared,
        )


def _sampled(
    setup: Setup,
    environment: str,
    frequencies: Range,
    curves: Callable[[Array], Sequence[Array]],
    smooth: tuple[bool, ...],
) -> tuple[dict[str, Any], Array]:
    """Evaluate curves (rows `smooth` or not) where asked, or where they need it.

    The environment's own curves are followed beside them. Returns what the boundary shares with all others,
    and the curves.
    """

    def beside(omega: Array) -> Array:
        own = [setup.curve(environment, omega, coupled=coupled) for coupled in (False, True)]
        return np.stack([*own, *curves(omega)])

    if frequencies.omega is not None:
        grid = Grid(frequencies.omega, beside(frequencies.omega), np.nan)
    else:
        grid = adaptive_grid(
            beside,
            frequencies.lower,
            frequencies.upper,
            including=setup.resonances(environment),
            followed=np.array((True, True, *smooth)),
        )
    reference, coupled = grid.values[:2]
    shared = {
        "environment": environment,
        "omega": grid.omega,
        "reference": reference,
        "coupled": coupled if setup.coupling is not None else None,
        "departure": grid.departure if frequencies.omega is None else None,
    }
    return shared, grid.values[2:]


def _labels(source: Region | Draws) -> dict[str, Any]:
    return {name: getattr(source, name) for name in ("kind", "method", "family", "level")}


def compare_methods(boundaries: Collection[Boundary]) -> pd.DataFrame:
    """Compare classical with Bayesian boundaries that are alike in everything else."""
    classical, bayesian = (
        [one for one in boundaries if one.method == method] for method in ("classical", "bayesian")
    )
    return compare_curves(classical, bayesian, ("environment", "kind", "family", "joint", "shape"))


def compare_curves(
    first: Collection[Boundary], second: Collection[Boundary], labels: tuple[str, ...]
) -> pd.DataFrame:
    """Compare the boundaries of two collections that agree in all labels."""
    known = {tuple(getattr(b, name) for name in labels): b for b in second}
    rows = []
    for boundary in first:
        key = tuple(getattr(boundary, name) for name in labels)
        if key in known:
            row: dict[str, object] = dict(zip(labels, key, strict=True))
            for side, gap in curve_gap(boundary, known[key]).items():
                row |= {f"area_{side}": gap.area, f"largest_{side}": gap.largest, f"omega_{side}": gap.omega}
            rows.append(row)
    return pd.DataFrame(rows)
