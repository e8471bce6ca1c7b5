"""Boundaries of a study: curves around every region, and of every law, of (k, b), on one grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from percept.boundary.limits import (
    Magnitude,
    MagnitudeLimits,
    level_of,
    relative_error,
    score_of,
)
from percept.boundary.simultaneous import SimultaneousLevel, simultaneous_level
from percept.errors import RefusalError, UsageError
from percept.haptics.loop import log_grid
from percept.results import BandDifference, BandPair, Boundary, Shape, Skipped
from percept.scene import FrequencyTable, Scene
from percept.study.basics import Array
from percept.study.device import Setup
from percept.study.device_boundaries import DeviceCurves
from percept.study.regions import Law, Region, claim_fields

#: How k and b can be taken together: each by itself, both widened, one region, curves of their law.
JOINTS = ("marginal", "bonferroni", "hotelling", "joint")
_LAW_SHAPES: tuple[Shape, ...] = ("pointwise", "simultaneous")
# Curves are not drawn when their Monte Carlo error exceeds this many times the tolerance.
_MOST_TOLERANCES = 10.0
# Frequencies per decade: a line through them shows no corners on a page.
_PER_DECADE = 40
# Beside a resonance curves bend within a few per cent of its omega.
_BESIDE = 1.0 + np.array([-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04])


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
) -> Iterator[tuple[str, tuple[float, float]] | Skipped]:
    """Yield the windows of omega, rad/s, that the scene asks to look at closely."""
    table = scene.frequency
    for name, (low, high) in scene.report.zoom.items():
        what = f"zoom window of {name}"
        low = max(low, table.lower)
        high = min(high, table.upper)
        if name not in environments:
            yield Skipped(what, "no environment has this name")
        elif low < high:
            yield name, (float(low), float(high))
        else:
            yield Skipped(what, f"it lies outside {table.lower:g} to {table.upper:g} rad/s")


@dataclasses.dataclass(frozen=True, eq=False)
class _Frame:
    """What all curves of one environment share."""

    omega: Array  # (M,) rad/s
    reference: Array  # (M,) abs(Z_h) of the reference, N·s/m
    coupled: Array | None  # (M,) through the coupling, N·s/m


class _LawCurves:
    """Limits of abs(Z_h) of one law at frequencies (M,), rad/s.

    The level of a simultaneous band is that of the environment's own grid, `on_grid`; None there.
    Bayesian limits average over the device's posterior. A classical level counts repetitions of the
    study, and a posterior has none.
    """

    def __init__(
        self, setup: Setup, law: Law, omega: Array, on_grid: _LawCurves | None = None
    ) -> None:
        self.law = law
        self.omega = omega
        self._setup = setup
        self._on_grid = on_grid or self
        self._magnitude = self._new_magnitude()

    def _new_magnitude(self) -> Magnitude:
        mass = float(self._setup.references[self.law.environment].mass)
        return Magnitude(self.law.pair, self._setup.loop, self.omega, mass=mass)

    @cached_property
    def level(self) -> SimultaneousLevel:
        """Level of a simultaneous band, the device at its point."""
        if self._on_grid is not self:
            return self._on_grid.level
        return simultaneous_level(self._magnitude, self.law.level)

    @cached_property
    def _devices(self) -> DeviceCurves | None:
        if self._setup.draws is None or self.law.method == "classical":
            return None
        return DeviceCurves(self._setup, self.law, self.omega)

    @cached_property
    def widening(self) -> float:
        """By how many SDs the device's posterior moves the level of a band out."""
        if self._on_grid is not self:
            return self._on_grid.widening
        if self._devices is None:
            return 0.0
        least = score_of(self.law.level) - score_of(self.level.level)
        return max(self._devices.widening(self.law.level), least)

    @property
    def pointwise_level(self) -> float:
        """Level of a simultaneous band at single frequencies."""
        level = self.level.level
        return level_of(score_of(level) + self.widening) if self.widening else level

    @cached_property
    def pointwise(self) -> MagnitudeLimits:
        """Limits at single frequencies."""
        limits = self._magnitude.limits(self.law.level)
        if self._devices is None:
            return limits
        return self._devices.averaged(limits, score_of(self.law.level))

    @cached_property
    def simultaneous(self) -> MagnitudeLimits:
        """Limits between which whole curves lie; RefusalError where there are none."""
        law = self.law
        if law.method == "classical":
            # What holds (k, b) holds the whole curve. A calibrated level of the t law covers too
            # little: 87 % of users where 90 % is stated.
            if law.region is None:
                raise RefusalError("the subjects' values give no ellipse.")
            around = self._setup.outline(law.region, "envelope", self.omega)
            return self.pointwise.joined(MagnitudeLimits(*around))
        # The search for the level has solved for many scores, and interpolates between them. A
        # single one before would be too few.
        magnitude = self._magnitude if self._on_grid is self else self._new_magnitude()
        limits = magnitude.limits(self.level.level, self.level.shifts)
        if self._devices is None:
            return limits
        score = score_of(self.level.level)
        return self._devices.averaged(limits, score, self.widening).joined(self.pointwise)

    def finished(self) -> _LawCurves:
        """Work out both limits where there are any, and let go of what takes 30 MB."""
        with suppress(RefusalError):
            _ = self.pointwise, self.simultaneous
        vars(self).pop("_devices", None)
        return self

    def refusal(self, shape: Shape, most: float) -> str:
        """Say why curves are not drawn: no limits, or an error beyond `most`; empty if they are."""
        try:
            error = relative_error(self.omega, getattr(self, shape))
        except RefusalError as refused:
            return refused.message.removesuffix(".")
        if error is None or error <= most:
            return ""
        return (
            f"their Monte Carlo error is {error:.2g} of the half-width,"
            f" and curves are drawn up to {most:.2g}"
        )


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
        self._on_grid: dict[Law, _LawCurves] = {}

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
        found = []
        for law in self._laws:
            for shape in _LAW_SHAPES:
                reason = self._curves(law).refusal(shape, self._largest_error)
                if reason:
                    found.append(Skipped(_name(law, shape), reason))
        return found

    def grid(self, environment: str) -> Array:
        """Return the frequencies that all curves of an environment are drawn at, rad/s."""
        if environment not in self._grids:
            self._grids[environment] = self._new_grid(environment)
        return self._grids[environment]

    def _new_grid(self, environment: str) -> Array:
        lower = self._table.lower
        upper = self._table.upper
        if self._table.points:
            return np.geomspace(lower, upper, self._table.points)
        near = np.multiply.outer(self._setup.resonances(environment), _BESIDE)
        omega = log_grid((lower, upper), _PER_DECADE, near.ravel())
        # At a pole curves are infinite, and no line leads there.
        finite = np.isfinite(self._setup.curve(environment, omega, coupled=False))
        finite &= np.isfinite(self._setup.curve(environment, omega, coupled=True))
        return omega[finite]

    def _curves(self, law: Law) -> _LawCurves:
        """Return a law's curves on the grid of its environment."""
        if law not in self._on_grid:
            curves = _LawCurves(self._setup, law, self.grid(law.environment))
            self._on_grid[law] = curves.finished()
        return self._on_grid[law]

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
        curves = on_grid = self._curves(law)
        if frame.omega is not on_grid.omega:
            curves = _LawCurves(self._setup, law, frame.omega, on_grid)
        for shape in _LAW_SHAPES:
            if on_grid.refusal(shape, self._largest_error):
                continue
            boundary = _boundary(law, "joint", shape, getattr(curves, shape), frame)
            if shape == "simultaneous" and law.method == "bayesian":
                boundary = dataclasses.replace(
                    boundary,
                    pointwise_level=curves.pointwise_level,
                    pointwise_level_error=curves.level.error,
                )
            yield boundary


