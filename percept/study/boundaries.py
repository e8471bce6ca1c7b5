"""Boundaries of a study: curves around every region of (k, b), and through draws of (k, b)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept import haptics
from percept.boundary.draws import DrawBands, DrawCurves
from percept.boundary.grid import TOLERANCE, Grid, adaptive_grid
from percept.boundary.records import Boundary, Shape
from percept.haptics import AnyDevice, Coupling, Environment
from percept.study.regions import Draws, Region

__all__ = ["Bench", "Range", "environment_boundaries", "region_curves"]

Array = NDArray[np.float64]
# The proxies that a band through draws is followed by lie this many SDs out: about its usual reach.
_PROXY = 3.0
# Rows of a measured device that a grid starts from, at most twice as many.
_MOST_ROWS = 128


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """Device, period and references that curves are drawn for.

    Attributes
    ----------
    device : Device or TabulatedDevice
        The device.
    period : float
        Sampling period, s.
    hold : str
        "average" (Eq. 8) or "true".
    references : dict of str to Environment
        Reference environments by name.
    coupling : Coupling or None
        The virtual coupling.
    """

    device: AnyDevice
    period: float
    hold: str
    references: dict[str, Environment]
    coupling: Coupling | None

    def curve(self, environment: str, omega: Array, *, coupled: bool) -> Array:
        """abs(Z_h) of a reference at frequencies (M,), rad/s, without or through the coupling, N·s/m."""
        return np.abs(
            haptics.perceived_impedance(
                omega,
                self.device,
                self.references[environment],
                self.period,
                coupling=self.coupling if coupled else None,
                hold=self.hold,
            )
        )

    def resonances(self, environment: str) -> Array:
        """Frequencies, rad/s, near which curves bend most: the device's mass on the reference, its modes."""
        device = self.device
        if not isinstance(device, haptics.Device):
            return device.omega[:: max(1, device.omega.size // _MOST_ROWS)]
        pairs = [(mode.stiffness, mode.mass) for mode in device.modes]
        pairs.append((self.references[environment].stiffness, device.mass))
        return np.array([float(np.sqrt(k / m)) for k, m in pairs if m])


@dataclasses.dataclass(frozen=True)
class Range:
    """Frequencies of curves: a grid as asked, or as many as the curves need.

    Attributes
    ----------
    lower, upper : float
        rad/s.
    omega : ndarray or None
        The grid asked for; None to choose one per environment.
    tolerance : float
        Largest relative distance of lines between the chosen points from any curve.
    """

    lower: float
    upper: float
    omega: Array | None = None
    tolerance: float = TOLERANCE


def environment_boundaries(
    bench: Bench, environment: str, regions: list[Region], draws: list[Draws], frequencies: Range
) -> list[Boundary]:
    """Draw every boundary of one environment.

    Parameters
    ----------
    bench : Bench
        Device and references.
    environment : str
        Which environment.
    regions : list of Region
        Corner curves are drawn around rectangles, envelopes around all.
    draws : list of Draws
        Pointwise and simultaneous bands are drawn through them.
    frequencies : Range
        Where; chosen frequencies are each boundary's own.

    Returns
    -------
    list of Boundary
    """
    place = _Place(bench, environment, frequencies)
    found = []
    for region in regions:
        if region.ellipse is None:
            found.append(_around(place, region, "corner"))
        found.append(_around(place, region, "envelope"))
    for drawn in draws:
        if environment in drawn.pairs:
            found += _through(place, drawn)
    return found


def region_curves(
    region: Region, shape: Shape, omega: Array, device: AnyDevice, period: float, *, hold: str
) -> tuple[Array, Array]:
    """Lower and upper curve around a region.

    Parameters
    ----------
    region : Region
        Rectangle or ellipse.
    shape : {"corner", "envelope"}
        Corner curves are for rectangles.
    omega : ndarray, shape (M,)
        rad/s.
    device : Device or TabulatedDevice
        The device.
    period : float
        Sampling period, s.
    hold : str
        "average" (Eq. 8) or "true".

    Returns
    -------
    lower, upper : ndarray, shape (M,)
        N·s/m.
    """
    if region.ellipse is not None:
        ellipse = region.ellipse
        log = ellipse.family == "lognormal"
        envelope = haptics.magnitude_envelope_log_ellipse if log else haptics.magnitude_envelope_ellipse
        centre = (float(ellipse.centre[0]), float(ellipse.centre[1]))
        return envelope(omega, device, centre, ellipse.shape, ellipse.radius, period, hold=hold)
    assert region.limits is not None
    box = haptics.corner_curves if shape == "corner" else haptics.magnitude_envelope
    return box(omega, device, *region.limits, period, hold=hold)


class _Place:
    """One environment on a bench: its own curves are followed beside every boundary's."""

    def __init__(self, bench: Bench, environment: str, frequencies: Range) -> None:
        self.bench, self.environment, self.frequencies = bench, environment, frequencies
        self._known: dict[float, tuple[float, float]] = {}

    def own(self, omega: Array) -> Array:
        """abs(Z_h) of the reference, without and through the coupling, shape (2, M).

        Grids halve the same intervals for one boundary after another: what was evaluated is kept.
        """
        places = omega.tolist()
        new = np.array([place for place in places if place not in self._known])
        if new.size:
            pair = (self.bench.curve(self.environment, new, coupled=coupled) for coupled in (False, True))
            values = zip(*(curve.tolist() for curve in pair), strict=True)
            self._known.update(zip(new.tolist(), values, strict=True))
        return np.array([self._known[place] for place in places]).T

    def sampled(
        self, curves: Callable[[Array], Array], smooth: tuple[bool, ...]
    ) -> tuple[dict[str, Any], Array]:
        """Evaluate curves (rows `smooth` or not) where asked, or where they need it, with what all share."""
        bench = self.bench

        def stacked(omega: Array) -> Array:
            return np.concatenate([self.own(omega), curves(omega)])

        wanted = self.frequencies
        if wanted.omega is not None:
            grid = Grid(wanted.omega, stacked(wanted.omega), np.nan)
        else:
            grid = adaptive_grid(
                stacked,
                wanted.lower,
                wanted.upper,
                tolerance=wanted.tolerance,
                including=bench.resonances(self.environment),
                followed=np.array((True, True, *smooth)),
            )
        reference, coupled = grid.values[:2]
        shared = {
            "environment": self.environment,
            "omega": grid.omega,
            "reference": reference,
            "coupled": coupled if bench.coupling is not None else None,
            "departure": grid.departure if wanted.omega is None else None,
        }
        return shared, grid.values[2:]


def _around(place: _Place, region: Region, shape: Shape) -> Boundary:
    bench = place.bench

    def curves(omega: Array) -> Array:
        return np.stack(region_curves(region, shape, omega, bench.device, bench.period, hold=bench.hold))

    shared, (lower, upper) = place.sampled(curves, (True, True))
    return Boundary(
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


def _through(place: _Place, drawn: Draws) -> Iterator[Boundary]:
    bench = place.bench
    pairs = drawn.pairs[place.environment]
    ensemble = DrawCurves(bench.device, *pairs, bench.period, level=drawn.level, hold=bench.hold)

    def curves(omega: Array) -> Array:
        bands = ensemble.at(omega)
        out = _PROXY * bands.sd
        return np.stack([bands.lower, bands.upper, np.exp(bands.mean - out), np.exp(bands.mean + out)])

    # Quantiles of draws are rough on a small scale: the points follow the band's smooth proxies.
    shared, (lower, upper, low, high) = place.sampled(curves, (False, False, True, True))
    logs = np.log(low), np.log(high)
    bands = DrawBands(lower, upper, 0.5 * (logs[0] + logs[1]), 0.5 * (logs[1] - logs[0]) / _PROXY)
    shapes: dict[Shape, tuple[Array, Array]] = {
        "pointwise": (lower, upper),
        "simultaneous": ensemble.simultaneous(bands),
    }
    for shape, (low, high) in shapes.items():
        yield Boundary(
            lower=low,
            upper=high,
            shape=shape,
            kind=drawn.kind,
            method=drawn.method,
            family=drawn.family,
            joint="joint",
            level=drawn.level,
            **shared,
        )
