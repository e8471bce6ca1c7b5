"""How far the boundaries of both methods lie apart, in place and in width."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np

from percept.results import BandDifference, BandPair
from percept.study.basics import Array
from percept.study.boundaries import BoundaryDrawing
from percept.study.regions import Region

__all__ = ["LimitErrors", "compare_bands"]


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
