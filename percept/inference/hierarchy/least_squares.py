"""Gaussian latents integrated by orthogonalisation, for many sets of scales at once.

With y | xi ~ N(A xi, I) and xi ~ N(0, I), everything wanted of y and of xi given y comes from the
triangular factor of [[I], [A]]. Modified Gram-Schmidt with the target carried along is backward stable for
this; normal equations, and Woodbury's identity, subtract large numbers instead.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Factored:
    """Result of `factor` for latents of dimension q and W sets of scales."""

    log_determinant: Array  # (W,) log det(I + A'A)
    distance: Array  # (W,) y'(I + AA')⁻¹y, a sum of squares
    triangle: Array  # (q, q, W) Upper triangular R with R'R = I + A'A
    coefficients: Array  # (q, W) R times the conditional mean of xi

    def solve(self, right: Array) -> Array:
        """Solve R x = right for x, `right` of shape (q, ..., W)."""
        return _back_substitute(self.triangle, right)

    def solve_transposed(self, right: Array) -> Array:
        """Solve R'x = right for x, `right` of shape (q, ..., W)."""
        size = self.triangle.shape[0]
        solution = np.array(np.broadcast_to(right, right.shape[:-1] + self.triangle.shape[-1:]))
        for i in range(size):
            solution[i] /= self.triangle[i, i]
            for k in range(i + 1, size):
                solution[k] -= self.triangle[i, k] * solution[i]
        return solution

    @property
    def mean(self) -> Array:
        """Conditional mean of xi, shape (q, W)."""
        return self.solve(self.coefficients)


def _back_substitute(triangle: Array, right: Array) -> Array:
    solution = np.array(np.broadcast_to(right, right.shape[:-1] + triangle.shape[-1:]))
    for i in reversed(range(triangle.shape[0])):
        solution[i] /= triangle[i, i]
        for k in range(i):
            solution[k] -= triangle[k, i] * solution[i]
    return solution


def factor(design: Array, target: Array) -> Factored:
    """Factor [[I], [A]] and project the target, for every set of scales."""
    size, rows, width = design.shape
    # The identity stands upside down, so that what can be other than zero of each column is one stretch.
    work = np.zeros((size + 1, size + rows, width))
    work[:size, size:] = design
    work[size, size:] = target
    work[np.arange(size), size - 1 - np.arange(size)] = 1.0
    triangle = np.zeros((size, size, width))
    coefficients = np.empty((size, width))
    squares = np.empty((size, width))
    for i in range(size):
        column = work[i, size - 1 - i :]
        later = work[i + 1 :, size - 1 - i :]
        np.einsum("mw,mw->w", column, column, out=squares[i])
        norm = np.sqrt(squares[i], out=triangle[i, i])
        column /= norm
        shares = np.einsum("mw,kmw->kw", column, later)
        later -= shares[:, None] * column
        triangle[i, i + 1 :] = shares[:-1]
        coefficients[i] = shares[-1]
    residual = work[size]
    return Factored(
        np.log(squares).sum(axis=0), np.einsum("mw,mw->w", residual, residual), triangle, coefficients
    )
