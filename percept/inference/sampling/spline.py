"""Monotone splines from standard normal coordinates to the quantiles of a sample."""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

__all__ = ["Spline"]

Array = NDArray[np.float64]
_REACH = 3.0
_KNOTS = np.linspace(-_REACH, _REACH, 13)
_WIDER = 1.5


@dataclasses.dataclass(frozen=True, eq=False)
class Spline:
    """Monotone cubic pieces between evenly spaced knots, one function per coordinate; straight outside.

    Attributes
    ----------
    coefficients : ndarray, shape (4, d, pieces)
        Of 1, t, t², t³ on every piece, t in [0, 1].
    """

    coefficients: Array

    @classmethod
    def fit(cls, points: Array) -> Self:
        """Take standard normal quantiles to those of a sample (N, d)."""
        values = np.quantile(points, special.ndtr(_KNOTS), axis=0).T
        # Tied quantiles would make the map flat.
        rise = np.maximum(np.diff(values, axis=1), 1e-6 * np.ptp(values, axis=1, keepdims=True) + 1e-300)
        start = values[:, :1] + np.concatenate(
            [np.zeros_like(rise[:, :1]), np.cumsum(rise, axis=1)[:, :-1]], 1
        )
        # Harmonic means of neighbouring slopes keep the pieces monotone (Fritsch and Butland 1984).
        inner = 2.0 * rise[:, :-1] * rise[:, 1:] / (rise[:, :-1] + rise[:, 1:])
        left = np.concatenate([rise[:, :1], inner], axis=1)
        right = np.concatenate([inner, rise[:, -1:]], axis=1)
        return cls(np.stack([start, left, 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise]))

    def __call__(self, y: Array) -> tuple[Array, Array]:
        """Values at y (d, N), and the log of the product of the derivatives, shape (N,)."""
        size, pieces = self.coefficients.shape[1:]
        per_unit = pieces / (2.0 * _REACH)
        place = (y + _REACH) * per_unit
        inside = np.minimum(np.maximum(place, 0.0), pieces)
        index = np.minimum(inside.astype(np.intp), pieces - 1)
        t = inside - index
        index += pieces * np.arange(size)[:, None]
        c0, c1, c2, c3 = (np.take(c, index) for c in self.coefficients.reshape(4, -1))
        slope = c1 + t * (2.0 * c2 + 3.0 * t * c3)
        outside = place - inside
        # A sample's outermost slope is a guess: rather too wide than too narrow.
        slope = np.where(outside == 0, slope, _WIDER * slope)
        value = c0 + t * (c1 + t * (c2 + t * c3)) + outside * slope
        return value, np.log(slope).sum(axis=0) + size * np.log(per_unit)
