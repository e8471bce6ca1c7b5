"""Priors of the hierarchical model, with their meaning."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import UsageError

Array = NDArray[np.float64]
MEANINGS = {
    "alpha_sd": "SD of the common bias alpha (response scale)",
    "gamma_sd": "SD of the trend gamma of the bias (response scale per decade of the reference)",
    "tau_scale": "half-normal scale of tau, the SD of an environment's own bias delta (response scale)",
    "sigma_u_scale": "half-normal scale of the SD of the subject effect u (response scale)",
    "log_s_mean": "mean of log s, the typical SD between subjects in an environment (log of response scale)",
    "log_s_sd": "SD of log s",
    "kappa_sd": "SD of kappa, the trend of log sigma per decade of the reference; 0 is Weber's law",
    "omega_scale": "half-normal scale of omega, the SD of log sigma about its trend",
    "rho_shape": "shape a of Beta(a, a) for (rho + 1)/2, every correlation between k and b",
    "log_s_e_mean": "mean of log s_e, the typical between-trial SD (log of response scale)",
    "log_s_e_sd": "SD of log s_e",
    "kappa_e_sd": "SD of kappa_e, the trend of the log between-trial SD per decade of the reference",
    "omega_e_scale": "half-normal scale of omega_e, the SD of the log between-trial SD about its trend",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Priors:
    """Prior scales of the hierarchical model, all on the unit-free response scale.

    The response is log(adjusted/reference) (lognormal family) or (adjusted - reference)/reference
    (normal family); `MEANINGS` says what each field is.
    """

    alpha_sd: float = 1.0
    gamma_sd: float = 0.25
    tau_scale: float = 0.5
    sigma_u_scale: float = 0.5
    log_s_mean: float = math.log(0.2)
    log_s_sd: float = 1.0
    kappa_sd: float = 0.5
    omega_scale: float = 1.0
    rho_shape: float = 2.0
    log_s_e_mean: float = math.log(0.1)
    log_s_e_sd: float = 1.0
    kappa_e_sd: float = 0.5
    omega_e_scale: float = 1.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise UsageError("a prior must be finite.", key=field.name, value=value)
            if not field.name.endswith("_mean") and value <= 0:
                raise UsageError(
                    "a prior scale must be positive.",
                    key=field.name,
                    value=value,
                    hint="Leave it out of the scene for its default.",
                )


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
