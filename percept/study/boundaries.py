"""Boundaries of a study: curves around every region, and of every law, of (k, b), on one grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from percept.boundary.curves import drawing_grid
from percept.boundary.limits import Magnitude, MagnitudeLimits, relative_error
from percept.boundary.simultaneous import SimultaneousLevel, simultaneous_level
from percept.errors import RefusalError, UsageError
from percept.results import BandDifference, BandPair, Boundary, Shape
from percept.scene import FrequencyTable, Scene
from percept.study.basics import Array, Skipped
from percept.study.device import Setup
from percept.study.regions import Law, Region

__all__ = [
    "JOINTS", "BoundaryDrawing", "LimitErrors", "compare_bands", "increasing", "zoom_windows",
]  # fmt: skip

#: How k and b can be taken together: each by itself, both widened, one region, curves of their law.
JOINTS = ("marginal", "bonferroni", "hotelling", "joint")
_LAW_SHAPES: tuple[Shape, ...] = ("pointwise", "simultaneous")
# Curves are not drawn when their Monte Carlo error exceeds this many times the tolerance.
_MOST_TOLERANCES = 10.0


def increasing(omega: ArrayLike) -> Array:
    """Return frequencies (M,), rad/s, as an array; UsageError unless positive and increasing."""
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
        what = f"zoom window of {name}"
        low = max(low, table.lower)
        high = min(high, table.upper)
        if name not in environments:
            yield Skipped(what, "no environment has this name")
        elif low < high:
            yield name, [float(low), float(high)]
        else:
            yield Skipped(what, f"it lies outside {table.lower:g} to {table.upper:g} rad/s")


@dataclasses.dataclass(frozen=True, eq=False)
class _Frame:
    """What all curves of one environment share."""

    omega: Array  # (M,) rad/s
    reference: Array  # (M,) abs(Z_h) of the reference, N·s/m
    coupled: Array | None  # (M,) through the coupling, N·s/m


class BoundaryDrawing:
    """Boundaries of environments over a range, each environment's on one grid of its own.

    Parameters
    ----------
    setup : Setup
        Device, coupling and references.
    regions : collection of Region
        What corner curves and envelopes go around.
    laws : collection of Law
        What pointwise and simultaneous limits come from.
    table : FrequencyTable
        The scene's range of omega.
    tolerance : float
        Monte Carlo error that the scene asks for, as a fraction of a half-width.
    """

    def __init__(
        self,
        setup: Setup,
        regions: Collection[Region],
        laws: Collection[Law],
        table: FrequencyTable,
        tolerance: float,
    ) -> None:
        self._setup = setup
        self._regions = regions
        self._laws = laws
        self._table = table
        self._largest_error = _MOST_TOLERANCES * tolerance
        self._grids: dict[str, Array] = {}
        self._on_grid: dict[Law, Magnitude] = {}
        self._levels: dict[Law, SimultaneousLevel] = {}
        self._refused: dict[Law, dict[Shape, Skipped]] = {}

    def at(
        self,
        omega: Array | None,
        environments: Collection[str],
        kinds: Collection[str],
        joints: Collection[str] = JOINTS,
    ) -> tuple[Boundary, ...]:
        """Draw boundaries at frequencies (M,), rad/s, or on the environments' own grids."""
        boundaries: list[Boundary] = []
        for environment in environments:
            frame = self._frame(environment, omega)
            for region in self._regions:
                chosen = region.kind in kinds and region.joint in joints
                if region.environment == environment and chosen:
                    boundaries += self._around(region, frame)
            for law in self._laws:
                chosen = law.kind in kinds and "joint" in joints
                if law.environment == environment and chosen:
                    boundaries += self._of_law(law, frame)
        return tuple(boundaries)

    @property
    def skipped(self) -> list[Skipped]:
        """Curves of laws that are not drawn, and why."""
        return [skipped for law in self._laws for skipped in self._refusals(law).values()]

    def grid(self, environment: str) -> Array:
        """Return the frequencies that all curves of an environment are drawn at, rad/s."""
        if environment not in self._grids:
            self._grids[environment] = self._new_grid(environment)
        return self._grids[environment]

    def envelope(self, region: Region) -> Array:
        """Return the lower and upper curve (2, M) around a region, N·s/m, on its grid."""
        omega = self.grid(region.environment)
        return np.array(self._setup.outline(region, "envelope", omega))

    def _new_grid(self, environment: str) -> Array:
        lower = self._table.lower
        upper = self._table.upper
        if self._table.points:
            return np.geomspace(lower, upper, self._table.points)
        regions = [region for region in self._regions if region.environment == environment]

        def curves(omega: Array) -> tuple[Array, Array]:
            direct = self._setup.curve(environment, omega, coupled=False)
            coupled = self._setup.curve(environment, omega, coupled=True)
            limits = []
            for region in regions:
                for shape in _shapes(region):
                    limits.append(self._setup.outline(region, shape, omega))
            return np.stack([direct, coupled]), np.array(limits).reshape(-1, 2, omega.size)

        return drawing_grid(curves, lower, upper, self._setup.resonances(environment))

    def _frame(self, environment: str, omega: Array | None) -> _Frame:
        grid = self.grid(environment) if omega is None else omega
        reference = self._setup.curve(environment, grid, coupled=False)
        coupled = None
        if self._setup.coupling is not None:
            coupled = self._setup.curve(environment, grid, coupled=True)
        return _Frame(grid, reference, coupled)

    def _around(self, region: Region, frame: _Frame) -> Iterator[Boundary]:
        for shape in _shapes(region):
            limits = MagnitudeLimits(*self._setup.outline(region, shape, frame.omega), None)
            yield _boundary(region, region.joint, shape, limits, frame)

    def _of_law(self, law: Law, frame: _Frame) -> Iterator[Boundary]:
        """Yield the limits at single frequencies, and those between which whole curves lie."""
        for shape in _LAW_SHAPES:
            if shape in self._refusals(law):
                continue
            limits = self._limits(law, shape, frame.omega)
            boundary = _boundary(law, "joint", shape, limits, frame)
            if shape == "simultaneous" and law.method == "bayesian":
                level = self._level(law)
                boundary = dataclasses.replace(
                    boundary, pointwise_level=level.level, pointwise_level_error=level.error
                )
            yield boundary

    def _refusals(self, law: Law) -> dict[Shape, Skipped]:
        """Return why shapes of a law's curves are not drawn, judged on the environment's grid."""
        if law not in self._refused:
            refused: dict[Shape, Skipped] = {}
            for shape in _LAW_SHAPES:
                reason = self._refusal(law, shape)
                if reason:
                    refused[shape] = Skipped(_name(law, shape), reason)
            self._refused[law] = refused
        return self._refused[law]

    def _refusal(self, law: Law, shape: Shape) -> str:
        omega = self.grid(law.environment)
        try:
            limits = self._limits(law, shape, omega)
        except RefusalError as refused:
            return refused.message.removesuffix(".")
        error = relative_error(omega, limits)
        if error is None or error <= self._largest_error:
            return ""
        return (
            f"their Monte Carlo error is {error:.2g} of the half-width,"
            f" and curves are drawn up to {self._largest_error:.2g}"
        )

    def _limits(self, law: Law, shape: Shape, omega: Array) -> MagnitudeLimits:
        """Return the limits (M,) of a law in a shape; RefusalError where there are none."""
        magnitude = self._magnitude(law, omega)
        if shape == "pointwise":
            return magnitude.limits(law.level)
        if law.method == "bayesian":
            level = self._level(law)
            return magnitude.limits(level.level, level.shifts)
        # What holds (k, b) holds the whole curve. A calibrated level of the t law covers too
        # little: 87 % of users where 90 % is stated.
        region = law.region
        if region is None:
            raise RefusalError("the subjects' values give no ellipse.")
        lower, upper = self._setup.outline(region, "envelope", omega)
        limits = magnitude.limits(law.level)
        return MagnitudeLimits(
            np.minimum(lower, limits.lower), np.maximum(upper, limits.upper), None
        )

    def _level(self, law: Law) -> SimultaneousLevel:
        """Return the level of a simultaneous band over the environment's grid."""
        if law not in self._levels:
            magnitude = self._magnitude(law, self.grid(law.environment))
            self._levels[law] = simultaneous_level(magnitude, law.level)
        return self._levels[law]

    def _magnitude(self, law: Law, omega: Array) -> Magnitude:
        if omega is self.grid(law.environment):
            if law not in self._on_grid:
                self._on_grid[law] = self._new_magnitude(law, omega)
            return self._on_grid[law]
        return self._new_magnitude(law, omega)

    def _new_magnitude(self, law: Law, omega: Array) -> Magnitude:
        setup = self._setup
        mass = float(setup.references[law.environment].mass)
        return Magnitude(law.pair, setup.device, setup.period, omega, mass=mass, hold=setup.hold)


