"""The exact envelope around a region of (k, b), against the smallest and largest of many points in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept.bench.timed import timed
from percept.haptics import perceived_magnitude
from percept.study.apparatus import Apparatus
from percept.study.boundaries import region_curves
from percept.study.regions import Region

if TYPE_CHECKING:
    from percept.study import Study

Array = NDArray[np.float64]
_POINTS = (8, 32, 128)
_RADII = (0.0, 0.25, 0.5, 0.75, 1.0)
#: Method, kind and joint statement of the regions compared: one rectangle and one ellipse per environment.
_COMPARED = {("bayesian", "mean", "bonferroni"), ("bayesian", "mean", "hotelling")}


@dataclass(frozen=True)
class EnvelopeCost:
    """One way to the envelope of abs(Z_h) over a region."""

    environment: str  # Whose region of average users
    region: str  # Its shape
    way: str  # Percept's, exact at every omega
    points: int | None  # How many points
    frequencies: int  # At which both are worked out
    seconds: float
    seconds_low: float
    seconds_high: float
    ratio: float  # seconds over percept's
    error: float
    worst_error: float


def envelope_costs(study: Study, *, frequencies: int = 500, repeats: int = 5) -> list[EnvelopeCost]:
    """Time both ways around the Bayesian regions of average users of every environment."""
    apparatus = study.apparatus
    assert apparatus is not None
    omega = np.geomspace(0.1, 100.0, frequencies)
    found: list[EnvelopeCost] = []
    for region in study.regions:
        if (region.method, region.kind, region.joint) in _COMPARED:
            found += _costs(region, apparatus, omega, repeats)
    return found


def _costs(region: Region, apparatus: Apparatus, omega: Array, repeats: int) -> list[EnvelopeCost]:
    def exact() -> tuple[Array, Array]:
        return region_curves(
            region, "envelope", omega, apparatus.device, apparatus.period, hold=apparatus.hold
        )

    def among(points: Array) -> tuple[Array, Array]:
        k, b = points
        every = perceived_magnitude(
            omega[:, None], apparatus.device, k, b, apparatus.period, hold=apparatus.hold
        )
        return every.min(axis=1), every.max(axis=1)

    ways: list[tuple[int | None, Callable[[], tuple[Array, Array]]]] = [(None, exact)]
    for count in _POINTS:
        points = _rectangle(region, count) if region.ellipse is None else _ellipse(region, count)
        ways.append((points.shape[1], partial(among, points)))
    runs = [timed(work, repeats) for _, work in ways]
    (limits, taken), *_ = runs
    true = np.log(np.stack(limits))
    found = []
    for (among_points, _), (limits, seconds) in zip(ways, runs, strict=True):
        error = np.abs(np.log(np.stack(limits)) - true) / (0.5 * (true[1] - true[0]))
        found.append(
            EnvelopeCost(
                environment=region.environment,
                region="rectangle" if region.ellipse is None else "ellipse",
                way="percept" if among_points is None else "points",
                points=among_points,
                frequencies=omega.size,
                seconds=median(seconds),
                seconds_low=min(seconds),
                seconds_high=max(seconds),
                ratio=median(seconds) / median(taken),
                error=float(np.sqrt(np.mean(error**2))),
                worst_error=float(error.max()),
            )
        )
    return found


def _rectangle(region: Region, count: int) -> Array:
    """Points of an even grid over a rectangle, count on a side: shape (2, N)."""
    assert region.limits is not None
    sides = (np.linspace(low, high, count) for low, high in region.limits)
    return np.stack([axis.ravel() for axis in np.meshgrid(*sides)])


def _ellipse(region: Region, count: int) -> Array:
    """Points on rings of an ellipse, count on each: shape (2, N)."""
    assert region.ellipse is not None
    ellipse = region.ellipse
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)])
    rings = np.concatenate([ellipse.radius * radius * ring for radius in _RADII], axis=1)
    points = np.asarray(ellipse.centre)[:, None] + np.linalg.cholesky(np.asarray(ellipse.shape)) @ rings
    return np.exp(points) if ellipse.family == "lognormal" else points
