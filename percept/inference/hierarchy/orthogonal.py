"""Regression on standard normal latents by orthogonal steps, for many sets of scales at once.

With y | xi ~ N(A xi, I) and xi ~ N(0, I), the density of y and the law of xi given y come from
the triangular factor R of the stacked matrix [[I], [A]]:

    R'R = I + A'A,    y'(I + AA')⁻¹y = squares of [[0], [y]] about their fit,
    mean of xi given y = R⁻¹ × coefficients,    covariance of xi given y = R⁻¹R'⁻¹

Modified Gram-Schmidt with the target y carried along is backward stable for this. Normal equations,
and Woodbury's identity, subtract large numbers instead.

There are q latents, M rows of y and W sets of scales; the scales are the last axis of every array.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

__all__ = ["Factored", "factor"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Factored:
    """Result of `factor`."""

    log_determinant: Array  # (W,) log det(I + A'A)
    distance: Array  # (W,) y'(I + AA')⁻¹y, a sum of squares
    triangle: Array  # (q, q, W) R, upper triangular
    coefficients: Array  # (q, W) R times the mean of xi given y

    def solve(self, right: Array) -> Array:
        """Solve R x = right for x, `right` of shape (q, ..., W)."""
        solution = self._copied(right)
        for i in reversed(range(len(solution))):
            solution[i] /= self.triangle[i, i]
            for k in range(i):
                solution[k] -= self.triangle[k, i] * solution[i]
        return solution

    def solve_transposed(self, right: Array) -> Array:
        """Solve R'x = right for x, `right` of shape (q, ..., W)."""
        solution = self._copied(right)
        for i in range(len(solution)):
            solution[i] /= self.triangle[i, i]
            for k in range(i + 1, len(solution)):
                solution[k] -= self.triangle[i, k] * solution[i]
        return solution

    def _copied(self, right: Array) -> Array:
        """Copy of a right side, one for each set of scales."""
        width = self.triangle.shape[-1]
        shape = (*right.shape[:-1], width)
        return np.array(np.broadcast_to(right, shape))

    @property
    def mean(self) -> Array:
        """Mean of xi given y, (q, W)."""
        return self.solve(self.coefficients)


def factor(design: Array, target: Array) -> Factored:
    """Factor [[I], [A]] and project [[0], [y]] on its columns.

    Parameters
    ----------
    design : ndarray
        Columns of A, shape (q, M, W).
    target : ndarray
        y, shape (M, W).

    Returns
    -------
    Factored
    """
    size, rows, width = design.shape
    # The target is the last column.
    work = np.zeros((size + 1, size + rows, width))
    work[:size, size:] = design
    work[size, size:] = target
    # The identity is flipped: column i of what is left is zero above row size - 1 - i, always.
    latents = np.arange(size)
    work[latents, size - 1 - latents] = 1.0
    triangle = np.zeros((size, size, width))
    coefficients = np.empty((size, width))
    squares = np.empty((size, width))
    for i in range(size):
        first_row = size - 1 - i
        column = work[i, first_row:]
        later = work[i + 1 :, first_row:]
        np.einsum("mw,mw->w", column, column, out=squares[i])
        norm = np.sqrt(squares[i], out=triangle[i, i])
        column /= norm
        shares = np.einsum("mw,kmw->kw", column, later)
        later -= shares[:, None] * column
        triangle[i, i + 1 :] = shares[:-1]
        coefficients[i] = shares[-1]
    residual = work[size]
    return Factored(
        log_determinant=np.log(squares).sum(axis=0),
        distance=np.einsum("mw,mw->w", residual, residual),
        triangle=triangle,
        coefficients=coefficients,
    )
