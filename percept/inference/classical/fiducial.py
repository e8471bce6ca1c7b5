"""Inference on the population of n users, without a prior of the analyst.

For n subjects with P quantities, x̄ their mean and S their scatter, a draw of the population is

    Σ ~ inverse Wishart with n + P − 2 degrees of freedom and scale S,   μ | Σ ~ N(x̄, Σ/n).

Every linear combination then has the t and χ² laws with n − 1 degrees of freedom that the classical
intervals have: a share of draws is the confidence of the noncentral t, computed by chance. For one
quantity it is known.

The central range of a population N(μ, σ²) is μ ± zσ with z the (1 + central)/2 quantile of a
standard normal. For a value x let δ = (x − μ)/σ. The pivot √n(x − x̄)/s of n users has a noncentral
t law with ν = n − 1 and noncentrality √n·δ. Read as a law of δ, it puts on |δ| ≤ z the confidence

    E[Φ(√n(z − d·w)) − Φ(√n(−z − d·w))],   d = |x − x̄|/s,   w = s/σ,   ν·w² ~ χ²_ν.

A value at the edge of the range gets a confidence of c or more in at most 1 − c of studies.

SciPy's noncentral t gives NaN where its tail is small. Its upper tail at t is therefore worked out
as E[Φ(δ − t·w)], with δ its noncentrality: Gauss–Legendre quadrature over w. The integrand falls
from 1 to 0 where t·w passes δ. The range of w is cut into four pieces: below that fall, its two
halves, and above it.

Arrays of the values' shape are (...); nodes of w take a further last axis.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.classical.moments import Moments, plain, tail_of
from percept.inference.record import FloatOrArray

Array = NDArray[np.float64]
#: Probability that the sum leaves out at either end of w: rounding is as large.
_NEGLIGIBLE = 1e-16
#: SDs over which Φ goes from 0 to 1: they leave out 6e-16.
_FALL = np.array([-8.0, 0.0, 8.0])
#: Smallest t: keeps δ/t finite for a value at the mean, where the integrand does not fall.
_LEAST_DISTANCE = 1e-30
#: Nodes in each of the four pieces: they give 12 digits from one degree of freedom on.
_NODES = 96
_legendre = cache(np.polynomial.legendre.leggauss)


def central_range_confidence(
    value: ArrayLike,
    users: Moments,
    *,
    central: float = 0.99,
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
    df = n - 1.0
    below_upper_end = noncentral_t_tail(t, df, root_n * edge)
    below_lower_end = noncentral_t_tail(t, df, -root_n * edge)
    confidence = below_upper_end - below_lower_end
    # Rounding may pass one.
    return plain(np.minimum(confidence, 1.0))


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
    positive = np.maximum(t, _LEAST_DISTANCE)
    arguments = np.broadcast_arrays(positive, df, shift)
    limit, freedom, centre = np.stack(arguments, dtype=np.float64)[..., None]
    fall = (centre + _FALL) / limit
    w, weight = _law_of_sd(freedom, fall)
    above = special.ndtr(centre - limit * w)
    return np.asarray(np.average(above, axis=-1, weights=weight))


def tost_power(to_lower: float, to_upper: float, df: float, *, size: float) -> float:
    """Probability that both one-sided t-tests of a mean reject, exact for a normal sample.

    Given w both reject if the sample mean lies between the limits by t·w standard errors; the sum
    over the law of w is Owen's Q.

    Parameters
    ----------
    to_lower, to_upper : float
        Distance of the true mean from either limit in true standard errors, positive inside.
    df : float
        Degrees of freedom of the SD.
    size : float
        Size alpha of each test; above 0 and at most 0.5.

    Returns
    -------
    float
        0 to 1.

    Raises
    ------
    UsageError
        A size out of its range.
    """
    if not 0.0 < size <= 0.5:
        raise UsageError("the size must be above 0 and at most 0.5.", value=size)
    t = max(-float(special.stdtrit(df, size)), _LEAST_DISTANCE)
    # With a larger SD the limits leave no room for a mean.
    most = 0.5 * (to_lower + to_upper) / t
    at_lower = (to_lower + _FALL) / t
    at_upper = (to_upper + _FALL) / t
    cuts = np.concatenate([at_lower, at_upper, [most]])
    w, weight = _law_of_sd(np.array([df]), np.sort(cuts))
    below_upper = special.ndtr(to_upper - t * w)
    below_lower = special.ndtr(t * w - to_lower)
    rejected = np.maximum(below_upper - below_lower, 0.0)
    return float(np.average(rejected, weights=weight))


def _law_of_sd(df: Array, cuts: Array) -> tuple[Array, Array]:
    """Return nodes of w = s/σ and their weights, (..., nodes), piece by piece between cuts.

    Degrees of freedom (..., 1), cuts (..., pieces less one) in order. Weights are the density of w
    times the nodes' own, but for a constant.
    """
    least_square = special.chdtri(df, 1.0 - _NEGLIGIBLE) / df
    largest_square = special.chdtri(df, _NEGLIGIBLE) / df
    lowest = np.sqrt(least_square)
    highest = np.sqrt(largest_square)
    inner = np.clip(cuts, lowest, highest)
    ends = np.concatenate([lowest, inner, highest], axis=-1)
    nodes, weights = _legendre(_NODES)
    half_length = 0.5 * np.diff(ends)[..., None]
    middle = ends[..., :-1, None] + half_length
    by_piece = middle + half_length * nodes
    lengths = half_length * weights
    shape = (*ends.shape[:-1], -1)
    w = by_piece.reshape(shape)
    # The density by its logarithm, zero at w = 1: powers overflow from n = 300 on.
    log_density = special.xlogy(df - 1.0, w) - 0.5 * df * (w**2 - 1.0)
    return w, lengths.reshape(shape) * np.exp(log_density)


def fiducial_draws(
    values: Array,
    count: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Draw means and covariances of the population that subjects come from.

    Parameters
    ----------
    values : ndarray, shape (n, P)
        One row per subject, n at least P + 1; on the scale on which users are normal.
    count : int
        Number of draws D.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    mean : ndarray, shape (D, P)
    covariance : ndarray, shape (D, P, P)

    Raises
    ------
    RefusalError
        Fewer than P + 1 subjects, or values of one quantity that follow from the others exactly.
    """
    n, quantities = values.shape
    if n <= quantities:
        raise RefusalError(
            f"The joint law of {quantities} quantities needs at least {quantities + 1} subjects."
        )
    centre = values.mean(axis=0)
    # Triangular root of the scatter: S = rootᵀ·root.
    root: Array = np.asarray(np.linalg.qr(values - centre, mode="r"))
    rounding = np.finfo(np.float64).eps * np.abs(values).max()
    if np.abs(np.diag(root)).min() <= rounding:
        raise RefusalError("One quantity follows exactly from the others, or does not vary.")
    # Bartlett: lower triangular, χ on the diagonal and normal below.
    freedom = n + quantities - 2 - np.arange(quantities)
    normal = rng.standard_normal((count, quantities, quantities))
    bartlett = np.tril(normal, -1)
    diagonal = np.arange(quantities)
    chi_square = rng.chisquare(freedom, size=(count, quantities))
    bartlett[:, diagonal, diagonal] = np.sqrt(chi_square)
    # Σ = rootᵀ·(B·Bᵀ)⁻¹·root, and a root of it is rootᵀ·B⁻ᵀ.
    inverse = np.linalg.inv(bartlett)
    factor = root.T @ np.swapaxes(inverse, 1, 2)
    covariance = factor @ np.swapaxes(factor, 1, 2)
    noise = rng.standard_normal((count, quantities, 1))
    departure = factor @ noise
    mean = centre + departure[..., 0] / np.sqrt(n)
    return mean, covariance
