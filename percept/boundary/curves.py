"""Curves over omega: frequencies to draw them at, where they leave a boundary, how far two lie apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.boundary.records import Boundary
from percept.errors import UsageError
from percept.html import NotebookRecord

Array = NDArray[np.float64]

_PER_DECADE = 40
# Beside a resonance curves bend within a few per cent of its omega.
_BESIDE = 1.0 + np.array([-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04])
# Frequencies nearer one another than this fraction show nothing more.
_APART = 2e-3
# Limits of zero and of infinity have no logarithm; at this depth (twelve decades) they can no longer be left.
_DEEP = 12.0 * np.log(10.0)
_TINY, _HUGE = np.finfo(np.float64).tiny, np.finfo(np.float64).max
# Between two boundaries a lower limit of zero counts as this fraction of the smaller of the upper limits.
_GAP_FLOOR = 1e-6


def drawing_grid(
    curves: Callable[[Array], tuple[Array, Array]], lower: float, upper: float, resonances: Array
) -> Array:
    """Choose frequencies to draw curves at, rad/s: even in log omega, and where the curves turn or cross.

    `curves` gives the environment's own (C, M), and limits (B, 2, M). No verdict rests on the grid.
    """
    if not 0.0 < lower < upper:
        raise UsageError("frequencies must satisfy 0 < lower < upper, in rad/s.", value=(lower, upper))
    count = max(3, int(np.ceil(_PER_DECADE * np.log10(upper / lower))) + 1)
    beside = np.multiply.outer(np.asarray(resonances, dtype=float), _BESIDE).ravel()
    even = np.geomspace(lower, upper, count)
    omega = _apart(even, beside[(beside > lower) & (beside < upper)])
    own, limits = curves(omega)
    # At a pole curves are endless, and no line leads there.
    finite = np.isfinite(own).all(axis=0) & np.isfinite(limits).all(axis=(0, 1))
    omega, own, limits = omega[finite], own[:, finite], limits[..., finite]
    x = np.log(omega)
    rows = _log(np.concatenate([own, limits.reshape(-1, omega.size)]))
    # A parabola through three points turns where they do.
    left, right = rows[:, 1:-1] - rows[:, :-2], rows[:, 2:] - rows[:, 1:-1]
    curve, at = np.nonzero(left * right < 0.0)
    before, after = x[at + 1] - x[at], x[at + 2] - x[at + 1]
    fall, rise = left[curve, at] / before, right[curve, at] / after
    turns = 0.5 * (x[at] + x[at + 1]) + fall / (fall - rise) * 0.5 * (before + after)
    gaps = [_log(limits[:, 1]) - _log(limits[:, 0])]
    gaps += [_log(row) - _log(limits[:, side]) for row in own for side in (0, 1)]
    depth = np.concatenate(gaps)
    curve, at = np.nonzero(np.sign(depth[:, :-1]) * np.sign(depth[:, 1:]) < 0)
    first, second = depth[curve, at], depth[curve, at + 1]
    crossings = x[at] + first / (first - second) * (x[at + 1] - x[at])
    return _apart(omega, np.exp(np.concatenate([turns, crossings])))


def _apart(omega: Array, more: Array) -> Array:
    """Add frequencies that lie apart from one another and from those there are."""
    for new in np.unique(more):
        at = np.searchsorted(omega, new)
        near = omega[max(at - 1, 0) : at + 1]
        if np.abs(np.log(near / new)).min() > _APART:
            omega = np.insert(omega, at, new)
    return omega


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
    """Logarithms; zero and infinity go to the ends of what doubles hold."""
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
