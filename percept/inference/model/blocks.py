"""Algebra of many small matrices: covariance blocks that do not cancel, and Cholesky factors.

A block holds a 1 x 1 or 2 x 2 covariance for every entry of its axes. The 2 x 2 form is kept as a
regression: the variance v of the leading parameter, the slope g of the other on it and the variance
w left over, so that A = F F' with F = [[1, 0], [g, 1]] diag(√v, √w). Sums, inverses, determinants
and distances then need positive terms only, and a correlation of 1 - 1e-9 keeps the digits that
``v1*v2 - c*c`` would lose.

Cholesky factors have their axes first and draws last, (K, K, ...), and vectors (K, ...). A loop
over rows with whole arrays of draws takes 0.6 to 1 of the time of LAPACK, which needs copies with
the draws first, measured for K from 14 to 128 and 256 draws.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Numbers in the largest temporary of a pass, 2 MB of doubles: more leave the processor's cache.
_NUMBERS = 1 << 18
#: Draws of a pass at the least, where calls of numpy would cost more than arithmetic, and at the
#: most, where calls cost little already.
_FEWEST_DRAWS = 128
_MOST_DRAWS = 2048
#: One array per parameter: the components of a vector for every entry of the trailing axes.
Vector = tuple[Array, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """A covariance of one or two parameters per entry."""

    variances: Vector  # Of the first parameter, and of the second what the first leaves
    slope: Array | None = None  # Of the second on the first; none of one, nor of what is added

    def __getitem__(self, key: Any) -> Block:
        slope = None if self.slope is None else self.slope[key]
        return Block(tuple(part[key] for part in self.variances), slope)

    def __add__(self, other: Block) -> Block:
        """Add a block, or variances of independent parameters."""
        pairs = zip(self.variances, other.variances, strict=True)
        v, *rest = [first + second for first, second in pairs]
        if self.slope is None:
            return Block((v, *rest))
        # Weighted means have no terms that cancel.
        own_share = self.variances[0] / v
        other_share = other.variances[0] / v
        other_slope = 0.0 if other.slope is None else other.slope
        difference = self.slope - other_slope
        between = difference * difference * self.variances[0] * other_share
        slope = self.slope * own_share + other_slope * other_share
        return Block((v, rest[0] + between), slope)

    def scaled(self, factor: Array | float) -> Block:
        """Return the block times a positive number per entry."""
        return Block(tuple(part * factor for part in self.variances), self.slope)

    def log_determinant(self) -> Array:
        """Return the log determinant per entry."""
        return np.asarray(sum(np.log(part) for part in self.variances))

    def solve(self, r: Vector) -> Vector:
        """Return the inverse times a vector."""
        inverses = [1.0 / variance for variance in self.variances]
        if self.slope is None:
            return (r[0] * inverses[0],)
        first, second = self._remainders(r)
        second = second * inverses[1]
        return (first * inverses[0] - self.slope * second, second)

    def _remainders(self, r: Vector) -> Vector:
        """Components of a vector, of the second what the first does not explain."""
        if self.slope is None:
            return r
        first, second = r
        return (first, second - self.slope * first)

    def whiten(self, r: Vector) -> Vector:
        """Return F⁻¹r, where F is the lower factor, FF' = A."""
        pairs = zip(self._remainders(r), self.variances, strict=True)
        return tuple(part / np.sqrt(variance) for part, variance in pairs)

    def distance(self, r: Vector) -> Array:
        """Return r'A⁻¹r per entry, summed over the first axis of r's components."""
        distance: Array | float = 0.0
        for part, variance in zip(self._remainders(r), self.variances, strict=True):
            squares = np.einsum("k...,k...->...", part, part)
            distance = distance + squares / variance
        return np.asarray(distance)

    def factor_columns(self) -> list[Vector]:
        """Return the columns of the lower factor F."""
        roots = [np.sqrt(variance) for variance in self.variances]
        if self.slope is None:
            return [(roots[0],)]
        first = (roots[0], self.slope * roots[0])
        second = (np.zeros_like(roots[0]), roots[1])
        return [first, second]


def block(
    sd: Vector,
    rho: Array | None = None,
    one_minus_size: Array | None = None,
) -> Block:
    """Build a covariance from standard deviations and, for two parameters, their correlation.

    `one_minus_size` is 1 - abs(rho), with the digits that a correlation near one loses.
    """
    variances = tuple(part * part for part in sd)
    if rho is None or one_minus_size is None:
        return Block(variances)
    first, second = variances
    one_plus_size = 1.0 + np.abs(rho)
    unexplained = one_minus_size * one_plus_size  # 1 - rho²
    ratio = sd[1] / sd[0]
    return Block((first, second * unexplained), rho * ratio)


def lower_factor(matrices: Array, least: Array | None = None) -> Array:
    """Lower factors L of matrices LL', (K, K, ...), of which only the lower triangle is read.

    Rows x' below the square, (K + n, K, ...), become (L⁻¹x)'. Rounding may leave no square of a
    pivot below the least, (...).
    """
    factor = np.zeros_like(matrices)
    for i in range(matrices.shape[1]):
        column = matrices[i:, i]
        if i > 0:
            row = factor[i, :i]
            rows_from_here = factor[i:, :i]
            column = column - np.einsum("k...,ik...->i...", row, rows_from_here)
        square = column[0]
        if least is not None:
            square = np.maximum(square, least)
        pivot = np.sqrt(square)
        np.divide(column, pivot, out=factor[i:, i])
    return factor


def solve_lower(factor: Array, right: Array) -> Array:
    """Solve L x = right for lower factors (K, K, ...) and vectors (K, ...)."""
    x = np.empty(np.broadcast_shapes(right.shape, factor.shape[1:]))
    for i in range(len(factor)):
        remaining = right[i]
        if i > 0:
            row = factor[i, :i]
            before = x[:i]
            remaining = remaining - np.einsum("k...,k...->...", row, before)
        np.divide(remaining, factor[i, i], out=x[i])
    return x


def solve_upper(factor: Array, right: Array) -> Array:
    """Solve L'x = right."""
    x = np.empty(np.broadcast_shapes(right.shape, factor.shape[1:]))
    last = len(factor) - 1
    for i in range(last, -1, -1):
        remaining = right[i]
        if i < last:
            next_row = i + 1
            column = factor[next_row:, i]
            after = x[next_row:]
            remaining = remaining - np.einsum("k...,k...->...", column, after)
        np.divide(remaining, factor[i, i], out=x[i])
    return x


def add_to_diagonal(matrices: Array, values: Array | float) -> Array:
    """Add values, (K, ...) or fewer axes, to the diagonals of matrices (K, K, ...), in place."""
    diagonal = np.arange(len(matrices))
    matrices[diagonal, diagonal] += values
    return matrices


def log_diagonal(factor: Array) -> Array:
    """Log determinants of lower factors (K, K, ...)."""
    pivots = np.einsum("ii...->i...", factor)
    logs = np.log(pivots)
    return np.asarray(logs.sum(axis=0))


def draws_at_once(numbers: int) -> int:
    """Draws worked on in one pass, for so many numbers of a draw in the largest temporary."""
    return min(max(_NUMBERS // numbers, _FEWEST_DRAWS), _MOST_DRAWS)
