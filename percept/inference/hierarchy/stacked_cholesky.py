"""Cholesky factors of stacks of matrices, draws first.

Matrices are (W, Q, Q) and vectors (W, Q). numpy stacks them so, and LAPACK factors each matrix by
itself: this suits matrices of many rows. `small_cholesky` does the same with draws last, and suits
matrices of a few rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["stacked_factor", "stacked_solve_lower", "stacked_solve_upper"]

Array = NDArray[np.float64]


def stacked_factor(matrices: Array) -> Array:
    """Lower factors of matrices (W, Q, Q), NaN where rounding left no positive definite one.

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


def stacked_solve_lower(factor: Array, right: Array) -> Array:
    """Solve L x = right for lower factors (W, Q, Q) and vectors (W, Q)."""
    x = right.copy()
    size = x.shape[1]
    for i in range(size):
        row = factor[:, i, :i]
        before = x[:, :i]
        solved = np.einsum("wk,wk->w", row, before)
        remaining = x[:, i] - solved
        x[:, i] = remaining / factor[:, i, i]
    return x


def stacked_solve_upper(factor: Array, right: Array) -> Array:
    """Solve L'x = right."""
    x = right.copy()
    size = x.shape[1]
    for i in reversed(range(size)):
        next_row = i + 1
        column = factor[:, next_row:, i]
        after = x[:, next_row:]
        solved = np.einsum("wk,wk->w", column, after)
        remaining = x[:, i] - solved
        x[:, i] = remaining / factor[:, i, i]
    return x
