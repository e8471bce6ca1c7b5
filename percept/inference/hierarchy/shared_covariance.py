"""Weighted means of a subject's cells, and the covariance of cells that share an effect.

A subject's cells have independent blocks D_j of noise, for j = 1 … E, and all of them share an
effect with the covariance S. Their covariance V = blockdiag(D_1 … D_E) + 11' (x) S is never formed.
With the precisions P_j = D_j⁻¹, their total K = sum_j P_j and the weighted mean
m = K⁻¹ sum_j P_j r_j of a vector r,

    r'V⁻¹r = sum_j (r_j - m)'P_j (r_j - m) + m'(S + K⁻¹)⁻¹m

These are squares only. Woodbury's identity would subtract, and lose up to 12 digits at extreme
variances. W are the sets of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector

__all__ = ["SharedCovariance", "weighted_mean"]

Array = NDArray[np.float64]


def weighted_mean(
    parts: Block,
    total: Block,
    r: Vector,
    *,
    axis: int = -2,
) -> Vector:
    """Return m of vectors (..., E, W), from the precisions P_j and their total K."""
    if parts.slope is None or total.slope is None:
        weighted = parts.leading * r[0]
        return (weighted.sum(axis=axis) / total.leading,)
    first, second = r
    leading = parts.leading * (second + parts.slope * first)
    # Differences of slopes: applying K⁻¹ to P_j r_j would subtract numbers 1/(1 - rho²) times the
    # result.
    difference = parts.slope - total.slope
    following = parts.rest * first + difference * leading
    mean = following.sum(axis=axis) / total.rest
    along = leading.sum(axis=axis) / total.leading
    return (mean, along - total.slope * mean)


def _weighted_mean_of_rows(
    parts: Block,
    total: Block,
    rows: Array,
) -> Vector:
    """Return m of n constant vectors (P, n, E), P the parameters: shape (n, W)."""
    if parts.slope is None or total.slope is None:
        return (rows[0] @ parts.leading / total.leading,)
    first, second = rows
    v, rest = parts.variances
    # The weights of `weighted_mean`, applied to all vectors by one product of matrices each.
    cross = v * parts.slope
    difference = parts.slope - total.slope
    following = first @ (rest + difference * cross)
    following = following + second @ (difference * v)
    leading = first @ cross + second @ v
    mean = following / total.rest
    along = leading / total.leading
    return (mean, along - total.slope * mean)


class SharedCovariance:
    """V for W sets of scales.

    Parameters
    ----------
    cells : Block
        D_j, entries (E, W).
    shared : Block, optional
        S, entries (W,). Without it, V = blockdiag(D_1 … D_E).
    """

    def __init__(self, cells: Block, shared: Block | None) -> None:
        self._cells = cells
        self._shared = shared is not None
        if shared is not None:
            self._precisions = cells.inverse()
            self._total = self._precisions.total()
            #: S + K⁻¹, entries (W,).
            self._outer = shared + self._total.inverse()

    def log_determinant(self) -> Array:
        """Return log det V, shape (W,)."""
        by_cell = self._cells.log_determinant()
        value = by_cell.sum(axis=0)
        if self._shared:
            # log det V = log det D + log det K + log det (S + K⁻¹).
            value = value + self._total.log_determinant()
            value = value + self._outer.log_determinant()
        return value

    def whiten(self, r: Vector) -> list[Vector]:
        """Split r into pieces whose squares sum to r'V⁻¹r."""
        if not self._shared:
            return [self._cells.whiten(r)]
        mean = weighted_mean(self._precisions, self._total, r)
        pairs = zip(r, mean, strict=True)
        deviations = tuple(component - m[..., None, :] for component, m in pairs)
        within_cells = self._cells.whiten(deviations)
        return [within_cells, self._outer.whiten(mean)]

    def scatter_distance(self, rows: Array) -> Array:
        """Sum of r'V⁻¹r over n constant vectors (P, n, E), P the parameters: shape (W,)."""
        vectors = tuple(rows[..., None])
        if not self._shared:
            by_cell = self._cells.distance(vectors)
            return by_cell.sum(axis=0)
        mean = _weighted_mean_of_rows(self._precisions, self._total, rows)
        pairs = zip(vectors, mean, strict=True)
        deviations = tuple(component - m[:, None] for component, m in pairs)
        by_cell = self._cells.distance(deviations)
        return by_cell.sum(axis=0) + self._outer.distance(mean)
