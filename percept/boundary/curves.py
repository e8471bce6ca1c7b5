"""Curves over omega: frequencies that follow them, where they leave a boundary, how far two lie apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.boundary.records import Boundary
from percept.errors import UsageError
from percept.html import NotebookRecord

Array = NDArray[np.float64]

# Largest relative distance of the lines from the curves.
TOLERANCE = 1e-3
# Below this fraction of the largest curve at an omega a curve counts as this fraction: it may dip to zero,
# which no number of lines in log-log can follow.
FLOOR = 1e-3
_PER_DECADE = 8
_ENDLESS = 1e300  # what a pole counts as that is hit on the way
_MOST = 4096
# A corner of a curve near one end of an interval lies up to twice as far from the lines through the middle,
# once that is a point, as the middle lay from the line before.
_CORNER = 2.0
# Intervals of a smaller ratio of frequencies, less one, are not halved: around a pole no halving would do.
_NARROWEST = 1e-9
# Limits of zero and of infinity have no logarithm; at this depth (twelve decades) they can no longer be left.
_DEEP = 12.0 * np.log(10.0)
_TINY, _HUGE = np.finfo(np.float64).tiny, np.finfo(np.float64).max
# Between two boundaries a lower limit of zero counts as this fraction of the smaller of the upper limits.
_GAP_FLOOR = 1e-6


@dataclass(frozen=True, eq=False)
class Grid:
    """Curves at frequencies chosen for them."""

    omega: Array  # (M,) rad/s, increasing
    values: Array  # (C, M) The curves there
    departure: float  # bound of the relative distance of the lines from the curves


def adaptive_grid(
    curves: Callable[[Array], Array],
    lower: float,
    upper: float,
    *,
    tolerance: float = TOLERANCE,
    including: Array | None = None,
    followed: NDArray[np.bool_] | None = None,
) -> Grid:
    """Choose frequencies so that lines between them in log-log follow every curve, or those `followed`.

    Intervals of log omega are halved until the curves at their middle lie within half the tolerance of the
    line between their ends. Those middles are kept: a smooth curve then lies within an eighth of the
    tolerance, one with a corner in the interval within all of it.
    """
    if not 0.0 < lower < upper:
        raise UsageError("frequencies must satisfy 0 < lower < upper, in rad/s.", value=(lower, upper))
    if not 0.0 < tolerance < 1.0:
        raise UsageError("tolerance must lie in (0, 1).", value=tolerance)
    omega = _start(lower, upper, including)
    values = curves(omega)
    rows = np.ones(len(values), dtype=bool) if followed is None else followed
    finite = np.isfinite(values).all(axis=0)
    omega, values = omega[finite], values[:, finite]
    logs = _followed(omega, values[rows])
    left, farthest = np.arange(omega.size - 1), 0.0
    while left.size:
        middle = np.sqrt(omega[left] * omega[left + 1])
        found = curves(middle)
        true = _followed(middle, found[rows])
        off = _CORNER * _departure(logs[:, left], logs[:, left + 1], true)
        wide = logs[0, left + 1] - logs[0, left] > _NARROWEST
        split = (off > tolerance) & wide & (omega.size < _MOST)
        farthest = float(np.max(off[wide & ~split], initial=farthest))
        omega = np.insert(omega, left + 1, middle)
        values, logs = (np.insert(old, left + 1, new, axis=1) for old, new in ((values, found), (logs, true)))
        new = left + np.arange(left.size)
        left = np.sort(np.concatenate([new[split], new[split] + 1]))
    finite = np.isfinite(values).all(axis=0)
    return Grid(omega[finite], values[:, finite], farthest)


def _start(lower: float, upper: float, including: Array | None) -> Array:
    count = max(3, int(np.ceil(_PER_DECADE * np.log10(upper / lower))) + 1)
    extra = np.empty(0) if including is None else np.asarray(including, dtype=float)
    extra = extra[(extra > lower) & (extra < upper)]
    return np.unique(np.concatenate([np.geomspace(lower, upper, count), extra]))


def _followed(omega: Array, values: Array) -> Array:
    """Logarithms of omega and, below it, of the curves; those below `FLOOR` of the largest count as that."""
    finite = np.minimum(values, _ENDLESS)
    return np.log(np.vstack([omega, np.maximum(finite, FLOOR * finite.max(axis=0))]))


def _departure(left: Array, right: Array, true: Array) -> Array:
    """Measure how far lines lie from curves between two points, the worst of them in each interval."""
    fraction = (true[0] - left[0]) / (right[0] - left[0])
    line = left[1:] + fraction * (right[1:] - left[1:])
    return np.asarray(np.abs(line - true[1:]).max(axis=0))


@dataclass(frozen=True)
class Membership(NotebookRecord):
    """How a curve lies to a boundary over a range of omega."""

    inside: float  # Fraction of the range inside, measured in log omega
    leaves: tuple[tuple[float, float], ...]  # Intervals of omega outside, rad/s, in order
    margin: float  # Smallest depth inside, negative where the curve leaves
    margin_omega: float  # Where that is, rad/s


def magnitude_membership(omega: Array, lower: Array, upper: Array, curve: Array) -> Membership:
    """Compare abs(Z) with a boundary; curves are straight in log-log between the frequencies."""
    shared = np.isinf(lower) & np.isinf(upper) & np.isinf(curve)
    omega, lower, upper, curve = (part[~shared] for part in (omega, lower, upper, curve))
    over = np.where(lower > 0, np.minimum(_log(curve) - _log(lower), _DEEP), _DEEP)
    under = np.where(upper < np.inf, np.minimum(_log(upper) - _log(curve), _DEEP), _DEEP)
    return depth_membership(omega, np.stack([over, under]))


def _log(values: Array) -> Array:
    """Logarithms, those of zero and of infinity as far out as doubles reach."""
    return np.asarray(np.log(np.clip(values, _TINY, _HUGE)))


def depth_membership(omega: Array, depths: Array) -> Membership:
    """Say where several depths are all zero or more, each linear in log omega between the frequencies."""
    if omega.ndim != 1 or omega.size < 2 or depths.shape[1:] != omega.shape:
        raise UsageError("a curve needs one value per omega, two or more.", value=(omega.shape, depths.shape))
    if omega[0] <= 0 or np.any(np.diff(omega) <= 0):
        raise UsageError("omega must be positive and increase, in rad/s.")
    x = np.log(omega)
    before, after = depths[:, :-1], depths[:, 1:]
    # By signs: depths reach -1e300, whose product is out of range.
    crossing = np.sign(before) * np.sign(after) < 0
    fraction = np.divide(before, before - after, out=np.zeros_like(before), where=crossing)
    crossings = (x[:-1] + fraction * np.diff(x))[crossing]
    edges = np.unique(np.concatenate([x, crossings]))
    middle = 0.5 * (edges[:-1] + edges[1:])
    least = np.min([np.interp(middle, x, depth) for depth in depths], axis=0)
    outside = least < 0
    lengths = np.diff(edges)
    within, beyond = lengths[~outside].sum(), lengths[outside].sum()
    nearest = depths.min(axis=0)
    where = int(nearest.argmin())
    return Membership(
        # Over the sum of both: nothing inside is zero exactly, and everything one.
        inside=float(within / (within + beyond)),
        leaves=_runs(edges, outside),
        margin=float(nearest[where]),
        margin_omega=float(omega[where]),
    )


def _runs(edges: Array, outside: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Intervals of omega made of adjacent pieces outside."""
    change = np.diff(np.concatenate([[0], outside.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    return tuple(
        (float(np.exp(edges[i])), float(np.exp(edges[j]))) for i, j in zip(starts, ends, strict=True)
    )


@dataclass(frozen=True)
class CurveGap(NotebookRecord):
    """Distance of one curve from another, as natural logarithms of their ratio."""

    area: float  # Mean of abs(log ratio) over log omega
    largest: float  # log(second/first) where it is largest in size
    omega: float  # Where that is, rad/s


def curve_gap(first: Boundary, second: Boundary) -> dict[str, CurveGap]:
    """Compare the lower and the upper curves of two boundaries over the range they share."""
    low, high = max(first.omega[0], second.omega[0]), min(first.omega[-1], second.omega[-1])
    if not low < high:
        raise UsageError("the two boundaries have no range of omega in common.", value=(low, high))
    omega = np.unique(np.concatenate([first.omega, second.omega]))
    omega = omega[(omega >= low) & (omega <= high)]
    x = np.log(omega)
    upper = [_line(one, "upper", x) for one in (first, second)]
    floor = np.log(_GAP_FLOOR) + np.minimum(*upper)
    lower = [np.maximum(_line(one, "lower", x), floor) for one in (first, second)]
    gaps = {}
    for side, (one, other) in (("lower", lower), ("upper", upper)):
        ratio = other - one
        worst = int(np.abs(ratio).argmax())
        area = float(np.trapezoid(np.abs(ratio), x) / (x[-1] - x[0]))
        gaps[side] = CurveGap(area, float(ratio[worst]), float(omega[worst]))
    return gaps


def _line(boundary: Boundary, side: str, x: Array) -> Array:
    curve = np.maximum(getattr(boundary, side), _TINY)
    return np.interp(x, np.log(boundary.omega), np.log(curve))
