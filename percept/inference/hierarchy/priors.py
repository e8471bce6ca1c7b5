"""Priors of the hierarchical model with their meaning, and coordinates in which they are standard normal.

Each map takes u with a standard normal law to a variable with the stated law, in the form that is
accurate in the tail u lies in.
"""

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
    "lambda_sd": "SD of lambda, the contrast of two conditions within subjects (response scale)",
    "psi_sd": "SD of psi, the contrast of log sigma between two conditions within subjects",
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
    lambda_sd: float = 1.0
    psi_sd: float = 0.5

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
_DIMENSIONS = {1: (), 2: ("parameter",), 3: ("parameter", "environment")}


def draws_first(named: Mapping[str, Array]) -> Named:
    """Name the dimensions of draws (..., W), and put the draws first."""
    return {name: (_DIMENSIONS[value.ndim], np.moveaxis(value, -1, 0)) for name, value in named.items()}


#: Beyond this many prior SDs a coordinate has no mass that doubles can weigh: exp(-35²/2) = 1e-266.
LIMIT = 35.0
#: Smallest SD: its square, and the square of that, must not underflow.
_FLOOR = 1e-70
#: Where erfinv(ndtr(u)) begins to lose more than a digit's last unit.
_FAR = 1.5


def half_normal(u: Array, scale: Array | float) -> Array:
    """Map a standard normal to a half-normal by its quantiles."""
    u = np.asarray(u)
    value = np.sqrt(2.0) * special.erfinv(special.ndtr(u))
    # From here on 1 - ndtr(u) has lost digits, and the upper tail's own form is needed.
    far = u > _FAR
    value[far] = -special.ndtri(0.5 * special.ndtr(-u[far]))
    return np.maximum(scale * value, _FLOOR)


def correlation(u: Array, shape: float = 2.0) -> tuple[Array, Array]:
    """Map a standard normal to a correlation with (rho + 1)/2 ~ Beta(shape, shape)."""
    lower = special.ndtr(-np.abs(u))
    if shape == 2.0:
        # The Beta(2, 2) quantile is trigonometric; near the end the angle's distance from pi/6 is kept.
        # 1 - abs(rho) is 2 sin²(angle/2) + sqrt(3) sin(angle).
        sine = np.sin(np.arcsin(np.sqrt(lower)) / 3.0)
        rest = 2.0 * sine * (sine + np.sqrt(3.0 * (1.0 - sine * sine)))
    else:
        rest = 2.0 * _beta_quantile(shape, lower)
    rest = np.minimum(rest, 1.0)
    # rho from its own distance to one: two forms would disagree by 1e-8 near the ends.
    return np.copysign(1.0 - rest, u), np.maximum(rest, _FLOOR)


def _beta_quantile(shape: float, lower: Array) -> Array:
    """Quantile of Beta(shape, shape) at a lower tail; scipy has none for tails far below 1e-100."""
    quantile = np.asarray(special.betaincinv(shape, shape, lower))
    log_first = (np.log(lower) + np.log(shape) + special.betaln(shape, shape)) / shape
    first = np.exp(log_first)
    return np.where(np.isnan(quantile), first * (1.0 + (shape - 1.0) / (shape + 1.0) * first), quantile)


@dataclasses.dataclass(frozen=True, eq=False)
class Spreads:
    """Spreads of one level and their trend, P parameters in J cells at W points."""

    log_sigma: Array  # (P, J, W) log sigma
    trend: Array  # (P, 2, W) h: log s less m, and kappa, each over its prior SD
    log_density: Array  # (W,)


