"""Whether a value lies in the central range of all users: a confidence for one normal quantity.

The central range of a population N(μ, σ²) is μ ± zσ with z the (1 + central)/2 quantile of a
standard normal. For a value x let δ = (x − μ)/σ. The pivot √n(x − x̄)/s of n users has a noncentral
t law with ν = n − 1 and noncentrality √n·δ. Read as a law of δ, it puts on |δ| ≤ z the confidence

    E[Φ(√n(z − d·w)) − Φ(√n(−z − d·w))],   d = |x − x̄|/s,   w = s/σ,   ν·w² ~ χ²_ν.

A value at the edge of the range gets a confidence of c or more in at most 1 − c of studies.
SciPy's noncentral t gives NaN where its tail is small, so its upper tail at t, E[Φ(δ − t·w)] with
noncentrality δ, is a sum over w here. The integrand falls from 1 to 0 where t·w passes δ. The sum
has four pieces of w: below that fall, its two halves, and above it. Shapes: (...) is that of the
values; nodes of w take a further last axis.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import Moments, plain, tail_of
from percept.inference.record import FloatOrArray

__all__ = ["central_range_confidence", "noncentral_t_tail"]

Array = NDArray[np.float64]

#: Probability that the sum leaves out at either end of w: rounding is as large.
_NEGLIGIBLE = 1e-16
#: SDs within which Φ goes from 0 to 1: it leaves out 6e-16.
_STEP = 8.0
#: Smallest t: keeps δ/t finite for a value at the mean, where the integrand does not fall.
_LEAST_DISTANCE = 1e-30
#: Nodes in each of the four pieces: they give 12 digits from one degree of freedom on.
_NODES = 96

_legendre = cache(np.polynomial.legendre.leggauss)


def central_range_confidence(
    value: ArrayLike, users: Moments, *, central: float = 0.99
) -> FloatOrArray:
    """Work out the confidence that a value lies in the central range of all users.

    Parameters
    ----------
    value : array_like
        What is displayed, on the scale of `users`: the logarithm in the lognormal family.
    users : Moments
        Mean, SD and number n of the users, at least 2; broadcasts against `value`.
    central : float
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
        A share outside (0, 1).
    """
    edge = -special.ndtri(0.5 * tail_of(central, "central"))
    value = np.asarray(value, dtype=np.float64)
    sd = np.asarray(users.sd, dtype=np.float64)
    n = np.asarray(users.n, dtype=np.float64)
    if np.any(sd <= 0.0):
        raise RefusalError("All users set the same value, so their range has no width.")
    root_n = np.sqrt(n)
    t = root_n * np.abs(value - users.mean) / sd
    below_upper_end = noncentral_t_tail(t, n - 1.0, root_n * edge)
    below_lower_end = noncentral_t_tail(t, n - 1.0, -root_n * edge)
    return plain(np.minimum(below_upper_end - below_lower_end, 1.0))


def noncentral_t_tail(t: ArrayLike, df: ArrayLike, shift: ArrayLike) -> Array:
    """Return the probability that a noncentral t exceeds a value.

    Parameters
    ----------
    t : array_like
        The value; zero or more.
    df : array_like
        Degrees of freedom, 1 or more.
    shift : array_like
        Noncentrality, of either sign.

    Returns
    -------
    ndarray
        Of the broadcast shape, never NaN.
    """
    values = np.broadcast_arrays(np.maximum(t, _LEAST_DISTANCE), df, shift)
    columns = [np.asarray(value, dtype=np.float64)[..., None] for value in values]
    limit, freedom, centre = columns
    w, lengths = _nodes(limit, freedom, centre)
    probability = lengths * _density(w, freedom)
    total = np.sum(probability, axis=-1)
    above = np.sum(probability * special.ndtr(centre - limit * w), axis=-1)
    return np.asarray(above / total)


def _nodes(t: Array, df: Array, shift: Array) -> tuple[Array, Array]:
    """Return nodes of w and the length that each stands for, (..., nodes), from fields (..., 1)."""
    lowest = np.sqrt(special.chdtri(df, 1.0 - _NEGLIGIBLE) / df)
    highest = np.sqrt(special.chdtri(df, _NEGLIGIBLE) / df)
    fall = shift / t
    half_width = _STEP / t
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


def _density(w: Array, df: Array) -> Array:
    """Density of w = s/σ with so many degrees of freedom, but for a constant; 1 at w = 1."""
    # By its logarithm: powers overflow from n = 300 on.
    return np.exp(special.xlogy(df - 1.0, w) - 0.5 * df * (w**2 - 1.0))
