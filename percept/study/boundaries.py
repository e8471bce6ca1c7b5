"""Boundaries of a study: curves around every region of (k, b), and through draws of (k, b)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept import haptics
from percept.boundary.curves import TOLERANCE, Grid, adaptive_grids
from percept.boundary.draws import DrawCurves, relative_error
from percept.boundary.records import Boundary, Shape
from percept.errors import UsageError
from percept.haptics import AnyDevice
from percept.study.apparatus import Apparatus
from percept.study.regions import Draws, Region

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
#: How k and b can be taken together: each by itself, both widened, one region, curves through draws.
JOINTS = ("marginal", "bonferroni", "hotelling", "joint")
# The proxies that a band through draws is followed by lie this many SDs out: about its usual reach.
_PROXY = 3.0
_BOXES = {"corner": haptics.corner_curves, "envelope": haptics.magnitude_envelope}
# Stands where an ellipse has no limits of k and b; nothing is drawn from it.
_NO_LIMITS = ((np.nan, np.nan), (np.nan, np.nan))


@dataclasses.dataclass(frozen=True)
class Range:
    """Frequencies of curves: a grid as asked, or as many as the curves need."""

    lower: float  # rad/s
    upper: float  # rad/s
    omega: Array | None = None  # The grid asked for
    tolerance: float = TOLERANCE

    @classmethod
    def of(cls, omega: ArrayLike) -> Self:
        """Take a grid (M,) as it is, rad/s; UsageError unless it is positive and increases."""
        try:
            grid = np.asarray(omega, dtype=np.float64)
        except (TypeError, ValueError):
            raise UsageError("omega must be a list of frequencies in rad/s.", value=omega) from None
        if grid.ndim != 1 or not grid.size:
            raise UsageError("omega must be a list of frequencies in rad/s.", value=omega)
        if not (np.all(grid > 0) and np.all(np.diff(grid) > 0)):
            raise UsageError("omega must be positive and increase, in rad/s.", value=omega)
        return cls(float(grid[0]), float(grid[-1]), grid)


def environment_boundaries(
    apparatus: Apparatus, environment: str, regions: list[Region], draws: list[Draws], frequencies: Range
) -> list[Boundary]:
    """Draw every boundary of one environment."""
    place = _Place(apparatus, environment, frequencies)
    through = [drawn for drawn in draws if environment in drawn.pairs]
    return [*_around(place, regions), *_through(place, through)]


def region_curves(
    region: Region, shape: Shape, omega: Array, device: AnyDevice, period: float, *, hold: str
) -> tuple[Array, Array]:
    """Lower and upper curve around a region."""
    if region.ellipse is not None:
        ellipse = region.ellipse
        log = ellipse.family == "lognormal"
        envelope = haptics.magnitude_envelope_log_ellipse if log else haptics.magnitude_envelope_ellipse
        centre = (float(ellipse.centre[0]), float(ellipse.centre[1]))
        return envelope(omega, device, centre, ellipse.shape, ellipse.radius, period, hold=hold)
    assert region.limits is not None
    return _BOXES[shape](omega, device, *region.limits, period, hold=hold)


def boundaries_of(
    apparatus: Apparatus,
    environments: Collection[str],
    regions: Collection[Region],
    draws: Collection[Draws],
    frequencies: Range,
) -> tuple[Boundary, ...]:
    """Draw the boundaries of several environments."""
    found: list[Boundary] = []
    for environment in environments:
        around = [region for region in regions if region.environment == environment]
        through = [drawn for drawn in draws if environment in drawn.pairs]
        found += environment_boundaries(apparatus, environment, around, through, frequencies)
    return tuple(found)


@dataclasses.dataclass(frozen=True)
class _Place:
    """One environment on an apparatus: its own curves are followed beside every boundary's."""

    apparatus: Apparatus
    environment: str
    frequencies: Range

    def sampled(
        self, curves: Callable[[Indices, Array], Array], count: int, smooth: tuple[bool, ...]
    ) -> Iterator[tuple[dict[str, Any], Array]]:
        """Evaluate `count` sets of curves (rows `smooth` or not) where asked, or where they need it.

        Yields of each set what all boundaries share, and its curves.
        """
        apparatus, wanted = self.apparatus, self.frequencies

        def stacked(which: Indices, omega: Array) -> Array:
            own = [apparatus.curve(self.environment, omega, coupled=coupled) for coupled in (False, True)]
            return np.concatenate([own, curves(which, omega)])

        if not count:
            return
        if wanted.omega is not None:
            which = np.repeat(np.arange(count), wanted.omega.size)
            values = stacked(which, np.tile(wanted.omega, count))
            grids = [Grid(wanted.omega, part, np.nan) for part in np.split(values, count, axis=1)]
        else:
            grids = adaptive_grids(
                stacked,
                count,
                wanted.lower,
                wanted.upper,
                tolerance=wanted.tolerance,
                including=apparatus.resonances(self.environment),
                followed=np.array((True, True, *smooth)),
            )
        for grid in grids:
            reference, coupled = grid.values[:2]
            shared = {
                "environment": self.environment,
                "omega": grid.omega,
                "reference": reference,
                "coupled": coupled if apparatus.coupling is not None else None,
                "departure": grid.departure if wanted.omega is None else None,
            }
            yield shared, grid.values[2:]


