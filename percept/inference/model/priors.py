"""Priors of the hierarchical model, and coordinates in which they are standard normal.

Each map takes u with a standard normal law to a variable with the stated law, in the form that is
accurate in the tail u lies in.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import UsageError

Array = NDArray[np.float64]
#: Values by name, draws first, with the names of their other dimensions.
Named = dict[str, tuple[tuple[str, ...], Array]]

#: Smallest SD: its square, and the square of that, must not underflow.
_FLOOR = 1e-70
#: Where erfinv(ndtr(u)) begins to lose more than a digit's last unit.
_FAR = 1.5
#: What each field of `Priors` is, for tables.
MEANINGS = {
    "alpha_sd": "SD of the common bias alpha (response scale)",
    "gamma_sd": "SD of the trend gamma of the bias (response scale per decade of the reference)",
    "tau_scale": (
        "half-normal scale of tau, the SD of an environment's own bias delta (response scale)"
    ),
    "sigma_u_scale": "half-normal scale of the SD of the subject effect u (response scale)",
    "sigma_trend_scale": (
        "half-normal scale of the SD of subjects' own trends (response scale per decade)"
    ),
    "log_s_mean": (
        "mean of log s, the typical SD between subjects in an environment (log of response scale)"
    ),
    "log_s_sd": "SD of log s",
    "kappa_sd": "SD of kappa, the trend of log sigma per decade of the reference; 0 is Weber's law",
    "omega_scale": "half-normal scale of omega, the SD of log sigma about its trend",
    "rho_shape": "shape a of Beta(a, a) for (rho + 1)/2, every correlation between k and b",
    "log_s_e_mean": "mean of log s_e, the typical between-trial SD (log of response scale)",
    "log_s_e_sd": "SD of log s_e",
    "kappa_e_sd": (
        "SD of kappa_e, the trend of the log between-trial SD per decade of the reference"
    ),
    "omega_e_scale": (
        "half-normal scale of omega_e, the SD of the log between-trial SD about its trend"
    ),
    "omega_s_scale": (
        "half-normal scale of omega_s, the SD of the log between-trial SD between subjects"
    ),
    "lambda_sd": "SD of lambda, the difference of two levels of a factor (response scale)",
    "psi_sd": "SD of psi and eta, the difference of two levels in the logarithm of an SD",
    "covariate_sd": "SD of the slope on a covariate (response scale per SD of the covariate)",
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
    sigma_trend_scale: float = 0.25
    log_s_mean: float = math.log(0.2)
    log_s_sd: float = 1.0
    kappa_sd: float = 0.5
    omega_scale: float = 1.0
    rho_shape: float = 2.0
    log_s_e_mean: float = math.log(0.1)
    log_s_e_sd: float = 1.0
    kappa_e_sd: float = 0.5
    omega_e_scale: float = 1.0
    omega_s_scale: float = 0.5
    lambda_sd: float = 1.0
    psi_sd: float = 0.5
    covariate_sd: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise UsageError("a prior must be finite.", key=name, value=value)
            if not name.endswith("_mean") and value <= 0:
                hint = "Leave it out of the scene for its default."
                raise UsageError(
                    "a prior scale must be positive.", key=name, value=value, hint=hint
                )


def half_normal(u: Array, scale: Array | float) -> Array:
    """Map a standard normal to a half-normal by its quantiles."""
    u = np.asarray(u)
    value = np.sqrt(2.0) * special.erfinv(special.ndtr(u))
    # From here on 1 - ndtr(u) has lost digits, and the upper tail's own form is needed.
    far = u > _FAR
    value[far] = -special.ndtri(0.5 * special.ndtr(-u[far]))
    return np.maximum(scale * value, _FLOOR)


def correlation(u: Array, shape: float = 2.0) -> tuple[Array, Array]:
    """Map a standard normal to a correlation rho with (rho + 1)/2 ~ Beta(shape, shape).

    Returned are rho and 1 - abs(rho), with the digits that a rho near one loses.
    """
    tail = special.ndtr(-np.abs(u))
    if shape == 2.0:
        # The Beta(2, 2) quantile is trigonometric; near the end the angle's distance from pi/6 is
        # kept. 1 - abs(rho) is 2 sin²(angle/2) + sqrt(3) sin(angle).
        half_angle = np.arcsin(np.sqrt(tail)) / 3.0
        sine = np.sin(half_angle)
        rest = 2.0 * sine * (sine + np.sqrt(3.0 * (1.0 - sine * sine)))
    else:
        # Of tails far below 1e-100, where no draw comes, scipy may give NaN.
        rest = 2.0 * special.betaincinv(shape, shape, tail)
    rest = np.minimum(rest, 1.0)
    # rho from its own distance to one: two forms would disagree by 1e-8 near the ends.
    return np.copysign(1.0 - rest, u), np.maximum(rest, _FLOOR)
