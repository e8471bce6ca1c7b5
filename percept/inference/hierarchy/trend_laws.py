"""The trend over environments without factors, and the environment that nobody was tested in.

The location in environment j is beta_j = alpha + gamma x_j + delta_j, with x_j the decades of the
reference above the geometric mean and delta_j ~ N(0, tau²). Given scales and data, alpha and gamma
are normal together. An untested environment at x has

    location          alpha + gamma x + N(0, tau²)
    users about it    covariance shared + between, log SDs of between ~ N(log s + kappa x, omega²)

Shapes: P quantities, W sets of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.information import Information
from percept.inference.hierarchy.laws import NewEnvironment, TrendLaw, covariances, even_normals
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.regression import Regression
from percept.inference.hierarchy.scales import Scales

__all__ = ["new_environment_given", "trend_given"]

Array = NDArray[np.float64]


def trend_given(
    law: Regression | Information,
    priors: Priors,
    size: int,
) -> TrendLaw:
    """Law of alpha and gamma of `size` quantities, given W sets of scales."""
    prior_sds = np.repeat([priors.alpha_sd, priors.gamma_sd], size)
    mean, columns = law.trend(np.diag(prior_sds))
    by_line = mean.reshape(2, size, -1)  # (2, P, W) Intercepts, then slopes
    column_lines = columns.reshape(-1, *by_line.shape)
    return TrendLaw(
        mean=by_line.T,
        covariance=np.einsum("qapw,qbpw->wpab", column_lines, column_lines),
    )


def new_environment_given(
    law: Regression | Information,
    scales: Scales,
    x: Array,
    repeats: int,
    priors: Priors,
    rng: np.random.Generator,
) -> NewEnvironment:
    """Laws of an untested environment given W sets of scales.

    Parameters
    ----------
    law : Regression or Information
        Of the tested locations.
    scales : Scales
        At W sets of coordinates.
    x : ndarray
        Decades of its references above the geometric mean of those tested, (P,).
    repeats : int
        Draws of its SDs between subjects for each set of scales.
    priors : Priors
        Of alpha and gamma.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    NewEnvironment
        Of W repeats draws.
    """
    count = x.size
    # Of alpha and gamma over their prior SDs.
    rows = np.zeros((count, 2 * count))
    rows[:, :count] = priors.alpha_sd * np.eye(count)
    rows[:, count:] = priors.gamma_sd * np.diag(x)
    mean, columns = law.trend(rows)
    covariance = np.einsum("qpw,qrw->wpr", columns, columns)
    tau = scales.named["tau"].T
    diagonal = np.arange(count)
    covariance[:, diagonal, diagonal] += tau**2
    population = _new_population(scales, x, repeats, rng)
    return NewEnvironment(
        mean=np.repeat(mean.T, repeats, axis=0),
        covariance=np.repeat(covariance, repeats, axis=0),
        population=population.reshape(-1, count, count),
    )


def _new_population(
    scales: Scales,
    x: Array,
    repeats: int,
    rng: np.random.Generator,
) -> Array:
    """Covariances of users (W, repeats, P, P), log sigma drawn evenly about its trend."""
    named = scales.named
    width = scales.log_prior.size
    log_sigma = np.log(named["s"])
    if "kappa" in named:
        log_sigma = log_sigma + named["kappa"] * x[:, None]
    omega = named.get("omega", np.zeros((x.size, 1)))
    normals = even_normals(repeats, x.size, width, rng)
    sigma = np.exp(log_sigma + omega * normals)
    draws_first = np.moveaxis(sigma, -1, 0)
    population = covariances(draws_first, named.get("rho_w"))
    if "sigma_u" not in named:
        return population
    sigma_u = named["sigma_u"].T[:, None]
    return population + covariances(sigma_u, named.get("rho_u"))
