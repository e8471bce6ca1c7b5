"""Some of many frequencies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def thinned(omega: Array, most: int) -> Array:
    """Return at most so many of the frequencies (M,), both ends among them."""
    kept = np.unique(np.linspace(0, omega.size - 1, min(most, omega.size)).round().astype(int))
    return omega[kept]
