"""Boundaries of a study: curves around every region of (k, b), and through draws of (k, b)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from percept.boundary.curves import Grid, adaptive_grids, curve_gap
from percept.boundary.draws import DrawCurves, relative_error
from percept.boundary.records import Boundary, Shape
from percept.errors import UsageError
from percept.scene import Scene
from percept.study.basics import Array, Skipped
from percept.study.device import BOXES, Setup
from percept.study.regions import Draws, Region

Indices = NDArray[np.intp]
#: How k and b can be taken together: each by itself, both widened, one region, curves through draws.
JOINTS = ("marginal", "bonferroni", "hotelling", "joint")
# The proxies that a band through draws is followed by lie this many SDs out: about its usual half-width.
_PROXY = 3.0
# Stands where an ellipse has no limits of k and b; nothing is drawn from it.
_NO_LIMITS = ((np.nan, np.nan), (np.nan, np.nan))
# A close view shows this part of the frequency on either side: how closely the paper looks.
_LOOK_BY = 0.02


@dataclasses.dataclass(frozen=True)
class Range:
    """Frequencies of curves: a grid as asked, or as many as the curves need."""

    lower: float  # rad/s
    upper: float  # rad/s
    omega: Array | None = None  # The grid asked for, rad/s

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
    outlines: list[tuple[Region, Shape]] = []
    for region in regions:
        if region.ellipse is None:
            outlines.append((region, "corner"))
        outlines.append((region, "envelope"))
    boxes = {
        shape: np.array([one is shape and region.ellipse is None for region, one in outlines])
        for shape in BOXES
    }
    limits = np.array([region.limits or _NO_LIMITS for region, _ in outlines], dtype=float)

    def curves(which: Indices, omega: Array) -> Array:
        """Lower and upper curve (2, M) of the outlines `which` (M,): all rectangles of a shape at once."""
        values = np.empty((2, omega.size))
        for shape, box in BOXES.items():
            here = np.flatnonzero(boxes[shape][which])
            if here.size:
                stiffness, damping = (tuple(pair) for pair in np.moveaxis(limits[which[here]], 0, -1))
                values[:, here] = box(
                    omega[here], setup.device, stiffness, damping, setup.period, hold=setup.hold
                )
        for one, part in _runs(which):
            region, shape = outlines[one]
            if region.ellipse is not None:
                values[:, part] = setup.outline(region, shape, omega[part])
        return values

    drawn = _sampled(setup, environment, frequencies, curves, len(outlines), (True, True))
    for (region, shape), (shared, (lower, upper)) in zip(outlines, drawn, strict=True):
        yield Boundary(lower=lower, upper=upper, shape=shape, joint=region.joint, **_labels(region), **shared)


def _through(
    setup: Setup, environment: str, draws: Sequence[Draws], frequencies: Range
) -> Iterator[Boundary]:
    ensembles = [
        DrawCurves(setup.device, *one.pairs[environment], setup.period, level=one.level, hold=setup.hold)
        for one in draws
    ]

    def curves(which: Indices, omega: Array) -> Array:
        parts = []
        for one, part in _runs(which):
            bands = ensembles[one].at(omega[part])
            out = _PROXY * bands.sd
            proxies = np.exp(bands.mean - out), np.exp(bands.mean + out)
            parts.append([bands.lower, bands.upper, *bands.error, *proxies])
        return np.concatenate(parts, axis=1)

    # Quantiles of draws are rough on a small scale: the points follow the band's smooth proxies.
    smooth = (False, False, False, False, True, True)
    sampled = _sampled(setup, environment, frequencies, curves, len(draws), smooth)
    for drawn, (shared, (lower, upper, *errors)) in zip(draws, sampled, strict=True):
        error = relative_error(shared["omega"], (lower, upper), np.array(errors[:2]))
        yield Boundary(
            lower=lower,
            upper=upper,
            shape="pointwise",
            joint="joint",
            error=error[0] if error else None,
            largest_error=error[1] if error else None,
            **_labels(drawn),
            **shared,
        )


def _sampled(
    setup: Setup,
    environment: str,
    frequencies: Range,
    curves: Callable[[Indices, Array], Array],
    count: int,
    smooth: tuple[bool, ...],
) -> Iterator[tuple[dict[str, Any], Array]]:
    """Evaluate `count` sets of curves (rows `smooth` or not) where asked, or where they need it.

    The environment's own curves are followed beside every set. Yields of each set what its boundary shares
    with all others, and its curves.
    """

    def stacked(which: Indices, omega: Array) -> Array:
        own = [setup.curve(environment, omega, coupled=coupled) for coupled in (False, True)]
        return np.concatenate([own, curves(which, omega)])

    if not count:
        return
    if frequencies.omega is not None:
        omega = frequencies.omega
        values = stacked(np.repeat(np.arange(count), omega.size), np.tile(omega, count))
        grids = [Grid(omega, part, np.nan) for part in np.split(values, count, axis=1)]
    else:
        grids = adaptive_grids(
            stacked,
            count,
            frequencies.lower,
            frequencies.upper,
            including=setup.resonances(environment),
            followed=np.array((True, True, *smooth)),
        )
    for grid in grids:
        reference, coupled = grid.values[:2]
        shared = {
            "environment": environment,
            "omega": grid.omega,
            "reference": reference,
            "coupled": coupled if setup.coupling is not None else None,
            "departure": grid.departure if frequencies.omega is None else None,
        }
        yield shared, grid.values[2:]


def _labels(source: Region | Draws) -> dict[str, Any]:
    return {name: getattr(source, name) for name in ("kind", "method", "family", "level")}


def _runs(which: Indices) -> Iterator[tuple[int, slice]]:
    """Yield every value of an increasing sequence, and where it stands."""
    ends = [*np.flatnonzero(np.diff(which)) + 1, which.size]
    for start, end in zip([0, *ends], ends, strict=False):
        yield int(which[start]), slice(start, end)


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
