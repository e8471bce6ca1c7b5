"""Algebra of many 2 x 2 matrices, one for each of W draws.

`small_cholesky` serves any size; here every formula is written out, which is faster for two.
Entries have shape (W,) and vectors (2, W).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

__all__ = ["Lower", "Symmetric"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Lower:
    """Lower triangular matrices L."""

    l11: Array
    l21: Array
    l22: Array

    def solve(self, right: Array) -> Array:
        """L^(-1) times vectors."""
        x = np.empty_like(right)
        x[0] = right[0] / self.l11
        remaining = right[1] - self.l21 * x[0]
        x[1] = remaining / self.l22
        return x

    def solve_transposed(self, right: Array) -> Array:
        """L'^(-1) times vectors."""
        x = np.empty_like(right)
        x[1] = right[1] / self.l22
        remaining = right[0] - self.l21 * x[1]
        x[0] = remaining / self.l11
        return x


@dataclasses.dataclass(frozen=True, eq=False)
class Symmetric:
    """Symmetric matrices, positive definite wherever a root or a solution is asked for."""

    s11: Array
    s12: Array
    s22: Array

    def plus_identity(self, factor: Array) -> Symmetric:
        """Sum with the identity matrix times a factor (W,)."""
        return Symmetric(self.s11 + factor, self.s12, self.s22 + factor)

    def determinant(self) -> Array:
        """Return the determinants."""
        product = self.s11 * self.s22
        return product - self.s12 * self.s12

    def root(self) -> Symmetric:
        """Symmetric square root of a matrix D: (D + √det(D) I) / √(trace(D) + 2 √det(D))."""
        root_determinant = np.sqrt(self.determinant())
        trace = self.s11 + self.s22
        scale = 1.0 / np.sqrt(trace + 2.0 * root_determinant)
        shifted = self.plus_identity(root_determinant)
        return Symmetric(
            s11=shifted.s11 * scale,
            s12=shifted.s12 * scale,
            s22=shifted.s22 * scale,
        )

    def solve(self, right: Array) -> Array:
        """Inverse times vectors."""
        determinant = self.determinant()
        x = np.empty_like(right)
        x[0] = self.s22 * right[0] - self.s12 * right[1]
        x[1] = self.s11 * right[1] - self.s12 * right[0]
        return x / determinant
