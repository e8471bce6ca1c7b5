"""Polynomials on pieces of a range, in a form whose coefficients bound them.

On a piece a polynomial of degree n is the form Σ cᵢ(1 − t)^(n−i)tⁱ, with t from 0 to 1 along the
piece. Its Bernstein coefficients are cᵢ/binom(n, i), and the least of them is a lower bound: where
all are positive, so is the polynomial on the whole piece.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from percept.haptics.arrays import FloatArray, Scalars

__all__ = ["Form", "as_form"]


class Form:
    """A polynomial on each of many pieces; a number, or one per piece, acts as a constant."""

    # An array to the left of an operator leaves the operation to this class.
    __array_ufunc__ = None

    def __init__(self, coefficients: FloatArray) -> None:
        #: (degree + 1, pieces), or (degree + 1, 1) where all pieces have the same.
        self.coefficients = coefficients

    @property
    def size(self) -> int:
        """Number of coefficients, one more than the degree."""
        return len(self.coefficients)

    def __add__(self, other: Form | Scalars) -> Form:
        other = as_form(other)
        size = max(self.size, other.size)
        return Form(self.elevated(size) + other.elevated(size))

    def __mul__(self, other: Form | Scalars) -> Form:
        if not isinstance(other, Form):
            return Form(self.coefficients * other)
        if self.size < other.size:
            return other * self
        pieces = max(self.coefficients.shape[1], other.coefficients.shape[1])
        product = np.zeros((self.size + other.size - 1, pieces))
        for i, coefficient in enumerate(other.coefficients):
            product[i : i + self.size] += coefficient * self.coefficients
        return Form(product)

    def __sub__(self, other: Form | Scalars) -> Form:
        return self + -1.0 * other

    def __rsub__(self, other: Scalars) -> Form:
        return -1.0 * self + other

    def __truediv__(self, divisor: FloatArray) -> Form:
        return Form(self.coefficients / divisor)

    __radd__ = __add__
    __rmul__ = __mul__

    def elevated(self, size: int) -> FloatArray:
        """Return the same polynomial in `size` coefficients: a factor (1 − t) + t is one."""
        if size == self.size:
            return self.coefficients
        unit = Form(_binomials(size - self.size))
        return (self * unit).coefficients

    def bernstein(self, size: int) -> FloatArray:
        """Return `size` Bernstein coefficients."""
        return self.elevated(size) / _binomials(size - 1)


def as_form(value: Form | Scalars) -> Form:
    """Return a form as it is, and numbers as a constant."""
    if isinstance(value, Form):
        return value
    return Form(np.atleast_1d(value)[None])


@cache
def _binomials(degree: int) -> FloatArray:
    """Return binom(degree, i) as a column."""
    row = [float(comb(degree, i)) for i in range(degree + 1)]
    return np.array(row)[:, None]