@dataclasses.dataclass(frozen=True)
class LimitErrors:
    """Monte Carlo standard errors of an interval."""

    centre: float  # In the unit of the limits
    half_width: float


def compare_bands(
    drawing: BoundaryDrawing,
    regions: Collection[Region],
    errors: Mapping[tuple[str, str, str], LimitErrors],
) -> Iterator[BandPair]:
    """Yield how the Bayesian envelope of abs(Z_h) differs from the classical one.

    `errors` come from the Bayesian intervals, by environment, parameter and kind. Bands without
    width, and infinite ones, are left out.
    """
    classical = {
        (region.environment, region.kind, region.family): region
        for region in regions
        if region.method == "classical" and region.joint == "marginal"
    }
    for region in regions:
        if region.method != "bayesian" or region.joint != "marginal":
            continue
        key = region.environment, region.kind, region.family
        other = classical.get(key)
        if other is None:
            continue
        old = drawing.envelope(other)
        new = drawing.envelope(region)
        if not (_has_width(old) and _has_width(new)):
            continue
        omega = drawing.grid(region.environment)
        moved = [drawing.envelope(part) for part in _moved(region, errors)]
        place = _difference(omega, _place, old, new, moved)
        width = _difference(omega, _log_width, old, new, moved)
        yield BandPair(
            environment=region.environment,
            kind=region.kind,
            family=region.family,
            place=place,
            width=width,
        )


