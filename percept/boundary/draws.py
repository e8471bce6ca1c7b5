"""Boundaries from draws of (k, b): draws behind classical intervals, ellipses of draws, bands of curves.

Eq. 15 comes from a distribution: X̄ + t·SD/√n, t with ν = n − 1. With stiffness and damping of the same
subjects the matching distribution of both is the bivariate t_ν about the means with the sample covariance:
each margin is Eq. 15's (or the prediction interval's) exactly, and k and b go together as the sample does. It
is the posterior under the prior abs(Σ)^−2, by inverse Wishart Σ; between the margins its coverage is close
to its level, not exact.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.haptics import AnyDevice, perceived_magnitude
from percept.inference.classical.moments import sample
from percept.inference.regions import EllipseRegion

Array = NDArray[np.float64]
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_BLOCK_VALUES = 1 << 20
# Most bytes held beside draws and results, however many frequencies: four blocks, and one of slack. A
# million draws and more need as much per frequency.
MEMORY = 5 * 8 * _BLOCK_VALUES


def confidence_draws(
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    kind: str,
    family: Literal["normal", "lognormal"],
    draws: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Draw (k, b) of the average or the next user from the distribution behind the classical intervals."""
    k, b = (sample(x, positive=family == "lognormal", least=3) for x in (stiffness, damping))
    if k.ndim != 1 or k.shape != b.shape:
        raise UsageError(f"one stiffness and one damping per subject are needed: {k.shape}, {b.shape}.")
    values = np.stack([k, b])
    if family == "lognormal":
        values = np.log(values)
    n = k.size
    centre = values.mean(axis=1)
    sd = values.std(axis=1, ddof=1)
    if not (sd > 0).all():
        raise RefusalError("all subjects adjusted alike: there is no scatter to draw from.")
    deviations = (values - centre[:, None]) / sd[:, None]
    correlation = float(np.clip(deviations[0] @ deviations[1] / (n - 1), -1.0, 1.0))
    z = _bivariate_t(correlation, n - 1, draws, rng)
    widened = np.sqrt(1.0 / n if kind == "mean" else 1.0 + 1.0 / n)
    drawn = centre[:, None] + widened * sd[:, None] * z
    if family == "lognormal":
        with np.errstate(over="ignore", under="ignore"):
            drawn = np.exp(drawn)
    return drawn[0], drawn[1]


def _bivariate_t(correlation: float, freedom: int, draws: int, rng: np.random.Generator) -> Array:
    """Draw from the standard bivariate t, shape (2, draws).

    Its radius has P(R² > r²) = (1 + r²/ν)^(−ν/2) and its angle is even: a sunflower's seeds.
    """
    index = rng.permutation(draws)
    beyond = (index + rng.random()) / draws
    radius = np.sqrt(freedom * np.expm1(-2.0 / freedom * np.log(np.maximum(beyond, 0.5 / draws))))
    angle = 2.0 * np.pi * (_GOLDEN * index + rng.random())
    first, second = radius * np.cos(angle), radius * np.sin(angle)
    return np.stack(
        [first, correlation * first + np.sqrt((1.0 - correlation) * (1.0 + correlation)) * second]
    )


def ellipse_of_draws(
    stiffness: Array,
    damping: Array,
    *,
    kind: Literal["mean", "user"],
    family: Literal["normal", "lognormal"],
    level: float,
    n: int,
) -> EllipseRegion:
    """Put an ellipse around draws: their mean and covariance, out to a quantile of Mahalanobis distance."""
    points = np.stack([stiffness, damping])
    if family == "lognormal":
        points = np.log(points)
    centre, shape = points.mean(axis=1), np.cov(points)
    sd = np.sqrt(np.diagonal(shape))
    if not (sd > 0).all() or abs(shape[0, 1]) >= sd[0] * sd[1]:
        raise RefusalError("the draws lie on a line: there is no ellipse around them.")
    unit = EllipseRegion(
        kind=kind, method="bayesian", family=family, level=level, centre=centre, shape=shape, radius=1.0, n=n
    )
    return dataclasses.replace(unit, radius=float(np.quantile(unit.distance(stiffness, damping), level)))


