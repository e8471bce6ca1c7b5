"""Density of each prior of the scales at given draws, on the scale the prior is stated on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.hierarchy.priors import Priors

Array = NDArray[np.float64]
Named = dict[str, tuple[tuple[str, ...], Array]]
_LOG_2PI = float(np.log(2.0 * np.pi))
_DIMENSIONS = {1: (), 2: ("parameter",), 3: ("parameter", "environment")}


def log_scale_priors(named: Mapping[str, Array], priors: Priors, *, trend: bool) -> dict[str, Array]:
    """Log density of each top-level prior of scales and correlations.

    The laws of the environments' own SDs about their trend are part of the model, not priors: raising those
    to a power would ask what another model says.
    """
    found: dict[str, Array] = {}
    for name in ("tau", "sigma_u", "omega", "omega_e"):
        if name in named:
            found[name] = np.log(2.0) + log_normal_density(named[name], 0.0, getattr(priors, f"{name}_scale"))
    for suffix in ("", "_e"):
        mean, sd = getattr(priors, f"log_s{suffix}_mean"), getattr(priors, f"log_s{suffix}_sd")
        level = ("s" if trend else "sigma") + suffix
        if level in named:
            found[level] = log_normal_density(np.log(named[level]), mean, sd)
        slope = "kappa" + suffix
        if slope in named:
            found[slope] = log_normal_density(named[slope], 0.0, getattr(priors, f"{slope}_sd"))
    for name in ("rho_w", "rho_u", "rho_e"):
        if name in named:
            found[name] = _beta(named[name], priors)
    return found


def log_normal_density(value: Array, mean: float, sd: float) -> Array:
    """Log density of N(mean, sd²)."""
    standard = (value - mean) / sd
    return np.asarray(-0.5 * (standard * standard + _LOG_2PI) - np.log(sd))


def draws_first(named: Mapping[str, Array]) -> Named:
    """Name the dimensions of draws (..., W), and put the draws first."""
    return {name: (_DIMENSIONS[value.ndim], np.moveaxis(value, -1, 0)) for name, value in named.items()}


def _beta(rho: Array, priors: Priors) -> Array:
    shape = priors.rho_shape
    # Draws at ±1 to the last digit have a density of zero when the shape is above one.
    inside = np.maximum((1.0 - rho) * (1.0 + rho) / 4.0, np.finfo(float).tiny)
    return np.asarray((shape - 1.0) * np.log(inside) - special.betaln(shape, shape) - np.log(2.0))
