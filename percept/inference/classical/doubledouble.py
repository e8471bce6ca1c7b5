"""Pairs of doubles (high + low, some 106 bits), for whole arrays at once.

The error-free sum is Knuth's, the error-free product Dekker's with Veltkamp's splitting; numpy has no fused
multiply-add to shorten it. Values are kept within 1 in size by the caller, so nothing here overflows.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Pair: TypeAlias = tuple[Array, Array]

_SPLITTER = 2.0**27 + 1.0


def two_sum(a: Array, b: Array) -> Pair:
    """Return a + b and its rounding error, exactly."""
    s = a + b
    virtual = s - a
    return s, (a - (s - virtual)) + (b - virtual)


def square(a: Pair) -> Pair:
    """Return the square of a pair; relative error a few 2**-106."""
    product, error = _two_product(a[0], a[0])
    return _normalised(product, error + 2.0 * a[0] * a[1])


def subtract(a: Pair, b: Pair) -> Pair:
    """Return a − b; the error is a few 2**-106 of the larger of the two."""
    high, error = two_sum(a[0], -b[0])
    return _normalised(high, error + (a[1] - b[1]))


def divide(a: Pair, count: int) -> Pair:
    """Return a / count; relative error a few 2**-106."""
    divisor = np.float64(count)
    quotient = a[0] / divisor
    product, error = _two_product(quotient, np.broadcast_to(divisor, quotient.shape))
    remainder = ((a[0] - product) - error) + a[1]
    return _normalised(quotient, remainder / divisor)


def total(a: Pair) -> Pair:
    """Sum a pair over its last axis, by halving: the error is 2·log2(n)·2**-106 of the sum of sizes."""
    high, low = a
    while high.shape[-1] > 1:
        count = high.shape[-1]
        half = count // 2
        s, error = two_sum(high[..., :half], high[..., half : 2 * half])
        s, error = _normalised(s, error + (low[..., :half] + low[..., half : 2 * half]))
        if count % 2:
            s = np.concatenate([s, high[..., -1:]], axis=-1)
            error = np.concatenate([error, low[..., -1:]], axis=-1)
        high, low = s, error
    return high[..., 0], low[..., 0]


def _normalised(high: Array, low: Array) -> Pair:
    s = high + low
    return s, low - (s - high)


def _two_product(a: Array, b: Array) -> Pair:
    product = a * b
    a_high, a_low = _split(a)
    b_high, b_low = _split(b)
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _split(a: Array) -> Pair:
    shifted = _SPLITTER * a
    high = shifted - (shifted - a)
    return high, a - high
