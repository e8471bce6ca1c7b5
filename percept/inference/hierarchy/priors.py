"""Priors of the hierarchical model, with their meaning."""

from __future__ import annotations

import dataclasses
import math

from percept.errors import UsageError

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
