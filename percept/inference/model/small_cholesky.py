"""Cholesky factors of many small matrices, draws last.

Matrices and vectors have their axes first and draws last, (K, K, ...) and (K, ...). A loop over
rows with whole arrays of draws is as fast as a factor for each draw by LAPACK, or faster, since
that needs copies with the draws first: `elimination` takes 0.6 to 1 of the time, measured for K
from 14 to 128 and 256 draws.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "log_diagonal",
    "lower_factor",
    "solve_lower",
    "solve_upper",
    "stacked_factor",
    "with_prior",
]

Array = NDArray[np.float64]


def lower_factor(matrices: Array) -> Array:
    """Lower factors L of matrices LL', (K, K, ...), of which only the lower triangle is read.

    Rows x' below the square, (K + n, K, ...), become (L⁻¹x)'.
    """
    factor = np.zeros_like(matrices)
    for i in range(matrices.shape[1]):
        column = matrices[i:, i]
        if i > 0:
            row = factor[i, :i]
            rows_from_here = factor[i:, :i]
            column = column - np.einsum("k...,ik...->i...", row, rows_from_here)
        pivot = np.sqrt(column[0])
        np.divide(column, pivot, out=factor[i:, i])
    return factor


def solve_lower(factor: Array, right: Array) -> Array:
    """Solve L x = right for lower factors (K, K, ...) and vectors (K, ...)."""
    x = _unsolved(factor, right)
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
    x = _unsolved(factor, right)
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


def _unsolved(factor: Array, right: Array) -> Array:
    """Room for the solution, with the axes of right sides that share a factor."""
    one_solution = factor.shape[1:]
    shape = np.broadcast_shapes(right.shape, one_solution)
    return np.empty(shape)


def with_prior(precision: Array) -> Array:
    """Add the precision of a standard normal prior to precisions (K, K, ...)."""
    whole = precision.copy()
    diagonal = np.arange(len(precision))
    whole[diagonal, diagonal] += 1.0
    return whole


def log_diagonal(factor: Array) -> Array:
    """Log determinants of lower factors (K, K, ...)."""
    pivots = np.einsum("ii...->i...", factor)
    logs = np.log(pivots)
    return np.asarray(logs.sum(axis=0))


def stacked_factor(matrices: Array) -> Array:
    """Lower factors of matrices (W, K, K), NaN where rounding left no positive definite one.

    numpy refuses a whole stack if one matrix fails, so the stack is halved until it stands alone.
    """
    try:
        factor = np.linalg.cholesky(matrices)
        return np.asarray(factor)
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full_like(matrices, np.nan)
        halves = np.array_split(matrices, 2)
        factors = [stacked_factor(half) for half in halves]
        return np.concatenate(factors)
