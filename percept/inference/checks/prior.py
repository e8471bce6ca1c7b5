"""The model before the data: draws from its priors, and the density of each prior at given draws."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.priors import draws_first, log_normal_density, log_scale_priors
from percept.inference.hierarchy.scales import Layout, Scales

Array = NDArray[np.float64]
Named = dict[str, tuple[tuple[str, ...], Array]]
#: Which priors speak of what.
GROUPS = {
    "bias": ("alpha", "gamma", "tau"),
    "spread": ("s", "kappa", "omega", "sigma"),
    "subjects": ("sigma_u",),
    "trials": ("s_e", "kappa_e", "omega_e", "sigma_e"),
    "correlation": ("rho_w", "rho_u", "rho_e"),
}


def prior_layout(density: CollapsedDensity) -> Layout:
    """Layout of the same model without data, in which every coordinate is standard normal a priori."""
    statistics = density.statistics
    # Only the observed scatter sets the coordinates of log sigma off their prior.
    blank = dataclasses.replace(
        statistics, sd=np.zeros_like(statistics.sd), trial_rows=np.zeros_like(statistics.trial_rows)
    )
    return Layout(blank, density.priors, density.layout.options)


def draw_prior(density: CollapsedDensity, draws: int, rng: np.random.Generator) -> tuple[Named, Array, Array]:
    """Draw scales, population means and new users before any data."""
    layout, priors = prior_layout(density), density.priors
    scales = layout.scales(rng.standard_normal((layout.dimension, draws)))
    size, environments = layout.parameters, layout.environments
    beta = np.repeat(priors.alpha_sd * rng.standard_normal((size, 1, draws)), environments, axis=1)
    if scales.tau is not None:
        gamma = priors.gamma_sd * rng.standard_normal((size, 1, draws))
        beta += gamma * density.statistics.x[..., None]
        beta += np.stack(scales.tau)[:, None] * rng.standard_normal(beta.shape)
    user = beta.copy()
    for column in scales.between.factor_columns():
        user += np.stack(column) * rng.standard_normal(beta.shape[1:])
    for column in scales.shared.factor_columns() if scales.shared is not None else ():
        user += np.stack(column)[:, None] * rng.standard_normal(beta.shape[1:])
    return draws_first(scales.named), beta.reshape(-1, draws).T, user.reshape(-1, draws).T


def draw_trend(
    density: CollapsedDensity, scales: Scales, beta: Array, rng: np.random.Generator | None = None
) -> tuple[Array, Array]:
    """Level alpha and slope gamma per decade given the locations: a regression of its own per parameter."""
    assert scales.tau is not None
    priors = density.priors
    pull = 1.0 / np.stack(scales.tau) ** 2
    found = []
    # x is centred, so level and slope are independent given the locations.
    for x, prior_sd in (
        (np.ones_like(density.statistics.x), priors.alpha_sd),
        (density.statistics.x, priors.gamma_sd),
    ):
        precision = pull * np.square(x).sum(axis=1)[:, None] + prior_sd**-2.0
        value = pull * np.einsum("pj,pjw->pw", x, beta) / precision
        if rng is not None:
            value = value + rng.standard_normal(value.shape) / np.sqrt(precision)
        found.append(value)
    return found[0], found[1]


def log_prior(
    density: CollapsedDensity, scales: Scales, beta: Array, rng: np.random.Generator
) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Log density of each top-level prior, on the scale the prior is stated on; see `log_scale_priors`."""
    priors = density.priors
    found: dict[str, Array] = {}
    if scales.tau is None:
        found["alpha"] = log_normal_density(beta[:, 0], 0.0, priors.alpha_sd)
    else:
        alpha, gamma = draw_trend(density, scales, beta, rng)
        found |= {
            "alpha": log_normal_density(alpha, 0.0, priors.alpha_sd),
            "gamma": log_normal_density(gamma, 0.0, priors.gamma_sd),
        }
    return draws_first(found | log_scale_priors(scales.named, priors, trend=density.layout.trend))
