"""Boundaries of a study: curves around every region of (k, b), and of every law of (k, b), on one grid."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from percept.boundary.curves import Boundary, Shape, drawing_grid
from percept.boundary.limits import Calibration, Limits, Magnitude, relative_error
from percept.errors import UsageError
from percept.scene import FrequencyTable, Scene
from percept.study.basics import Array, Skipped
from percept.study.device import Setup
from percept.study.regions import Law, Region

#: How k and b can be taken together: each by itself, both widened, one region, curves of their law.
JOINTS = ("marginal", "bonferroni", "hotelling", "joint")


def increasing(omega: ArrayLike) -> Array:
    """Take frequencies (M,) as they are, rad/s; UsageError unless they are positive and increase."""
    try:
        grid = np.asarray(omega, dtype=np.float64)
    except (TypeError, ValueError):
        grid = np.empty(0)
    if grid.ndim != 1 or not grid.size:
        raise UsageError("omega must be a list of frequencies in rad/s.", value=omega)
    if not (np.all(grid > 0) and np.all(np.diff(grid) > 0)):
        raise UsageError("omega must be positive and increase, in rad/s.", value=omega)
    return grid


def zoom_windows(
    scene: Scene, environments: Sequence[str]
) -> Iterator[tuple[str, list[float]] | Skipped]:
    """Yield the windows of omega, rad/s, that the scene asks to look at closely."""
    table = scene.frequency
    for name, (low, high) in scene.report.zoom.items():
        low, high = max(low, table.lower), min(high, table.upper)
        if name not in environments:
            yield Skipped(f"zoom window of {name}", "no environment has this name")
        elif low < high:
            yield name, [float(low), float(high)]
        else:
            outside = f"it lies outside {table.lower:g} to {table.upper:g} rad/s"
            yield Skipped(f"zoom window of {name}", outside)


class Drawing:
    """Boundaries of environments over a range, each environment's on one grid of its own."""

    def __init__(
        self,
        setup: Setup,
        regions: Collection[Region],
        laws: Collection[Law],
        table: FrequencyTable,
    ) -> None:
        self._setup, self._regions, self._laws, self._table = setup, regions, laws, table
        self._grids: dict[str, Array] = {}
        self._calibrated: dict[Law, Calibration] = {}

    def at(
        self,
        omega: Array | None,
        environments: Collection[str],
        kinds: Collection[str],
        joints: Collection[str] = JOINTS,
    ) -> tuple[Boundary, ...]:
        """Draw boundaries at frequencies asked for, rad/s, or on the environments' grids."""
        found: list[Boundary] = []
        for environment in environments:
            grid = self.grid(environment) if omega is None else omega
            reference, coupled = (
                self._setup.curve(environment, grid, coupled=c) for c in (False, True)
            )
            shared: dict[str, Any] = {"omega": grid, "reference": reference}
            shared["coupled"] = coupled if self._setup.coupling is not None else None
            for region in self._regions:
                if (
                    region.environment == environment
                    and region.kind in kinds
                    and region.joint in joints
                ):
                    found += self._around(region, shared)
            for law in self._laws:
                if law.environment == environment and law.kind in kinds and "joint" in joints:
                    found += self._of_law(law, shared)
        return tuple(found)

    def grid(self, environment: str) -> Array:
        """Return the frequencies that all curves of an environment are drawn at, rad/s."""
        if environment in self._grids:
            return self._grids[environment]
        table, regions = (
            self._table,
            [one for one in self._regions if one.environment == environment],
        )

        def curves(omega: Array) -> tuple[Array, Array]:
            own = [
                self._setup.curve(environment, omega, coupled=coupled) for coupled in (False, True)
            ]
            limits = [
                self._setup.outline(region, shape, omega)
                for region in regions
                for shape in _shapes(region)
            ]
            return np.stack(own), np.array(limits).reshape(-1, 2, omega.size)

        if table.points:
            grid = np.geomspace(table.lower, table.upper, table.points)
        else:
            grid = drawing_grid(
                curves, table.lower, table.upper, self._setup.resonances(environment)
            )
        self._grids[environment] = grid
        return grid

    def _around(self, region: Region, shared: dict[str, Any]) -> Iterator[Boundary]:
        for shape in _shapes(region):
            lower, upper = self._setup.outline(region, shape, shared["omega"])
            yield Boundary(
                lower=lower,
                upper=upper,
                shape=shape,
                joint=region.joint,
                **(shared | region.labels),
            )

    def _of_law(self, law: Law, shared: dict[str, Any]) -> Iterator[Boundary]:
        """Yield the limits at each omega for itself, and those between which whole curves lie."""
        magnitude = self._magnitude(law, shared["omega"])
        limits = magnitude.limits(law.level)
        yield self._limits(law, "pointwise", limits, shared)
        if law.method == "classical":
            # What holds (k, b) holds the whole curve. A calibrated level of the t law covers too
            # little: 87 % of users where 90 % is stated.
            if (region := law.region) is not None:
                lower, upper = self._setup.outline(region, "envelope", shared["omega"])
                ends = np.minimum(lower, limits.lower), np.maximum(upper, limits.upper)
                yield self._limits(law, "simultaneous", Limits(*ends, None), shared)
            return
        if law not in self._calibrated:
            grid = self.grid(law.environment)
            drawn = magnitude if shared["omega"] is grid else self._magnitude(law, grid)
            self._calibrated[law] = drawn.calibrate(law.level)
        held = self._calibrated[law]
        together = magnitude.limits(held.level, held.shifts)
        own = {"pointwise_level": held.level, "pointwise_level_error": held.error}
        yield self._limits(law, "simultaneous", together, shared | own)

    def _magnitude(self, law: Law, omega: Array) -> Magnitude:
        setup = self._setup
        mass = float(setup.references[law.environment].mass)
        return Magnitude(law.pair, setup.device, setup.period, omega, mass=mass, hold=setup.hold)

    def _limits(self, law: Law, shape: Shape, limits: Limits, shared: dict[str, Any]) -> Boundary:
        return Boundary(
            lower=limits.lower, upper=limits.upper, errors=limits.errors,
            error=relative_error(shared["omega"], limits),
            shape=shape, joint="joint", **(shared | law.labels),
        )  # fmt: skip


def _shapes(region: Region) -> tuple[Shape, ...]:
    """Say which curves go around a region: an ellipse has no corners."""
    return ("corner", "envelope") if region.ellipse is None else ("envelope",)
