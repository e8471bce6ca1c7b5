"""Where a curve leaves a boundary: shares of the range, and intervals of omega."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.notebook import NotebookRecord

Array = NDArray[np.float64]
# Limits of zero and of infinity have no logarithm; at this depth (twelve decades) they can no longer be left.
_DEEP = 12.0 * np.log(10.0)
_LEAST, _MOST = np.finfo(np.float64).tiny, np.finfo(np.float64).max


@dataclass(frozen=True)
class Membership(NotebookRecord):
    """How a curve lies to a boundary over a range of omega."""

    inside: float  # Share of the range inside, measured in log omega
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
    return np.asarray(np.log(np.clip(values, _LEAST, _MOST)))


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
    share = np.divide(before, before - after, out=np.zeros_like(before), where=crossing)
    crossings = (x[:-1] + share * np.diff(x))[crossing]
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
