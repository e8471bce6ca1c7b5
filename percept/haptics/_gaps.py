"""Quadratic inequalities in one variable, and what several of them leave of a line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from percept.haptics._arrays import BoolArray, FloatArray, ratio


def where_positive(a: FloatArray, half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return where a·k² + 2·half_b·k + c > 0: two open intervals, NaN where absent; shape (..., 4)."""
    discriminant = half_b**2 - a * c
    real = discriminant > 0
    root = half_b + np.copysign(np.sqrt(np.where(real, discriminant, 0.0)), half_b)
    # Divisions by zero leave inf for the root that is not there, and NaN for none.
    one, other = ratio(-root, a, empty=np.nan), ratio(-c, root, empty=np.nan)
    low, high = np.fmin(one, other), np.fmax(one, other)
    convex = a > 0
    outside, between = convex & real, ~convex & real
    found = np.empty((*low.shape, 4))
    found[..., 0] = np.where(convex, -np.inf, np.where(between, low, np.nan))
    found[..., 1] = np.where(outside, low, np.where(convex, np.inf, np.where(between, high, np.nan)))
    found[..., 2] = np.where(outside, high, np.nan)
    found[..., 3] = np.where(outside, np.inf, np.nan)
    linear = a == 0
    if linear.any():
        found[linear] = _where_rising(half_b[linear], c[linear])
    return found


def _where_rising(half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return where 2·half_b·k + c > 0, as `where_positive`; shape (n, 4)."""
    place = -c / np.where(half_b == 0, 1.0, 2 * half_b)
    found = np.full((half_b.size, 4), np.nan)
    somewhere = (half_b != 0) | (c > 0)
    found[somewhere, 0] = np.where(half_b > 0, place, -np.inf)[somewhere]
    found[somewhere, 1] = np.where(half_b < 0, place, np.inf)[somewhere]
    return found


@dataclass(frozen=True, eq=False)
class Gaps:
    """Qualifying intervals of k_c on lines of b_c; where `kept`, `low` to `high`, increasing, N/m."""

    low: FloatArray
    high: FloatArray
    kept: BoolArray

    @classmethod
    def of(cls, ceiling: FloatArray, forbidden: FloatArray) -> Gaps:
        """Take open intervals (lines, cuts, 2) out of [0, ceiling] of each line; NaN forbids nothing."""
        absent = np.isnan(forbidden).any(axis=2)
        starts, ends = (
            np.where(absent, np.inf, forbidden[..., 0]),
            np.where(absent, -np.inf, forbidden[..., 1]),
        )
        order = starts.argsort(axis=1)
        starts, ends = np.take_along_axis(starts, order, axis=1), np.take_along_axis(ends, order, axis=1)
        none = np.zeros((ceiling.size, 1))
        high = np.minimum(np.concatenate([starts, none + np.inf], axis=1), ceiling[:, None])
        low = np.maximum.accumulate(np.concatenate([none, ends], axis=1), axis=1)
        # After an interval that forbids nothing the same gap would stand again.
        again = np.concatenate([none > 0, high[:, 1:] == high[:, :-1]], axis=1)
        return cls(low, high, (high > low) & ~again & (ceiling > 0)[:, None])

    def lines(self) -> tuple[FloatArray, ...]:
        """Return the intervals of each line, shape (m, 2)."""
        pairs = np.stack([self.low[self.kept], self.high[self.kept]], axis=1)
        return tuple(np.split(pairs, np.cumsum(self.kept.sum(axis=1))[:-1]))

    def costs(self) -> FloatArray:
        """Return −(largest k_c) and the smallest k_c of each line, shape (2, lines); inf without any."""
        largest = np.where(self.kept, -self.high, np.inf).min(axis=1)
        return np.stack([largest, np.where(self.kept, self.low, np.inf).min(axis=1)])