def _has_width(band: Array) -> bool:
    return bool(np.isfinite(band).all() and np.all(band[1] > band[0]))


def _place(old: Array, new: Array) -> Array:
    """Return how far the middle of a band (2, M) lies from that of another, as a fraction."""
    return np.asarray(new.sum(axis=0) / old.sum(axis=0) - 1.0)


def _log_width(old: Array, new: Array) -> Array:
    """Return the logarithm of the ratio of widths of bands (2, M)."""
    return np.asarray(np.log((new[1] - new[0]) / (old[1] - old[0])))


def _moved(region: Region, errors: Mapping[tuple[str, str, str], LimitErrors]) -> Iterator[Region]:
    """Move each limit's centre, and widen it, by one standard error."""
    assert region.limits is not None
    for quantity, parameter in enumerate(("k", "b")):
        error = errors.get((region.environment, parameter, region.kind))
        if error is None:
            continue
        lower, upper = region.limits[quantity]
        sides = list(region.limits)
        sides[quantity] = (lower + error.centre, upper + error.centre)
        yield dataclasses.replace(region, limits=(sides[0], sides[1]))
        sides[quantity] = (lower - error.half_width, upper + error.half_width)
        yield dataclasses.replace(region, limits=(sides[0], sides[1]))


def _difference(
    omega: Array,
    measure: Callable[[Array, Array], Array],
    old: Array,
    new: Array,
    moved: Sequence[Array],
) -> BandDifference:
    """Measure two bands (2, M); `moved` are the new one with its limits off by standard errors."""
    values = measure(old, new)
    index = int(np.argmax(np.abs(values)))
    median = _median(omega, values)
    at_largest = [measure(old, band)[index] - values[index] for band in moved]
    at_median = [_median(omega, measure(old, band)) - median for band in moved]
    return BandDifference(
        largest=float(values[index]),
        omega=float(omega[index]),
        error=float(np.linalg.norm(at_largest)),
        median=median,
        median_error=float(np.linalg.norm(at_median)),
    )


def _median(omega: Array, values: Array) -> float:
    """Return the median over log omega: grids are dense where curves bend."""
    order = np.argsort(values)
    lengths = np.gradient(np.log(omega))[order]
    below = np.cumsum(lengths) - 0.5 * lengths
    return float(np.interp(0.5 * lengths.sum(), below, values[order]))


def _boundary(
    source: Region | Law, joint: str, shape: Shape, limits: MagnitudeLimits, frame: _Frame
) -> Boundary:
    """Put limits together with what they were drawn for."""
    return Boundary(
        environment=source.environment,
        kind=source.kind,
        method=source.method,
        family=source.family,
        joint=joint,
        shape=shape,
        level=source.level,
        omega=frame.omega,
        lower=limits.lower,
        upper=limits.upper,
        reference=frame.reference,
        coupled=frame.coupled,
        errors=limits.errors,
        error=relative_error(frame.omega, limits),
    )


def _name(law: Law, shape: Shape) -> str:
    """Name the curves of a law, as "Not computed" lists them."""
    if law.method == "bayesian":
        return f"{shape} Bayesian curves of {law.environment}, kind {law.kind}"
    return f"{shape} classical curves of {law.environment}, kind {law.kind}, {law.family}"


def _shapes(region: Region) -> tuple[Shape, ...]:
    """Return the curves that go around a region: an ellipse has no corners."""
    return ("corner", "envelope") if region.ellipse is None else ("envelope",)