class SpreadMap:
    """Map from coordinates to the spreads of one level, with the trend they scatter about integrated out.

    log sigma = m + U h + omega e with h and e standard normal: h are the trend's multiples of its two prior
    SDs (of log s and of kappa), e each cell's own departure. A rough likelihood N(log sigma; l, diag(1/w))
    makes the law of log sigma given omega, h integrated out, a normal one with some mean and covariance C;
    the coordinate u is C^(-1/2) times the distance from that mean. Neither a centred nor a non-centred form
    is good for all data; this one follows the data. The trend is then written by its exact law given log
    sigma and omega: the data say nothing more of it, so its coordinates are standard normal whatever the
    rest.
    """

    def __init__(self, centre: float, loadings: Array, rough_mean: Array, rough_weight: Array) -> None:
        cells = loadings.shape[-1]
        self._centre = centre
        # Padded, so that a single cell has two singular values too.
        turn, size, basis = np.linalg.svd(np.pad(loadings, ((0, 0), (0, 0), (0, 1))), full_matrices=False)
        # U' = turn diag(size) basis: the two multiples turn(...) are independent given log sigma.
        self._turn = turn
        self._turn_back = np.swapaxes(turn, 1, 2)
        self._size = size[..., None]
        self._basis = np.where(self._size > 0, basis[..., :cells], 0.0)
        self._basis_up = np.swapaxes(self._basis, 1, 2)
        self._loading = self._size * self._basis
        self._loading_up = np.swapaxes(self._loading, 1, 2)
        first, second = np.moveaxis(self._loading, 1, 0)
        self._products = np.stack([first * first, first * second, second * second], axis=1)
        self._apart = (rough_mean - centre)[..., None]
        self._weight = rough_weight[..., None]

    def __call__(self, u: Array, omega: Array, trend: Array, shift: Array | float = 0.0) -> Spreads:
        """Map coordinates to spreads, the rough likelihood's means moved by a shift (P, J, W)."""
        apart = self._apart + shift
        wide = omega[:, None]
        square = wide * wide
        swell = 1.0 + self._weight * square
        root = np.sqrt(swell)
        held = self._weight / swell
        h, root_det = self._whitened_trend(u / root, held, swell, omega, apart)
        middle = self._loading_up @ h
        # log sigma = m + middle + omega pull: nothing is divided by an omega that may be tiny.
        pull = held * wide * (apart - middle) + u / root
        along = self._basis @ pull
        off = pull - self._basis_up @ along
        variance = square + self._size * self._size
        shared = self._size * h + wide * along
        share = shared / variance
        squares = np.einsum("pjw,pjw->w", off, off) + np.einsum("prw,prw->w", shared, share)
        logs = np.log(swell).sum(axis=(0, 1)) + np.log(variance).sum(axis=(0, 1))
        given = self._size * share + wide / np.sqrt(variance) * (self._turn_back @ trend)
        return Spreads(
            self._centre + middle + wide * pull,
            self._turn @ given,
            np.log(root_det).sum(axis=0) - 0.5 * (squares + logs),
        )

    def _whitened_trend(
        self, u: Array, held: Array, swell: Array, omega: Array, apart: Array
    ) -> tuple[Array, Array]:
        """Multiples of the loadings in log sigma, (P, 2, W), and the root of det(omega² I + B), (P, W).

        Given the trend the cells are independent, with variances omega²/q, q = 1 + w omega². With LL' the
        precision of the trend's multiples given the rough likelihood and G = q^(-1/2) U L'^(-1), the
        covariance is C = omega² q^(-1/2) (I + GG'/omega²) q^(-1/2), and its root needs that of the 2 x 2
        matrix omega² I + B, B = G'G, alone.
        """
        n11, n12, n22 = np.moveaxis(self._products @ held, 1, 0)
        l11 = np.sqrt(1.0 + n11)
        l21 = n12 / l11
        # 1 + n22 - l21², without the difference of large numbers that the last two may be.
        l22 = np.sqrt((1.0 + n11 + n22 + np.maximum(n11 * n22 - n12 * n12, 0.0)) / (1.0 + n11))
        c11, c12, c22 = np.moveaxis(self._products @ (1.0 / swell), 1, 0)
        tilt = l21 / l11
        b11 = c11 / (l11 * l11)
        b12 = (c12 - tilt * c11) / (l11 * l22)
        b22 = np.maximum(c22 - 2.0 * tilt * c12 + tilt * tilt * c11, 0.0) / (l22 * l22)
        d11, d22 = omega * omega + b11, omega * omega + b22
        root_det = np.sqrt(d11 * d22 - b12 * b12)
        over = 1.0 / np.sqrt(d11 + d22 + 2.0 * root_det)
        r11, r12, r22 = omega + (d11 + root_det) * over, b12 * over, omega + (d22 + root_det) * over
        det = r11 * r22 - r12 * r12
        first, second = self._solve(self._loading @ u, l11, l21, l22)
        y1, y2 = (r22 * first - r12 * second) / det, (r11 * second - r12 * first) / det
        g1, g2 = self._solve(self._loading @ (held * apart), l11, l21, l22)
        h2 = (y2 + g2) / l22
        return np.stack([(y1 + g1 - l21 * h2) / l11, h2], axis=1), root_det

    @staticmethod
    def _solve(right: Array, l11: Array, l21: Array, l22: Array) -> tuple[Array, Array]:
        """L^(-1) times vectors (P, 2, W)."""
        first = right[:, 0] / l11
        return first, (right[:, 1] - l21 * first) / l22
