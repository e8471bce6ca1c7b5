"""Covariance blocks of one or two parameters, in algebra that does not cancel.

A block holds a 1 x 1 or 2 x 2 covariance for every entry of its axes. The 2 x 2 form is kept as a
regression: the variance v of the first parameter, the slope g of the second on it and the variance
w left over, so that A = L diag(v, w) L' with L = [[1, 0], [g, 1]]. Sums, inverses, determinants and
distances then need positive terms only, and a correlation of 1 - 1e-9 keeps the digits that ``v1*v2
- c*c`` would lose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: One array per parameter: the components of a vector for every entry of the trailing axes.
Vector = tuple[Array, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """A covariance per entry, or a precision: of two parameters that regresses the first on the second."""

    variances: Vector  # Of the leading parameter, and of the other what the leading one leaves
    slope: Array | None = None  # Of the other on the leading one; none of a single parameter
    precision: bool = False  # Whether the second parameter leads

    def mapped(self, change: Callable[[Array], Array]) -> Block:
        """Change the layout of the entries."""
        slope = None if self.slope is None else change(self.slope)
        return Block(tuple(change(part) for part in self.variances), slope, self.precision)

    def __getitem__(self, key: Any) -> Block:
        return self.mapped(lambda part: part[key])

    def _leading_first(self, r: Vector) -> Vector:
        """Swap the components where the second parameter leads; twice is not at all."""
        return r[::-1] if self.precision else r

    def __add__(self, other: Block) -> Block:
        v1, v2 = self.variances[0], other.variances[0]
        v = v1 + v2
        if self.slope is None or other.slope is None:
            return Block((v,), None, self.precision)
        apart = self.slope - other.slope
        share = v2 / v
        # The slope as a weighted mean: g1 - share (g1 - g2) would cancel where v2 is far above v1.
        slope = (v1 * self.slope + v2 * other.slope) / v
        left = self.variances[1] + other.variances[1] + v1 * share * apart * apart
        return Block((v, left), slope, self.precision)

    def plus_diagonal(self, diagonal: Vector) -> Block:
        """Return the sum with a diagonal block, given in the order of the parameters."""
        added = self._leading_first(diagonal)
        v = self.variances[0] + added[0]
        if self.slope is None:
            return Block((v,), None, self.precision)
        share = added[0] / v
        # v (g - s)² + d1 s² with s = g v/(v + d1) is g² v d1/(v + d1).
        left = self.variances[1] + added[1] + self.slope * self.slope * self.variances[0] * share
        return Block((v, left), self.slope * (self.variances[0] / v), self.precision)

    def total(self) -> Block:
        """Return the sum over the first axis."""
        v = self.variances[0].sum(axis=0)
        if self.slope is None:
            return Block((v,), None, self.precision)
        slope = (self.variances[0] * self.slope).sum(axis=0) / v
        apart = self.slope - slope
        left = self.variances[1].sum(axis=0) + (self.variances[0] * apart * apart).sum(axis=0)
        return Block((v, left), slope, self.precision)

    def scaled(self, factor: Array | float) -> Block:
        """Return the block times a positive number per entry."""
        return Block(tuple(part * factor for part in self.variances), self.slope, self.precision)

    def inverse(self) -> Block:
        """Return the inverse block."""
        slope = None if self.slope is None else -self.slope
        return Block(tuple(1.0 / part for part in self.variances[::-1]), slope, not self.precision)

    def log_determinant(self) -> Array:
        """Return the log determinant per entry."""
        return np.asarray(sum(np.log(part) for part in self.variances))

    def apply(self, r: Vector) -> Vector:
        """Return block times vector."""
        if self.slope is None:
            return (self.variances[0] * r[0],)
        first, second = self._leading_first(r)
        leading = self.variances[0] * (first + self.slope * second)
        return self._leading_first((leading, self.slope * leading + self.variances[1] * second))

    def _remainders(self, r: Vector) -> Vector:
        """Components of a vector, of the second what the first does not explain."""
        return r if self.slope is None else (r[0], r[1] - self.slope * r[0])

    def whiten(self, r: Vector) -> Vector:
        """Return F⁻¹r, where F is the lower factor of a covariance, FF' = A."""
        left = self._remainders(r)
        return tuple(part / np.sqrt(v) for part, v in zip(left, self.variances, strict=True))

    def distance(self, r: Vector) -> Array:
        """Return the sum of r'A⁻¹r over the first axis of r, per entry of a covariance A."""
        squares = (np.einsum("k...,k...->...", part, part) for part in self._remainders(r))
        return np.asarray(
            sum(square / v for square, v in zip(squares, self.variances, strict=True))
        )

    def factor_columns(self) -> list[Vector]:
        """Return the columns of the lower factor F of a covariance."""
        root = np.sqrt(self.variances[0])
        if self.slope is None:
            return [(root,)]
        return [(root, self.slope * root), (np.zeros_like(root), np.sqrt(self.variances[1]))]

    def diagonal(self) -> Vector:
        """Return the variances of a covariance, one array per parameter."""
        if self.slope is None:
            return self.variances
        v, left = self.variances
        return (v, left + self.slope * self.slope * v)


