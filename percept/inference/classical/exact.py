"""Sums of doubles and of their squares without any rounding, in any order, chunk by chunk.

A double is an integer of 53 bits times a power of two. Summing the integers apart for each power keeps
every bit: the sum of any number of doubles, and of their squares, is then one exact (long) integer, and the
mean and standard deviation are rounded once, at the end. Offsets, cancellation, denormals, the order of the
data and the way it is cut into chunks cannot matter. It costs about what `math.fsum` does.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.classical.checks import finite_values

_BINS = 2098  # binary exponents of the doubles, -1073 to 1024
_BIAS = 1073
_UNIT = _BIAS + 53  # the sum is held in units of 2**-1126, the sum of squares in units of 2**-2252
_CHUNK = 1 << 15  # products below 1.5 * 2**37, so many times, stay below 2**53: float bins lose nothing
_FOLD = 512  # so many chunks stay below 2**63 in the integer bins
_FEW = 256  # below this, Python's integers are quicker than the bins
_SUM_SHIFTS = (26, 0)
_SQUARE_SHIFTS = (70, 53, 34, 18, 0)


class MomentsAccumulator:
    """Exact running sums of a sample, for data that arrives in chunks.

    Examples
    --------
    >>> whole = MomentsAccumulator()
    >>> for chunk in ([1e15 + 1, 1e15 + 2], [1e15 + 3]):
    ...     whole.update(chunk)
    >>> whole.mean - 1e15, whole.sd
    (2.0, 1.0)
    """

    def __init__(self) -> None:
        self.n = 0
        self._sum = 0
        self._squares = 0

    def update(self, values: ArrayLike) -> None:
        """Add a chunk of values.

        Parameters
        ----------
        values : array_like
            Any shape; finite numbers. An empty chunk adds nothing.

        Raises
        ------
        UsageError
            A value that is not a finite number.
        """
        flat = finite_values(values, allow_empty=True).reshape(-1)
        self.n += flat.size
        if flat.size < _FEW:
            self._add_few(flat)
        else:
            for start in range(0, flat.size, _CHUNK * _FOLD):
                self._add_many(flat[start : start + _CHUNK * _FOLD])

    def merge(self, other: MomentsAccumulator) -> None:
        """Add the sums of another part of the same sample.

        Parameters
        ----------
        other : MomentsAccumulator
            Left as it is.
        """
        self.n += other.n
        self._sum += other._sum
        self._squares += other._squares

    @property
    def mean(self) -> float:
        """Correctly rounded mean of the values so far; a UsageError without any."""
        if self.n == 0:
            raise UsageError("There are no values to average.")
        return self._sum / (self.n << _UNIT)

    @property
    def sd(self) -> float:
        """Correctly rounded standard deviation, divisor n − 1 (Eq. 14); a RefusalError below two values."""
        if self.n < 2:
            raise RefusalError(
                f"A standard deviation needs at least 2 values; there is {self.n}.",
                hint="Add subjects.",
            )
        scatter = self.n * self._squares - self._sum * self._sum
        return _rounded_root(scatter, self.n * (self.n - 1) << 2 * _UNIT)

    def _add_few(self, values: NDArray[np.float64]) -> None:
        for value in values.tolist():
            mantissa, exponent = math.frexp(value)
            whole = int(mantissa * 2.0**53)
            self._sum += whole << (exponent + _BIAS)
            self._squares += whole * whole << 2 * (exponent + _BIAS)

    def _add_many(self, values: NDArray[np.float64]) -> None:
        sums = np.zeros((2, _BINS), dtype=np.int64)
        squares = np.zeros((5, _BINS), dtype=np.int64)
        for start in range(0, values.size, _CHUNK):
            mantissa, exponent = np.frexp(values[start : start + _CHUNK])
            bins = exponent + _BIAS
            high = np.trunc(mantissa * 2.0**27)
            sums[0] += _binned(bins, high)
            sums[1] += _binned(bins, (mantissa * 2.0**27 - high) * 2.0**26)
            for row, product in zip(squares, _square_limbs(mantissa), strict=True):
                row += _binned(bins, product)
        self._sum += _folded(sums, _SUM_SHIFTS, 1)
        self._squares += _folded(squares, _SQUARE_SHIFTS, 2)


def _square_limbs(mantissa: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Split the squares of 53-bit integers into five integers, worth 2**70, 2**53, 2**34, 2**18 and 1."""
    scaled = mantissa * 2.0**18
    high = np.trunc(scaled)
    scaled = (scaled - high) * 2.0**18
    middle = np.trunc(scaled)
    low = (scaled - middle) * 2.0**17
    return high * high, high * middle, middle * middle + 4.0 * high * low, middle * low, low * low


def _binned(bins: NDArray[np.intp], limbs: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.bincount(bins, limbs, minlength=_BINS).astype(np.int64)


def _folded(limbs: NDArray[np.int64], shifts: tuple[int, ...], power: int) -> int:
    """Add up the bins of all exponents as one integer."""
    total = 0
    for row, shift in zip(limbs, shifts, strict=True):
        for exponent in np.flatnonzero(row).tolist():
            total += int(row[exponent]) << (power * exponent + shift)
    return total


def _rounded_root(numerator: int, denominator: int) -> float:
    """Round the square root of a ratio of integers once, to nearest."""
    if numerator == 0:
        return 0.0
    # 64 bits or more of the root, the last one sticky: then the only rounding is that of the division
    half_shift = max(0, (denominator.bit_length() - numerator.bit_length() + 132) // 2)
    quotient, remainder = divmod(numerator << 2 * half_shift, denominator)
    root = math.isqrt(quotient)
    sticky = int(remainder != 0 or root * root != quotient)
    try:
        return (root << 1 | sticky) / (1 << half_shift + 1)
    except OverflowError:
        raise UsageError(
            "The standard deviation is larger than the largest double.", hint="Use a larger unit."
        ) from None