def _around(place: _Place, regions: list[Region]) -> Iterator[Boundary]:
    outlines: list[tuple[Region, Shape]] = []
    for region in regions:
        if region.ellipse is None:
            outlines.append((region, "corner"))
        outlines.append((region, "envelope"))
    drawn = place.sampled(_Outlines(place.apparatus, outlines).at, len(outlines), (True, True))
    for (region, shape), (shared, (lower, upper)) in zip(outlines, drawn, strict=True):
        yield Boundary(
            lower=lower,
            upper=upper,
            shape=shape,
            kind=region.kind,
            method=region.method,
            family=region.family,
            joint=region.joint,
            level=region.level,
            **shared,
        )


class _Outlines:
    """Lower and upper curves around several regions: all rectangles of one shape are drawn at once."""

    def __init__(self, apparatus: Apparatus, outlines: list[tuple[Region, Shape]]) -> None:
        self._apparatus, self._outlines = apparatus, outlines
        self._boxes = {
            shape: np.array([one is shape and region.ellipse is None for region, one in outlines])
            for shape in _BOXES
        }
        self._limits = np.array([region.limits or _NO_LIMITS for region, _ in outlines], dtype=float)

    def at(self, which: Indices, omega: Array) -> Array:
        """Evaluate the outlines `which` (M,) at frequencies (M,), rad/s, each; shape (2, M), N·s/m."""
        apparatus = self._apparatus
        curves = np.empty((2, omega.size))
        for shape, around in _BOXES.items():
            here = np.flatnonzero(self._boxes[shape][which])
            if here.size:
                stiffness, damping = np.moveaxis(self._limits[which[here]], 0, -1)
                limits = tuple(stiffness), tuple(damping)
                curves[:, here] = around(
                    omega[here], apparatus.device, *limits, apparatus.period, hold=apparatus.hold
                )
        for one, part in _runs(which):
            region, shape = self._outlines[one]
            if region.ellipse is not None:
                curves[:, part] = region_curves(
                    region, shape, omega[part], apparatus.device, apparatus.period, hold=apparatus.hold
                )
        return curves


def _runs(which: Indices) -> Iterator[tuple[int, slice]]:
    """Yield every value of an increasing sequence, and where it stands."""
    ends = [*np.flatnonzero(np.diff(which)) + 1, which.size]
    for start, end in zip([0, *ends], ends, strict=False):
        yield int(which[start]), slice(start, end)


def _through(place: _Place, draws: list[Draws]) -> Iterator[Boundary]:
    apparatus = place.apparatus
    ensembles = [
        DrawCurves(
            apparatus.device,
            *one.pairs[place.environment],
            apparatus.period,
            level=one.level,
            hold=apparatus.hold,
        )
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
    sampled = place.sampled(curves, len(draws), (False, False, False, False, True, True))
    for drawn, (shared, (lower, upper, *errors)) in zip(draws, sampled, strict=True):
        error = relative_error(shared["omega"], (lower, upper), np.array(errors[:2]))
        yield Boundary(
            lower=lower,
            upper=upper,
            shape="pointwise",
            kind=drawn.kind,
            method=drawn.method,
            family=drawn.family,
            joint="joint",
            level=drawn.level,
            error=error[0] if error else None,
            largest_error=error[1] if error else None,
            **shared,
        )
