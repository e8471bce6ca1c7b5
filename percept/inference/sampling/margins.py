"""A monotone spline per coordinate, from standard normal values to values of a sample.

The spline takes the normal quantiles at its knots to the quantiles of the sample. Where these
differ from a straight line by chance alone the spline is that line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

__all__ = ["Spline"]

Array = NDArray[np.float64]

#: Last knot, in SDs: quantiles beyond it are single draws.
_REACH = 3.0
#: Knots per SD, a power of two: finding the piece rounds nothing.
_PER_UNIT = 2
_KNOTS = np.arange(-_REACH * _PER_UNIT, _REACH * _PER_UNIT + 1) / _PER_UNIT
#: Outside the knots the map goes on with this multiple of the last piece's rise, and bends away by
#: _BEND times that rise: a sample says little there, and too wide costs little.
_WIDER = 1.5
_BEND = 1.0
#: Knots that straight lines follow, in SDs: their quantiles err least.
_MIDDLE = 1.5
#: Mean square of departures from the line, in standard errors, that is believed in full.
_SETTLED = 4.0
#: Least rise of a piece, as a fraction of the sample's range: tied quantiles would make it flat.
_LEAST_RISE = 1e-6
#: Least rise where all values are one: a rise of zero has no logarithm.
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Spline:
    """Monotone cubic pieces between evenly spaced knots, one function per coordinate."""

    coefficients: Array  # (d, pieces, 4) Of 1, t, t², t³ on every piece, t in [0, 1]

    @classmethod
    def fit(cls, points: Array, effective: float) -> Self:
        """Fit to a sample (N, d) that is worth a number of independent draws."""
        quantiles = np.quantile(points, special.ndtr(_KNOTS), axis=0)
        values = _settled(quantiles, effective).T
        span = np.ptp(values, axis=1, keepdims=True)
        least_rise = _LEAST_RISE * span + _TINY
        rise = np.maximum(np.diff(values, axis=1), least_rise)
        first = rise[:, :1]
        last = rise[:, -1:]
        nothing = np.zeros_like(first)
        climbed = np.cumsum(rise, axis=1)
        knots = values[:, :1] + np.hstack([nothing, climbed])
        # Harmonic means of neighbouring rises keep the pieces monotone (Fritsch and Butland 1984).
        before = rise[:, :-1]
        after = rise[:, 1:]
        inner = 2.0 * before * after / (before + after)
        left = np.hstack([first, inner])
        right = np.hstack([inner, last])
        # The piece below the knots ends at the first of them with the slope _WIDER * first.
        below = (
            knots[:, :1] - (_WIDER + _BEND) * first,
            (_WIDER + 2.0 * _BEND) * first,
            -_BEND * first,
            nothing,
        )
        between = (
            knots[:, :-1],
            left,
            3.0 * rise - 2.0 * left - right,
            left + right - 2.0 * rise,
        )
        above = (
            knots[:, -1:],
            _WIDER * last,
            _BEND * last,
            nothing,
        )
        pieces = [np.stack(part, axis=2) for part in (below, between, above)]
        return cls(np.hstack(pieces))

    def __call__(self, y: Array) -> tuple[Array, Array]:
        """Values at y (d, N), and the log of the product of the derivatives, shape (N,)."""
        size, pieces, _ = self.coefficients.shape
        t = y * _PER_UNIT
        t += _REACH * _PER_UNIT + 1.0
        piece = np.clip(t, 0.0, pieces - 1.0)
        index = piece.astype(np.intp)
        t -= index
        index += pieces * np.arange(size)[:, None]
        table = self.coefficients.reshape(-1, 4)
        taken = np.take(table, index, axis=0, mode="clip")
        c0, c1, c2, c3 = np.moveaxis(taken, -1, 0)
        # c0 + t (c1 + t (c2 + t c3)) and its derivative c1 + t (2 c2 + 3 t c3), in place.
        c3 *= t
        slope = (c2 + 1.5 * c3) * (2.0 * t) + c1
        value = ((c2 + c3) * t + c1) * t + c0
        log_slopes = np.log(slope).sum(axis=0)
        return value, log_slopes + size * np.log(_PER_UNIT)


def _settled(values: Array, effective: float) -> Array:
    """Draw quantiles (K, d) at the knots towards straight lines, as far as chance explains them.

    The extreme quantiles of a few hundred draws err by half an SD, and many coordinates err
    together.
    """
    middle = np.abs(_KNOTS) <= _MIDDLE
    knots = _KNOTS[middle]
    inner = values[middle]
    sd = knots @ inner / (knots @ knots)
    line = inner.mean(axis=0) + sd * _KNOTS[:, None]
    tail = special.ndtr(_KNOTS)
    density = np.exp(-0.5 * _KNOTS**2)
    density /= np.sqrt(2.0 * np.pi)
    variance = tail * (1.0 - tail) / effective
    error = np.sqrt(variance) / density
    departure = values - line
    with np.errstate(divide="ignore", invalid="ignore"):
        standard = departure / (sd * error[:, None])
        square = np.square(standard).mean(axis=0)
        share = (square - 1.0) / (_SETTLED - 1.0)
        share = np.clip(share, 0.0, 1.0)
    # A coordinate without scatter keeps its quantiles.
    share = np.nan_to_num(share, nan=1.0)
    return np.asarray(line + share * departure)
