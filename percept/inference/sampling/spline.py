"""Monotone splines from standard normal coordinates to the quantiles of a sample."""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]
_REACH = 3.0
_KNOTS = np.linspace(-_REACH, _REACH, 13)
_WIDER, _BEND = 1.5, 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Spline:
    """Monotone cubic pieces between evenly spaced knots, one function per coordinate; straight outside."""

    coefficients: Array  # (d, pieces, 4) Of 1, t, t², t³ on every piece, t in [0, 1]

    @classmethod
    def fit(cls, points: Array) -> Self:
        """Take standard normal quantiles to those of a sample (N, d)."""
        values = np.quantile(points, special.ndtr(_KNOTS), axis=0).T
        # Tied quantiles would make the map flat.
        rise = np.maximum(np.diff(values, axis=1), 1e-6 * np.ptp(values, axis=1, keepdims=True) + 1e-300)
        knots = values[:, :1] + np.concatenate([np.zeros_like(rise[:, :1]), np.cumsum(rise, axis=1)], 1)
        # Harmonic means of neighbouring slopes keep the pieces monotone (Fritsch and Butland 1984).
        inner = 2.0 * rise[:, :-1] * rise[:, 1:] / (rise[:, :-1] + rise[:, 1:])
        left = np.concatenate([rise[:, :1], inner], axis=1)
        right = np.concatenate([inner, rise[:, -1:]], axis=1)
        # Outside, distances grow by slope and square: a sample says little there, and too wide costs little.
        first, last = rise[:, :1], rise[:, -1:]
        none = np.zeros_like(first)
        reach = _WIDER + _BEND
        return cls(
            np.stack(
                [
                    np.concatenate([knots[:, :1] - reach * first, knots], axis=1),
                    np.concatenate([(reach + _BEND) * first, left, _WIDER * last], axis=1),
                    np.concatenate([-_BEND * first, 3.0 * rise - 2.0 * left - right, _BEND * last], axis=1),
                    np.concatenate([none, left + right - 2.0 * rise, none], axis=1),
                ],
                axis=2,
            )
        )

    def __call__(self, y: Array) -> tuple[Array, Array]:
        """Values at y (d, N), and the log of the product of the derivatives, shape (N,)."""
        size, pieces, _ = self.coefficients.shape
        per_unit = (pieces - 2) / (2.0 * _REACH)
        t = y * per_unit
        t += _REACH * per_unit + 1.0
        index = np.clip(t, 0.0, pieces - 1.0).astype(np.intp)
        t -= index
        index += pieces * np.arange(size)[:, None]
        c = np.take(self.coefficients.reshape(-1, 4), index, axis=0, mode="clip")
        c0, c1, c2, c3 = (c[..., power] for power in range(4))
        # The cubic and its derivative, in place: c0 + t (c1 + t (c2 + t c3)) and c1 + t (2 c2 + 3 t c3).
        c3 *= t
        slope = (c2 + 1.5 * c3) * (2.0 * t) + c1
        value = ((c2 + c3) * t + c1) * t + c0
        return value, np.log(slope).sum(axis=0) + size * np.log(per_unit)
