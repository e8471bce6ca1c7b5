"""Covariance of one subject's cell means: a block per environment plus a share they have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, weighted_mean, weighted_mean_of_rows

Array = NDArray[np.float64]


class SharedCovariance:
    """blockdiag(D_1 … D_E) + 11' (x) S for W sets of scales, never formed.

    A vector r splits into its precision-weighted mean m and the deviations from it, and
    r'V⁻¹r = sum_j (r_j - m)'D_j⁻¹(r_j - m) + m'(S + (sum_j D_j⁻¹)⁻¹)⁻¹m: squares only, where Woodbury's
    identity would subtract (up to 12 digits at extreme variances).
    """

    def __init__(self, cells: Block, shared: Block | None) -> None:
        self._cells = cells
        self._shared = shared is not None
        if shared is not None:
            self._precisions = cells.inverse()
            self._precision = self._precisions.total()
            self._outer = shared + self._precision.inverse()

    def log_determinant(self) -> Array:
        """Return log det V, shape (W,)."""
        value = self._cells.log_determinant().sum(axis=0)
        if self._shared:
            value = value + self._precision.log_determinant() + self._outer.log_determinant()
        return value

    def whiten(self, r: Vector) -> list[Vector]:
        """Split r into pieces whose squares sum to r'V⁻¹r."""
        if not self._shared:
            return [self._cells.whiten(r)]
        mean = weighted_mean(self._precisions, self._precision, r)
        inside = tuple(component - m[..., None, :] for component, m in zip(r, mean, strict=True))
        return [self._cells.whiten(inside), self._outer.whiten(mean)]

    def scatter_distance(self, rows: Array) -> Array:
        """Sum of r'V⁻¹r over constant rows."""
        vectors = tuple(rows[..., None])
        if not self._shared:
            return self._cells.distance(vectors).sum(axis=0)
        mean = weighted_mean_of_rows(self._precisions, self._precision, rows)
        inside = tuple(r - m[:, None] for r, m in zip(vectors, mean, strict=True))
        return self._cells.distance(inside).sum(axis=0) + self._outer.distance(mean)
