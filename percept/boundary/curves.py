"""Frequencies that curves over omega are drawn at."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PER_DECADE = 40
# Beside a resonance curves bend within a few per cent of its omega.
_BESIDE = 1.0 + np.array([-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04])
# Frequencies nearer one another than this fraction show nothing more.
_APART = 2e-3
_TINY, _HUGE = np.finfo(np.float64).tiny, np.finfo(np.float64).max


def drawing_grid(
    curves: Callable[[Array], tuple[Array, Array]], lower: float, upper: float, resonances: Array
) -> Array:
    """Choose frequencies to draw curves at, rad/s: even in log omega, and where the curves turn or cross.

    `curves` gives the environment's own (C, M), and limits (B, 2, M). No verdict rests on the grid.
    """
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


def _log(values: Array) -> Array:
    """Logarithms; zero and infinity go to the ends of what doubles hold."""
    return np.asarray(np.log(np.clip(values, _TINY, _HUGE)))
