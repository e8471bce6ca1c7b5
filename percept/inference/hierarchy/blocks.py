"""Covariance blocks of one or two parameters, in algebra that does not cancel.

A block holds a 1 x 1 or 2 x 2 covariance for every entry of its axes. The 2 x 2 form is kept as a
regression: the variance v of the first parameter, the slope g of the second on it and the variance w
left over, so that A = L diag(v, w) L' with L = [[1, 0], [g, 1]]. Sums, inverses, determinants and
distances then need positive terms only, and a correlation of 1 - 1e-9 keeps the digits that
``v1*v2 - c*c`` would lose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: One array per parameter: the components of a vector for every entry of the trailing axes.
Vector = tuple[Array, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Scalar:
    """A variance (or, as an inverse, a precision) per entry: the block of a single parameter."""

    v: Array

    def __getitem__(self, key: Any) -> Scalar:
        return Scalar(self.v[key])

    def __add__(self, other: Block | Precision) -> Scalar:
        assert isinstance(other, Scalar)
        return Scalar(self.v + other.v)

    def plus_diagonal(self, variances: Vector) -> Scalar:
        """Return the sum with a diagonal block."""
        return Scalar(self.v + variances[0])

    def total(self) -> Scalar:
        """Return the sum over the first axis."""
        return Scalar(self.v.sum(axis=0))

    def scaled(self, factor: Array | float) -> Scalar:
        """Return the block times a positive number per entry."""
        return Scalar(self.v * factor)

    def inverse(self) -> Scalar:
        """Return the inverse block."""
        return Scalar(1.0 / self.v)

    def log_determinant(self) -> Array:
        """Return the log determinant per entry."""
        return np.log(self.v)

    def apply(self, r: Vector) -> Vector:
        """Return block times vector."""
        return (self.v * r[0],)

    def whiten(self, r: Vector) -> Vector:
        """Return F⁻¹r, where F is the lower factor of the block, FF' = A."""
        return (r[0] / np.sqrt(self.v),)

    def distance(self, r: Vector) -> Array:
        """Return the sum of r'A⁻¹r over the first axis of r, per entry."""
        return np.einsum("k...,k...->...", r[0], r[0]) / self.v

    def factor_columns(self) -> list[Vector]:
        """Return the columns of F."""
        return [(np.sqrt(self.v),)]

    def diagonal(self) -> Vector:
        """Return the variances, one array per parameter."""
        return (self.v,)


@dataclasses.dataclass(frozen=True, eq=False)
class _Regression:
    """A 2 x 2 block per entry: variance of one parameter, slope of the other on it, variance left."""

    v: Array
    g: Array
    w: Array

    def __getitem__(self, key: Any) -> Self:
        return type(self)(self.v[key], self.g[key], self.w[key])

    def __add__(self, other: Block | Precision) -> Self:
        assert isinstance(other, type(self))
        v = self.v + other.v
        apart = self.g - other.g
        share = other.v / v
        # The slope as a weighted mean: g1 - share (g1 - g2) would cancel where v2 is far above v1.
        slope = (self.v * self.g + other.v * other.g) / v
        return type(self)(v, slope, self.w + other.w + self.v * share * apart * apart)

    def log_determinant(self) -> Array:
        """Return the log determinant per entry."""
        return np.log(self.v) + np.log(self.w)


@dataclasses.dataclass(frozen=True, eq=False)
class Pair(_Regression):
    """A 2 x 2 covariance per entry: variance of the first, slope, variance left of the second."""

    def plus_diagonal(self, variances: Vector) -> Pair:
        """Return the sum with a diagonal block."""
        v = self.v + variances[0]
        share = variances[0] / v
        # v (g - s)² + d1 s² with s = g v/(v + d1) is g² v d1/(v + d1).
        return Pair(v, self.g * (self.v / v), self.w + variances[1] + self.g * self.g * self.v * share)

    def scaled(self, factor: Array | float) -> Pair:
        """Return the block times a positive number per entry."""
        return Pair(self.v * factor, self.g, self.w * factor)

    def inverse(self) -> PairPrecision:
        """Return the inverse block."""
        return PairPrecision(1.0 / self.w, -self.g, 1.0 / self.v)

    def apply(self, r: Vector) -> Vector:
        """Return block times vector."""
        first = self.v * (r[0] + self.g * r[1])
        return (first, self.g * first + self.w * r[1])

    def whiten(self, r: Vector) -> Vector:
        """Return F⁻¹r, where F is the lower factor of the block, FF' = A."""
        return (r[0] / np.sqrt(self.v), (r[1] - self.g * r[0]) / np.sqrt(self.w))

    def distance(self, r: Vector) -> Array:
        """Return the sum of r'A⁻¹r over the first axis of r, per entry."""
        left = r[1] - self.g * r[0]
        first, second = (np.einsum("k...,k...->...", part, part) for part in (r[0], left))
        return first / self.v + second / self.w

    def factor_columns(self) -> list[Vector]:
        """Return the columns of F."""
        root = np.sqrt(self.v)
        return [(root, self.g * root), (np.zeros_like(root), np.sqrt(self.w))]

    def diagonal(self) -> Vector:
        """Return the variances, one array per parameter."""
        return (self.v, self.w + self.g * self.g * self.v)