def _boundary(
    source: Region | Law, joint: str, shape: Shape, limits: MagnitudeLimits, frame: _Frame
) -> Boundary:
    """Put limits together with what they were drawn for."""
    return Boundary(
        **claim_fields(source),
        joint=joint,
        shape=shape,
        omega=frame.omega,
        lower=limits.lower,
        upper=limits.upper,
        reference=frame.reference,
        coupled=frame.coupled,
        errors=limits.errors,
        error=relative_error(frame.omega, limits),
        device_share=limits.device_share,
    )


def _name(law: Law, shape: Shape) -> str:
    """Name the curves of a law, as "Not computed" lists them."""
    if law.method == "bayesian":
        return f"{shape} Bayesian curves of {law.environment}, kind {law.kind}"
    return f"{shape} classical curves of {law.environment}, kind {law.kind}, {law.family}"


def _shapes(region: Region) -> tuple[Shape, ...]:
    """Return the curves that go around a region: an ellipse has no corners."""
    return ("corner", "envelope") if region.ellipse is None else ("envelope",)


def band_pairs(boundaries: Collection[Boundary]) -> Iterator[BandPair]:
    """Yield how the Bayesian envelopes differ from the classical ones.

    Bands without width, and infinite ones, are left out.
    """
    classical: dict[tuple[str, str, str], Boundary] = {}
    for boundary in boundaries:
        if boundary.shape != "envelope" or boundary.joint != "marginal":
            continue
        key = boundary.environment, boundary.kind, boundary.family
        if boundary.method == "classical":
            classical[key] = boundary
        elif key in classical and _has_width(boundary) and _has_width(classical[key]):
            other = classical[key]
            middles = (boundary.lower + boundary.upper) / (other.lower + other.upper)
            yield BandPair(
                environment=boundary.environment,
                kind=boundary.kind,
                family=boundary.family,
                place=_difference(boundary.omega, middles - 1.0),
                width=_difference(boundary.omega, np.log(boundary.band / other.band)),
            )


def _has_width(boundary: Boundary) -> bool:
    limits = np.array([boundary.lower, boundary.upper])
    return bool(np.isfinite(limits).all() and np.all(limits[1] > limits[0]))


def _difference(omega: Array, values: Array) -> BandDifference:
    """Read how a measure of two bands goes over omega."""
    index = int(np.argmax(np.abs(values)))
    # The median is over log omega: grids are dense where curves bend.
    order = np.argsort(values)
    lengths = np.gradient(np.log(omega))[order]
    below = np.cumsum(lengths) - 0.5 * lengths
    median = float(np.interp(0.5 * lengths.sum(), below, values[order]))
    return BandDifference(float(values[index]), float(omega[index]), median)
