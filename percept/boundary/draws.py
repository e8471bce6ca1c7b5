"""Boundaries from draws of (k, b): each draw to abs(Z_h), then bands over the curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.haptics import AnyDevice, perceived_magnitude

Array = NDArray[np.float64]
_BLOCK_VALUES = 1 << 20
#: Most bytes held beside draws and results, however many frequencies: four blocks, and one of slack. A
#: million draws and more need as much per frequency.
MEMORY = 5 * 8 * _BLOCK_VALUES


@dataclass(frozen=True, eq=False)
class DrawBands:
    """What draws say of abs(Z_h) at some frequencies."""

    lower: Array  # (M,)
    upper: Array  # (M,)
    mean: Array  # (M,)
    sd: Array  # (M,)
    error: Array  # (2, M)


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
    share = tail * last - low
    # One partition per side, the second of what the first left: several at once cost three times as much.
    values.partition(low + 1, axis=1)
    first, second = values[:, : low + 1].max(axis=1), values[:, low + 1].copy()
    lower = first + share * (second - first)
    high = last - low - 1
    if high == low:
        return lower, second - share * (second - first)
    values[:, low + 1 :].partition(high - low - 1, axis=1)
    below, above = values[:, high], values[:, high + 1 :].min(axis=1)
    return lower, above - share * (above - below)


def pointwise_band(
    omega: Array,
    device: AnyDevice,
    stiffness: Array,
    damping: Array,
    period: float,
    *,
    level: float,
    hold: str = "average",
) -> tuple[Array, Array]:
    """Equal-tailed quantiles of abs(Z_h) at each frequency.

    Parameters
    ----------
    omega : ndarray, shape (M,)
        rad/s.
    device, stiffness, damping, period, level, hold
        As `DrawCurves`.

    Returns
    -------
    lower, upper : ndarray, shape (M,)
        N·s/m.

    Raises
    ------
    UsageError
        As `DrawCurves`.
    """
    bands = DrawCurves(device, stiffness, damping, period, level=level, hold=hold).at(omega)
    return bands.lower, bands.upper


def relative_error(omega: Array, bands: tuple[Array, Array], error: Array) -> tuple[float, float] | None:
    """Typical and largest Monte Carlo error of a band, as shares of its half-width in logarithms."""
    wide = np.isfinite(bands[1]) & (bands[1] > bands[0])
    if not wide.any():
        return None
    half_width = 0.5 * np.log(bands[1][wide] / bands[0][wide])
    share, x = error[:, wide] / half_width, np.log(omega[wide])
    square = np.mean(share**2, axis=0)
    mean = np.trapezoid(square, x) / (x[-1] - x[0]) if x.size > 1 else square[0]
    return float(np.sqrt(mean)), float(share.max())