@dataclasses.dataclass(frozen=True, eq=False)
class DrawBands:
    """What draws say of abs(Z_h) at some frequencies."""

    lower: Array  # (M,) N·s/m
    upper: Array  # (M,) N·s/m
    mean: Array  # (M,) of the logarithms
    sd: Array  # (M,) of the logarithms
    error: Array  # (2, M) Monte Carlo error of log lower and log upper, from two halves of the draws


class DrawCurves:
    """Curves of abs(Z_h), one per draw of (k, b), never held all at once."""

    def __init__(
        self,
        device: AnyDevice,
        stiffness: Array,
        damping: Array,
        period: float,
        *,
        level: float,
        hold: str = "average",
    ) -> None:
        if stiffness.ndim != 1 or stiffness.shape != damping.shape or stiffness.size < 2:
            raise UsageError(
                "draws of stiffness and damping must be two arrays of one length, at least 2.",
                value=(stiffness.shape, damping.shape),
            )
        if not 0.0 < level < 1.0:
            raise UsageError("level must lie in (0, 1).", value=level)
        self._device, self._period, self._hold, self._level = device, period, hold, level
        self._stiffness, self._damping = stiffness, damping

    def at(self, omega: Array) -> DrawBands:
        """Evaluate the draws at frequencies (M,), rad/s, block by block."""
        step = max(1, _BLOCK_VALUES // self._stiffness.size)
        parts = [self._block(omega[i : i + step]) for i in range(0, omega.size, step)]
        lower, upper, mean, sd, *error = np.concatenate(parts, axis=1)
        return DrawBands(lower, upper, mean, sd, np.stack(error))

    def _block(self, omega: Array) -> Array:
        curves = perceived_magnitude(
            omega[:, None], self._device, self._stiffness, self._damping, self._period, hold=self._hold
        )
        # At Nyquist a mass is infinite whatever the draw.
        endless = np.isinf(curves).any(axis=1)
        curves[endless] = 1.0
        logs = np.log(curves)
        tail, half = 0.5 * (1.0 - self._level), curves.shape[1] // 2
        first, second = (np.log(_tails(part.copy(), tail)) for part in (curves[:, :half], curves[:, half:]))
        lower, upper = _tails(curves, tail)
        mean = logs.mean(axis=1)
        logs -= mean[:, None]
        sd = np.sqrt(np.einsum("mn,mn->m", logs, logs) / (logs.shape[1] - 1))
        bands = np.stack([lower, upper, mean, sd, *(0.5 * np.abs(first - second))])
        bands[:3, endless] = np.inf
        return bands


def _tails(values: Array, tail: float) -> tuple[Array, Array]:
    """Quantiles of rows at `tail` and 1 − `tail`, linear between order statistics; reorders the rows."""
    last = values.shape[1] - 1
    if not last:
        return values[:, 0], values[:, 0]
    low = min(int(tail * last), last - 1)
    fraction = tail * last - low
    # One partition per side, the second of what the first left: several at once cost three times as much.
    values.partition(low + 1, axis=1)
    first, second = values[:, : low + 1].max(axis=1), values[:, low + 1].copy()
    lower = first + fraction * (second - first)
    high = last - low - 1
    if high == low:
        return lower, second - fraction * (second - first)
    values[:, low + 1 :].partition(high - low - 1, axis=1)
    below, above = values[:, high], values[:, high + 1 :].min(axis=1)
    return lower, above - fraction * (above - below)


def relative_error(omega: Array, bands: tuple[Array, Array], error: Array) -> tuple[float, float] | None:
    """Typical and largest Monte Carlo error of a band, as fractions of its half-width in logarithms."""
    wide = np.isfinite(bands[1]) & (bands[1] > bands[0])
    if not wide.any():
        return None
    half_width = 0.5 * np.log(bands[1][wide] / bands[0][wide])
    relative, x = error[:, wide] / half_width, np.log(omega[wide])
    square = np.mean(relative**2, axis=0)
    mean = np.trapezoid(square, x) / (x[-1] - x[0]) if x.size > 1 else square[0]
    return float(np.sqrt(mean)), float(relative.max())
