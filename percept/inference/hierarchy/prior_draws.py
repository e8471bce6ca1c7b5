"""Draws of the model without factors before any data: scales, means of environments, new users."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.laws import PriorDraws
from percept.inference.hierarchy.priors import Priors, draws_first
from percept.inference.hierarchy.scales import Layout, Options, Scales
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["draw_prior_of"]

Array = NDArray[np.float64]


def draw_prior_of(
    statistics: Statistics,
    priors: Priors,
    options: Options,
    draws: int,
    rng: np.random.Generator,
) -> PriorDraws:
    """Draw scales, population means and new users of P quantities in J environments.

    Parameters
    ----------
    statistics : Statistics
        Its environments and subjects count, and its responses do not.
    priors : Priors
        Prior scales.
    options : Options
        Simpler models.
    draws : int
        Number of draws W.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    PriorDraws
        Means and users on the response scale, (W, P J).
    """
    # Without observed scatter every coordinate of log sigma is standard normal a priori, as are the
    # others.
    blank = dataclasses.replace(
        statistics,
        sd=np.zeros_like(statistics.sd),
        trial_rows=np.zeros_like(statistics.trial_rows),
    )
    layout = Layout(blank, priors, options)
    scales = layout.scales(rng.standard_normal((layout.dimension, draws)))
    beta = _draw_beta(layout, scales, rng)
    users = _draw_users(scales, beta, rng)
    return PriorDraws(
        scales=draws_first(scales.named),
        means=beta.reshape(-1, draws).T,
        users=users.reshape(-1, draws).T,
    )


def _draw_beta(layout: Layout, scales: Scales, rng: np.random.Generator) -> Array:
    """Draw beta = alpha + gamma x + delta, (P, J, W)."""
    priors = layout.priors
    width = scales.log_prior.size
    alpha = priors.alpha_sd * rng.standard_normal((layout.parameters, 1, width))
    beta = np.repeat(alpha, layout.environments, axis=1)
    if scales.tau is not None:
        gamma = priors.gamma_sd * rng.standard_normal(alpha.shape)
        beta += gamma * layout.statistics.x[..., None]
        tau = np.stack(scales.tau)[:, None]
        beta += tau * rng.standard_normal(beta.shape)
    return beta


def _draw_users(scales: Scales, beta: Array, rng: np.random.Generator) -> Array:
    """Draw a new user about beta (P, J, W): w in each environment, and u in all of them."""
    users = beta.copy()
    each_environment = beta.shape[1:]
    for column in scales.between.factor_columns():
        users += np.stack(column) * rng.standard_normal(each_environment)
    if scales.shared is not None:
        for column in scales.shared.factor_columns():
            of_quantity = np.stack(column)[:, None]
            users += of_quantity * rng.standard_normal(each_environment)
    return users