def block(sd: Vector, rho: Array | None = None, one_minus_size: Array | None = None) -> Block:
    """Build a covariance from standard deviations and, for two parameters, a correlation."""
    if len(sd) == 1:
        return Block((sd[0] * sd[0],))
    if rho is None or one_minus_size is None:
        return Block((sd[0] * sd[0], sd[1] * sd[1]), np.zeros_like(sd[0]))
    left = one_minus_size * (1.0 + np.abs(rho))
    return Block((sd[0] * sd[0], sd[1] * sd[1] * left), rho * (sd[1] / sd[0]))


def weighted_mean(parts: Block, total: Block, r: Vector, *, axis: int = -2) -> Vector:
    """Return K⁻¹ sum_j P_j r_j, K the total of the precisions P_j."""
    if parts.slope is None or total.slope is None:
        return ((parts.variances[0] * r[0]).sum(axis=axis) / total.variances[0],)
    second = parts.variances[0] * (r[1] + parts.slope * r[0])
    # Differences of slopes: applying K⁻¹ to P_j r_j would subtract numbers 1/(1 - rho²) times the
    # result.
    first = (parts.variances[1] * r[0] + (parts.slope - total.slope) * second).sum(axis=axis)
    mean = first / total.variances[1]
    return (mean, second.sum(axis=axis) / total.variances[0] - total.slope * mean)


def weighted_mean_of_rows(parts: Block, total: Block, rows: Array) -> Vector:
    """Return K⁻¹ sum_j P_j r_j for many constant vectors."""
    if parts.slope is None or total.slope is None:
        return (rows[0] @ parts.variances[0] / total.variances[0],)
    v, left = parts.variances
    # The weights of `weighted_mean`, applied to all vectors by one product of matrices each.
    cross = v * parts.slope
    apart = parts.slope - total.slope
    first = rows[0] @ (left + apart * cross) + rows[1] @ (apart * v)
    second = rows[0] @ cross + rows[1] @ v
    mean = first / total.variances[1]
    return (mean, second / total.variances[0] - total.slope * mean)


def gram(columns: Sequence[Array]) -> Block:
    """C'C for columns (q, J, W) per parameter, as a block: residual sums keep a near-singular one exact."""
    first = np.einsum("qjw,qjw->jw", columns[0], columns[0])
    if len(columns) == 1:
        return Block((first,))
    cross = np.einsum("qjw,qjw->jw", columns[0], columns[1])
    # A variance that underflows leaves nothing to regress on.
    slope = np.divide(cross, first, out=np.zeros_like(cross), where=first > 0)
    left = columns[1] - slope * columns[0]
    return Block((first, np.einsum("qjw,qjw->jw", left, left)), slope)


class SharedCovariance:
    """blockdiag(D_1 … D_E) + 11' (x) S for W sets of scales, never formed.

    A vector r splits into its precision-weighted mean m and the deviations from it, and r'V⁻¹r =
    sum_j (r_j - m)'D_j⁻¹(r_j - m) + m'(S + (sum_j D_j⁻¹)⁻¹)⁻¹m: squares only, where Woodbury's
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
