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

__all__ = [
    "Block",
    "SharedCovariance",
    "Vector",
    "block",
    "gram",
    "weighted_mean",
    "weighted_mean_of_rows",
]

Array = NDArray[np.float64]
#: One array per parameter: the components of a vector for every entry of the trailing axes.
Vector = tuple[Array, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """A covariance per entry, or a precision, which regresses the first parameter on the second."""

    variances: Vector  # Of the leading parameter, and of the other what the leading one leaves
    slope: Array | None = None  # Of the other on the leading one; none of a single parameter
    precision: bool = False  # Whether the second parameter leads

    @property
    def leading(self) -> Array:
        """Variance of the leading parameter."""
        return self.variances[0]

    @property
    def rest(self) -> Array:
        """Variance that the leading parameter leaves of the other."""
        return self.variances[1]

    def mapped(self, change: Callable[[Array], Array]) -> Block:
        """Change the layout of the entries."""
        variances = tuple(change(part) for part in self.variances)
        slope = None if self.slope is None else change(self.slope)
        return Block(variances, slope, self.precision)

    def __getitem__(self, key: Any) -> Block:
        return self.mapped(lambda part: part[key])

    def _leading_first(self, r: Vector) -> Vector:
        """Swap the components where the second parameter leads; its own inverse."""
        return r[::-1] if self.precision else r

    def __add__(self, other: Block) -> Block:
        v1 = self.leading
        v2 = other.leading
        v = v1 + v2
        if self.slope is None or other.slope is None:
            return Block((v,), None, self.precision)
        difference = self.slope - other.slope
        share = v2 / v
        # The slope as a weighted mean: g1 - share (g1 - g2) would cancel where v2 is far above v1.
        slope = (v1 * self.slope + v2 * other.slope) / v
        rest = self.rest + other.rest
        rest = rest + v1 * share * difference * difference
        return Block((v, rest), slope, self.precision)

    def plus_diagonal(self, diagonal: Vector) -> Block:
        """Return the sum with a diagonal block, given in the order of the parameters."""
        added = self._leading_first(diagonal)
        v = self.leading + added[0]
        if self.slope is None:
            return Block((v,), None, self.precision)
        share = added[0] / v
        # v (g - s)² + d1 s² with s = g v/(v + d1) is g² v d1/(v + d1).
        rest = self.rest + added[1]
        rest = rest + self.slope * self.slope * self.leading * share
        slope = self.slope * (self.leading / v)
        return Block((v, rest), slope, self.precision)

    def total(self) -> Block:
        """Return the sum over the first axis."""
        v = self.leading.sum(axis=0)
        if self.slope is None:
            return Block((v,), None, self.precision)
        weighted = self.leading * self.slope
        slope = weighted.sum(axis=0) / v
        difference = self.slope - slope
        scatter = self.leading * difference * difference
        rest = self.rest.sum(axis=0) + scatter.sum(axis=0)
        return Block((v, rest), slope, self.precision)

    def scaled(self, factor: Array | float) -> Block:
        """Return the block times a positive number per entry."""
        variances = tuple(part * factor for part in self.variances)
        return Block(variances, self.slope, self.precision)

    def inverse(self) -> Block:
        """Return the inverse block."""
        variances = tuple(1.0 / part for part in self.variances[::-1])
        slope = None if self.slope is None else -self.slope
        return Block(variances, slope, not self.precision)

    def log_determinant(self) -> Array:
        """Return the log determinant per entry."""
        logs = [np.log(part) for part in self.variances]
        return np.asarray(sum(logs))

    def apply(self, r: Vector) -> Vector:
        """Return block times vector."""
        if self.slope is None:
            return (self.leading * r[0],)
        first, second = self._leading_first(r)
        leading = self.leading * (first + self.slope * second)
        following = self.slope * leading + self.rest * second
        return self._leading_first((leading, following))

    def _remainders(self, r: Vector) -> Vector:
        """Components of a vector, of the second what the first does not explain."""
        if self.slope is None:
            return r
        return (r[0], r[1] - self.slope * r[0])

    def whiten(self, r: Vector) -> Vector:
        """Return F⁻¹r, where F is the lower factor of a covariance, FF' = A."""
        parts = zip(self._remainders(r), self.variances, strict=True)
        return tuple(part / np.sqrt(variance) for part, variance in parts)

    def distance(self, r: Vector) -> Array:
        """Return the sum of r'A⁻¹r over the first axis of r, per entry of a covariance A."""
        distance: Array | float = 0.0
        for part, variance in zip(self._remainders(r), self.variances, strict=True):
            squares = np.einsum("k...,k...->...", part, part)
            distance = distance + squares / variance
        return np.asarray(distance)

    def factor_columns(self) -> list[Vector]:
        """Return the columns of the lower factor F of a covariance."""
        root = np.sqrt(self.leading)
        if self.slope is None:
            return [(root,)]
        rest = np.sqrt(self.rest)
        return [(root, self.slope * root), (np.zeros_like(root), rest)]

    def diagonal(self) -> Vector:
        """Return the variances of a covariance, one array per parameter."""
        if self.slope is None:
            return self.variances
        explained = self.slope * self.slope * self.leading
        return (self.leading, self.rest + explained)


def block(
    sd: Vector,
    rho: Array | None = None,
    one_minus_size: Array | None = None,
) -> Block:
    """Build a covariance from standard deviations and, for two parameters, a correlation.

    `one_minus_size` is 1 - abs(rho), with the digits that a correlation near one loses.
    """
    variances = tuple(part * part for part in sd)
    if len(sd) == 1:
        return Block(variances)
    first, second = variances
    if rho is None or one_minus_size is None:
        return Block(variances, np.zeros_like(first))
    unexplained = one_minus_size * (1.0 + np.abs(rho))
    slope = rho * (sd[1] / sd[0])
    return Block((first, second * unexplained), slope)


def weighted_mean(
    parts: Block,
    total: Block,
    r: Vector,
    *,
    axis: int = -2,
) -> Vector:
    """Return K⁻¹ sum_j P_j r_j, K the total of the precisions P_j."""
    if parts.slope is None or total.slope is None:
        weighted = parts.leading * r[0]
        return (weighted.sum(axis=axis) / total.leading,)
    second = parts.leading * (r[1] + parts.slope * r[0])
    # Differences of slopes: applying K⁻¹ to P_j r_j would subtract numbers 1/(1 - rho²) times the
    # result.
    first = parts.rest * r[0] + (parts.slope - total.slope) * second
    mean = first.sum(axis=axis) / total.rest
    along = second.sum(axis=axis) / total.leading
    return (mean, along - total.slope * mean)


def weighted_mean_of_rows(
    parts: Block,
    total: Block,
    rows: Array,
) -> Vector:
    """Return K⁻¹ sum_j P_j r_j for many constant vectors."""
    if parts.slope is None or total.slope is None:
        return (rows[0] @ parts.leading / total.leading,)
    v, rest = parts.variances
    # The weights of `weighted_mean`, applied to all vectors by one product of matrices each.
    cross = v * parts.slope
    difference = parts.slope - total.slope
    first = rows[0] @ (rest + difference * cross) + rows[1] @ (difference * v)
    second = rows[0] @ cross + rows[1] @ v
    mean = first / total.rest
    return (mean, second / total.leading - total.slope * mean)


def gram(columns: Sequence[Array]) -> Block:
    """C'C for columns (q, J, W) per parameter; residual sums keep a near-singular one exact."""
    first = np.einsum("qjw,qjw->jw", columns[0], columns[0])
    if len(columns) == 1:
        return Block((first,))
    cross = np.einsum("qjw,qjw->jw", columns[0], columns[1])
    # A variance that underflows leaves nothing to regress on.
    nothing = np.zeros_like(cross)
    slope = np.divide(cross, first, out=nothing, where=first > 0)
    residual = columns[1] - slope * columns[0]
    rest = np.einsum("qjw,qjw->jw", residual, residual)
    return Block((first, rest), slope)


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
        pairs = zip(r, mean, strict=True)
        inside = tuple(component - m[..., None, :] for component, m in pairs)
        return [self._cells.whiten(inside), self._outer.whiten(mean)]

    def scatter_distance(self, rows: Array) -> Array:
        """Sum of r'V⁻¹r over constant rows."""
        vectors = tuple(rows[..., None])
        if not self._shared:
            return self._cells.distance(vectors).sum(axis=0)
        mean = weighted_mean_of_rows(self._precisions, self._precision, rows)
        pairs = zip(vectors, mean, strict=True)
        inside = tuple(component - m[:, None] for component, m in pairs)
        within_cells = self._cells.distance(inside).sum(axis=0)
        return within_cells + self._outer.distance(mean)
