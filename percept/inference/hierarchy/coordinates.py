"""Coordinates in which every prior is standard normal.

Each map takes u with a standard normal law to a variable with the stated law, in the form that is
accurate in the tail u lies in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]

#: Beyond this many prior SDs a coordinate has no mass that doubles can weigh: exp(-35²/2) = 1e-266.
LIMIT = 35.0
#: Smallest SD: its square, and the square of that, must not underflow.
_FLOOR = 1e-70
#: Where erfinv(ndtr(u)) begins to lose more than a digit's last unit.
_FAR = 1.5


def half_normal(u: Array, scale: Array | float) -> Array:
    """Map a standard normal to a half-normal by its quantiles."""
    u = np.asarray(u)
    value = np.sqrt(2.0) * special.erfinv(special.ndtr(u))
    # From here on 1 - ndtr(u) has lost digits, and the upper tail's own form is needed.
    far = u > _FAR
    value[far] = -special.ndtri(0.5 * special.ndtr(-u[far]))
    return np.maximum(scale * value, _FLOOR)


def correlation(u: Array, shape: float = 2.0) -> tuple[Array, Array]:
    """Map a standard normal to a correlation with (rho + 1)/2 ~ Beta(shape, shape)."""
    lower = special.ndtr(-np.abs(u))
    if shape == 2.0:
        # The Beta(2, 2) quantile is trigonometric; near the end the angle's distance from pi/6 is kept.
        # 1 - abs(rho) is 2 sin²(angle/2) + sqrt(3) sin(angle).
        sine = np.sin(np.arcsin(np.sqrt(lower)) / 3.0)
        rest = 2.0 * sine * (sine + np.sqrt(3.0 * (1.0 - sine * sine)))
    else:
        rest = 2.0 * _beta_quantile(shape, lower)
    rest = np.minimum(rest, 1.0)
    # rho from its own distance to one: two forms would disagree by 1e-8 near the ends.
    return np.copysign(1.0 - rest, u), np.maximum(rest, _FLOOR)


def _beta_quantile(shape: float, lower: Array) -> Array:
    """Quantile of Beta(shape, shape) at a lower tail; scipy has none for tails far below 1e-100."""
    quantile = np.asarray(special.betaincinv(shape, shape, lower))
    log_first = (np.log(lower) + np.log(shape) + special.betaln(shape, shape)) / shape
    first = np.exp(log_first)
    return np.where(np.isnan(quantile), first * (1.0 + (shape - 1.0) / (shape + 1.0) * first), quantile)