@dataclasses.dataclass(frozen=True, eq=False)
class PairPrecision(_Regression):
    """Inverse of a `Pair`: the same regression with the parameters in the other order."""

    def total(self) -> PairPrecision:
        """Return the sum over the first axis."""
        v = self.v.sum(axis=0)
        g = (self.v * self.g).sum(axis=0) / v
        apart = self.g - g
        return PairPrecision(v, g, self.w.sum(axis=0) + (self.v * apart * apart).sum(axis=0))

    def plus_diagonal(self, precisions: Vector) -> PairPrecision:
        """Return the sum with a diagonal block, given in the order of the parameters."""
        v = self.v + precisions[1]
        share = precisions[1] / v
        left = self.w + precisions[0] + self.g * self.g * self.v * share
        return PairPrecision(v, self.g * (self.v / v), left)

    def inverse(self) -> Pair:
        """Return the covariance this is the inverse of."""
        return Pair(1.0 / self.w, -self.g, 1.0 / self.v)

    def apply(self, r: Vector) -> Vector:
        """Return block times vector."""
        second = self.v * (r[1] + self.g * r[0])
        return (self.w * r[0] + self.g * second, second)


Block = Scalar | Pair
Precision = Scalar | PairPrecision


def block(sd: Vector, rho: Array | None = None, one_minus_size: Array | None = None) -> Block:
    """Build a block from standard deviations and, for two parameters, a correlation."""
    if len(sd) == 1:
        return Scalar(sd[0] * sd[0])
    if rho is None or one_minus_size is None:
        return Pair(sd[0] * sd[0], np.zeros_like(sd[0]), sd[1] * sd[1])
    left = one_minus_size * (1.0 + np.abs(rho))
    return Pair(sd[0] * sd[0], rho * (sd[1] / sd[0]), sd[1] * sd[1] * left)


def weighted_mean(parts: Precision, total: Precision, r: Vector, *, axis: int = -2) -> Vector:
    """Return K⁻¹ sum_j P_j r_j, K the total of the precisions P_j."""
    if isinstance(parts, Scalar):
        return ((parts.v * r[0]).sum(axis=axis) / total.v,)
    assert isinstance(total, PairPrecision)
    second = parts.v * (r[1] + parts.g * r[0])
    # Differences of slopes: applying K⁻¹ to P_j r_j would subtract numbers 1/(1 - rho²) times the result.
    first = (parts.w * r[0] + (parts.g - total.g) * second).sum(axis=axis)
    mean = first / total.w
    return (mean, second.sum(axis=axis) / total.v - total.g * mean)


def weighted_mean_of_rows(parts: Precision, total: Precision, rows: Array) -> Vector:
    """Return K⁻¹ sum_j P_j r_j for many constant vectors."""
    if isinstance(parts, Scalar):
        return (rows[0] @ parts.v / total.v,)
    assert isinstance(total, PairPrecision)
    # The weights of `weighted_mean`, applied to all vectors by one product of matrices each.
    cross = parts.v * parts.g
    apart = parts.g - total.g
    first = rows[0] @ (parts.w + apart * cross) + rows[1] @ (apart * parts.v)
    second = rows[0] @ cross + rows[1] @ parts.v
    mean = first / total.w
    return (mean, second / total.v - total.g * mean)


def gram(spread: Sequence[Array]) -> Block:
    """C'C for columns (q, J, W) per parameter, as a block: residual sums keep a near-singular one exact."""
    first = np.einsum("qjw,qjw->jw", spread[0], spread[0])
    if len(spread) == 1:
        return Scalar(first)
    cross = np.einsum("qjw,qjw->jw", spread[0], spread[1])
    # A variance that underflows leaves nothing to regress on.
    slope = np.divide(cross, first, out=np.zeros_like(cross), where=first > 0)
    left = spread[1] - slope * spread[0]
    return Pair(first, slope, np.einsum("qjw,qjw->jw", left, left))


def spread_over(part: Block, shape: tuple[int, int]) -> Block:
    """Repeat a block along the axes of a shape."""
    if isinstance(part, Scalar):
        return Scalar(np.broadcast_to(part.v, shape))
    return Pair(*(np.broadcast_to(getattr(part, name), shape) for name in ("v", "g", "w")))


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
