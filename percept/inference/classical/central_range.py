"""Whether a value lies in the central range of all users: a confidence for one normal quantity.

The central range of a population N(μ, σ²) is μ ± zσ with z the (1 + level)/2 quantile of a
standard normal. For a value x let δ = (x − μ)/σ. The pivot √n(x − x̄)/s of n users has a noncentral
t law with ν = n − 1 and noncentrality √n·δ. Read as a law of δ, it puts on |δ| ≤ z the confidence

    E[Φ(√n(z − d·w)) − Φ(√n(−z − d·w))],   d = |x − x̄|/s,   w = s/σ,   ν·w² ~ χ²_ν.

A value at the edge of the range gets a confidence of c or more in at most 1 − c of studies.
SciPy's noncentral t gives NaN where its tail is small, so the expectation is a sum over w here. The
integrand falls from 1 to 0 where d·w passes z. The sum has four pieces of w: below that fall, its
two halves, and above it. Shapes: (...) is that of the values; nodes of w take a further last axis.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import Moments, plain, tail_of
from percept.inference.record import FloatOrArray

__all__ = ["central_range_confidence"]

Array = NDArray[np.float64]

#: Probability that the sum leaves out at either end of w: rounding is as large.
_NEGLIGIBLE = 1e-16
#: SDs within which Φ goes from 0 to 1: it leaves out 6e-16.
_STEP = 8.0
#: Smallest d: keeps z/d finite for a value at the mean, where the integrand does not fall.
_LEAST_DISTANCE = 1e-30
#: Nodes in each of the four pieces: they give 12 digits from n = 2 to 1,000.
_NODES = 96

_legendre = cache(np.polynomial.legendre.leggauss)


def central_range_confidence(
    value: ArrayLike, users: Moments, *, level: float = 0.99
) -> FloatOrArray:
    """Work out the confidence that a value lies in the central range of all users.

    Parameters
    ----------
    value : array_like
        What is displayed, on the scale of `users`: the logarithm in the lognormal family.
    users : Moments
        Mean, SD and number n of the users, at least 2; broadcasts against `value`.
    level : float
        Share of all users that the central range holds; 0 to 1, exclusive.

    Returns
    -------
    float or ndarray
        Between 0 and 1, of the broadcast shape; a float where every argument is a single number.

    Raises
    ------
    RefusalError
        Where all users are equal: the range has no width then.
    UsageError
        A level outside (0, 1).
    """
    edge = -special.ndtri(0.5 * tail_of(level))
    value = np.asarray(value, dtype=np.float64)
    sd = np.asarray(users.sd, dtype=np.float64)
    n = np.asarray(users.n, dtype=np.float64)
    if np.any(sd <= 0.0):
        raise RefusalError("All users set the same value, so their range has no width.")
    distance = np.abs(value - users.mean) / sd
    distance, n = np.broadcast_arrays(distance, n)
    distance = distance[..., None]
    n = n[..., None]
    w, lengths = _nodes(edge, distance, n)
    probability = lengths * _density(w, n - 1.0)
    root_n = np.sqrt(n)
    below_upper_end = special.ndtr(root_n * (edge - distance * w))
    below_lower_end = special.ndtr(root_n * (-edge - distance * w))
    confidence = np.sum(probability * (below_upper_end - below_lower_end), axis=-1)
    return plain(np.minimum(confidence, 1.0))


def _nodes(edge: float, distance: Array, n: Array) -> tuple[Array, Array]:
    """Return nodes of w and the length that each stands for, (..., nodes), from d, n (..., 1)."""
    nu = n - 1.0
    lowest = np.sqrt(special.chdtri(nu, 1.0 - _NEGLIGIBLE) / nu)
    highest = np.sqrt(special.chdtri(nu, _NEGLIGIBLE) / nu)
    distance = np.maximum(distance, _LEAST_DISTANCE)
    fall = edge / distance
    half_width = _STEP / (np.sqrt(n) * distance)
    cuts = np.concatenate([fall - half_width, fall, fall + half_width], axis=-1)
    cuts = np.clip(cuts, lowest, highest)
    ends = np.concatenate([lowest, cuts, highest], axis=-1)
    nodes, weights = _legendre(_NODES)
    half_length = 0.5 * np.diff(ends)[..., None]
    middle = ends[..., :-1, None] + half_length
    shape = (*ends.shape[:-1], -1)
    w = middle + half_length * nodes
    lengths = half_length * weights
    return w.reshape(shape), lengths.reshape(shape)


def _density(w: Array, nu: Array) -> Array:
    """Density of w = s/σ with ν degrees of freedom."""
    half_nu = 0.5 * nu
    # By its logarithm: the factors overflow from n = 300 on.
    log_constant = np.log(2.0) + half_nu * np.log(half_nu) - special.gammaln(half_nu)
    log_power = special.xlogy(nu - 1.0, w)
    log_exponential = -half_nu * w**2
    return np.exp(log_constant + log_power + log_exponential)
