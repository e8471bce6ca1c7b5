"""Upper quantiles by their tail, which keeps every digit of levels close to one.

These are what `scipy.stats` calls for `isf`, without the second it takes to import.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special


def t_upper(tail: ArrayLike, nu: ArrayLike) -> NDArray[np.float64]:
    """Return the value Student's t exceeds with probability `tail`."""
    return -np.asarray(special.stdtrit(_doubles(nu), _doubles(tail)))


def t_within(t: ArrayLike, nu: ArrayLike) -> NDArray[np.float64]:
    """Return the probability that Student's t lies within ±`t`."""
    nu = _doubles(nu)
    with np.errstate(divide="ignore", over="ignore"):
        # One less twice the tail would lose what a small t holds.
        share = 1.0 / (1.0 + nu / _doubles(t) ** 2)
    return np.asarray(special.betainc(0.5, 0.5 * nu, share))


def normal_upper(tail: ArrayLike) -> NDArray[np.float64]:
    """Return the value a standard normal exceeds with probability `tail`."""
    return -np.asarray(special.ndtri(_doubles(tail)))


def _doubles(values: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
