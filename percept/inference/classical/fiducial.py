"""Populations that subjects' means and scatter leave likely, without a prior of the analyst's.

For n subjects with P quantities, x̄ their mean and S their scatter, a draw is

    Σ ~ inverse Wishart with n + P − 2 degrees of freedom and scale S,   μ | Σ ~ N(x̄, Σ/n).

Every linear combination then has the t and χ² laws with n − 1 degrees of freedom that the classical
intervals have: a share of draws is the confidence of the noncentral t, computed by chance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError

__all__ = ["FiducialDraws", "fiducial_draws"]

Array = NDArray[np.float64]


class FiducialDraws(NamedTuple):
    """Populations, one per draw."""

    mean: Array  # (D, P)
    covariance: Array  # (D, P, P)


def fiducial_draws(values: ArrayLike, count: int, rng: np.random.Generator) -> FiducialDraws:
    """Draw means and covariances of the population that subjects come from.

    Parameters
    ----------
    values : array_like, shape (n, P)
        One row per subject, n at least P + 1; on the scale on which users are normal.
    count : int
        Number of draws D.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    FiducialDraws
        Means (D, P) and covariances (D, P, P).

    Raises
    ------
    UsageError
        Values that are no matrix, or not finite.
    RefusalError
        Fewer than P + 1 subjects, or values of one quantity that follow from the others exactly.
    """
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or not np.isfinite(matrix).all():
        raise UsageError("Values must be a matrix of finite numbers, a row per subject.")
    n, quantities = matrix.shape
    if n <= quantities:
        raise RefusalError(
            f"The joint law of {quantities} quantities needs at least {quantities + 1} subjects."
        )
    centre = matrix.mean(axis=0)
    # Triangular root of the scatter: S = rootᵀ·root.
    root: Array = np.asarray(np.linalg.qr(matrix - centre, mode="r"))
    if np.abs(np.diag(root)).min() <= np.finfo(np.float64).eps * np.abs(matrix).max():
        raise RefusalError("One quantity follows exactly from the others, or does not vary.")
    # Bartlett: lower triangular, χ on the diagonal and normal below.
    freedom = n + quantities - 2 - np.arange(quantities)
    bartlett = np.tril(rng.standard_normal((count, quantities, quantities)), -1)
    diagonal = np.arange(quantities)
    bartlett[:, diagonal, diagonal] = np.sqrt(rng.chisquare(freedom, size=(count, quantities)))
    # Σ = rootᵀ·(B·Bᵀ)⁻¹·root, and a root of it is rootᵀ·B⁻ᵀ.
    inverse = np.linalg.inv(bartlett)
    factor = root.T @ np.swapaxes(inverse, 1, 2)
    covariance = factor @ np.swapaxes(factor, 1, 2)
    noise = rng.standard_normal((count, quantities, 1))
    mean = centre + (factor @ noise)[..., 0] / np.sqrt(n)
    return FiducialDraws(mean, covariance)
