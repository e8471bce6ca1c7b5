"""Whether a value lies in the central range of all users: a confidence for one normal quantity.

The central range of a population N(μ, σ²) is μ ± zσ with z the (1 + level)/2 quantile of a
standard normal. For a value x let δ = (x − μ)/σ. The pivot √n(x − x̄)/s has a noncentral t law with
ν = n − 1 and noncentrality √n·δ; read as a law of δ, it puts on |δ| ≤ z the confidence

    E[Φ(√n(z − d·w)) − Φ(√n(−z − d·w))],   d = |x − x̄|/s,   ν·w² ~ χ²_ν.

A value at the edge of the range gets a confidence of c or more in at most 1 − c of studies.
SciPy's noncentral t gives NaN where its tail is small, so the expectation is a sum over w here.
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

#: Probability of w beyond either end of the sum.
_NEGLIGIBLE = 1e-16
#: Standard errors about the edge of the range within which Φ goes from 0 to 1.
_STEP = 8.0
#: SDs; a value nearer to the mean counts as this far.
_LEAST_DISTANCE = 1e-30
#: Nodes of each of four pieces: 12 digits from n = 2 to 1,000.
_NODES = 96

_legendre = cache(np.polynomial.legendre.leggauss)


def central_range_confidence(
    value: ArrayLike, users: Moments, *, level: float = 0.99
) -> FloatOrArray:
    """Work out the confidence that a value lies in the central range of all users.

    Parameters
    ----------
    value : array_like
        What is displayed, on the scale of `users`: the logarithm under the lognormal family.
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
    sd = np.asarray(users.sd, dtype=np.float64)
    if np.any(sd <= 0.0):
        raise RefusalError("All users set the same value, so their range has no width.")
    distance = np.abs(np.asarray(value, dtype=np.float64) - users.mean) / sd
    distance, n = np.broadcast_arrays(distance, np.asarray(users.n, dtype=np.float64))
    root_n = np.sqrt(n)[..., None]
    w, weights = _sd_ratios(edge, distance, n)
    shift = distance[..., None] * w
    held = special.ndtr(root_n * (edge - shift)) - special.ndtr(root_n * (-edge - shift))
    return plain(np.minimum((weights * held).sum(axis=-1), 1.0))


def _sd_ratios(
    edge: float, distance: NDArray[np.float64], n: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ratios w = s/σ, on a new last axis, and their probabilities; dense where Φ steps."""
    nu = n - 1.0
    lowest = np.sqrt(special.chdtri(nu, 1.0 - _NEGLIGIBLE) / nu)
    highest = np.sqrt(special.chdtri(nu, _NEGLIGIBLE) / nu)
    # At a distance of zero the step is nowhere: far off is the same.
    distance = np.maximum(distance, _LEAST_DISTANCE)
    centre = edge / distance
    reach = _STEP / (np.sqrt(n) * distance)
    cuts = [np.clip(cut, lowest, highest) for cut in (centre - reach, centre, centre + reach)]
    ends = np.stack([lowest, *cuts, highest], axis=-1)
    nodes, node_weights = _legendre(_NODES)
    half = 0.5 * np.diff(ends)[..., None]
    middle = 0.5 * (ends[..., 1:] + ends[..., :-1])[..., None]
    w = (middle + half * nodes).reshape(*n.shape, -1)
    lengths = (half * node_weights).reshape(w.shape)
    nu = nu[..., None]
    # The density of w, by its logarithm: its factors overflow from n = 300 on.
    log_constant = 0.5 * nu * np.log(0.5 * nu) - special.gammaln(0.5 * nu) + np.log(2.0)
    density = np.exp(log_constant + special.xlogy(nu - 1.0, w) - 0.5 * nu * w**2)
    return w, lengths * density
