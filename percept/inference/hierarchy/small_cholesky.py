"""Cholesky factors of many small matrices, draws last.

Matrices and vectors have their axes first and draws last, (K, K, ...) and (K, ...). K is a few, so
that a loop over rows with whole arrays of draws is faster than a factor for each draw.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["log_diagonal", "lower_factor", "solve_lower", "solve_upper"]

Array = NDArray[np.float64]


def lower_factor(matrices: Array) -> Array:
    """Lower factors L of matrices LL', (K, K, ...)."""
    factor = np.zeros_like(matrices)
    for i in range(len(matrices)):
        row = factor[i, :i]
        explained = np.einsum("k...,ik...->i...", row, factor[i:, :i])
        column = matrices[i:, i] - explained
        factor[i:, i] = column / np.sqrt(column[0])
    return factor


def solve_lower(factor: Array, right: Array) -> Array:
    """Solve L x = right for lower factors (K, K, ...) and vectors (K, ...)."""
    x = np.empty(np.broadcast_shapes(right.shape, factor.shape[1:]))
    for i in range(len(factor)):
        solved = np.einsum("k...,k...->...", factor[i, :i], x[:i])
        x[i] = (right[i] - solved) / factor[i, i]
    return x


def solve_upper(factor: Array, right: Array) -> Array:
    """Solve L'x = right."""
    x = np.empty(np.broadcast_shapes(right.shape, factor.shape[1:]))
    for i in reversed(range(len(factor))):
        solved = np.einsum("k...,k...->...", factor[i + 1 :, i], x[i + 1 :])
        x[i] = (right[i] - solved) / factor[i, i]
    return x


def log_diagonal(factor: Array) -> Array:
    """Log determinants of lower factors (K, K, ...)."""
    logs = [np.log(factor[i, i]) for i in range(len(factor))]
    return np.asarray(sum(logs))
