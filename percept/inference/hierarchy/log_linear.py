"""SDs of cells that follow log-linear columns, in coordinates that the data have shaped.

For one quantity, log sigma = m + U h + omega e over C cells: the columns U hold the trend and the
contrasts of factors, and h (K,) and e (C,) are standard normal. Given omega, a rough likelihood
N(log sigma; l, diag(1/w)) of the data makes (h, e) normal once more, and the coordinates (u, v) are
its standardised form:

    h = mean + L'^-1 u,  LL' = I + U' diag(q) U,  q = w / (1 + w omega²)
    e = omega q (l - m - U h) + v / sqrt(1 + w omega²)

The coordinates are then near standard normal under the posterior, whether omega is large or nearly
zero. The rough likelihood shapes the coordinates alone: their density gives the prior its due.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["LogLinear", "LogSpreads"]

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)


@dataclasses.dataclass(frozen=True, eq=False)
class LogSpreads:
    """Log SDs at W sets of coordinates, and what they are made of."""

    log_sigma: Array  # (C, W)
    multiples: Array  # (K, W) h: coefficients over their prior SDs
    log_density: Array  # (W,) Of the coordinates under the prior


class LogLinear:
    """Map from coordinates to the log SDs of one quantity at one level.

    Parameters
    ----------
    centre : float
        Prior mean m of log sigma.
    columns : ndarray
        Columns times their prior SDs, shape (K, C).
    rough_mean, rough_weight : ndarray
        Rough likelihood of log sigma, (C,); a cell of weight zero has none.
    """

    def __init__(
        self, centre: float, columns: Array, rough_mean: Array, rough_weight: Array
    ) -> None:
        self.centre = centre
        self.columns = columns
        self._apart = np.where(rough_weight > 0, rough_mean - centre, 0.0)[:, None]
        self._weight = rough_weight[:, None]
        products = columns[:, None] * columns[None]
        self._products = products.reshape(-1, columns.shape[1])

    def __call__(self, u: Array, v: Array, omega: Array, shift: Array | float = 0.0) -> LogSpreads:
        """Map coordinates u (K, W) and v (C, W), given omega (W,).

        The means of the rough likelihood are moved by a shift (C, W).
        """
        apart = self._apart + shift
        swell = 1.0 + self._weight * omega**2
        pull = self._weight / swell
        multiples, log_root = self._coefficients(u, pull, apart)
        middle = self.columns.T @ multiples
        own = omega * pull * (apart - middle) + v / np.sqrt(swell)
        squares = np.einsum("kw,kw->w", multiples, multiples) + np.einsum("cw,cw->w", own, own)
        log_density = -0.5 * (squares + np.log(swell).sum(axis=0)) - log_root
        log_density -= 0.5 * _LOG_2PI * (len(u) + len(v))
        return LogSpreads(self.centre + middle + omega * own, multiples, log_density)

    def _coefficients(self, u: Array, pull: Array, apart: Array) -> tuple[Array, Array]:
        """Multiples h (K, W), and log det L (W,)."""
        size = len(u)
        precision = (self._products @ pull).reshape(size, size, -1)
        precision[np.arange(size), np.arange(size)] += 1.0
        factor = lower_factor(precision)
        right = self.columns @ (pull * apart)
        whitened = solve_lower(factor, right)
        return solve_upper(factor, whitened + u), log_diagonal(factor)


def lower_factor(matrices: Array) -> Array:
    """Lower Cholesky factors of small matrices (K, K, ...), draws last."""
    factor = np.zeros_like(matrices)
    for i in range(len(matrices)):
        column = matrices[i:, i] - np.einsum("k...,ik...->i...", factor[i, :i], factor[i:, :i])
        factor[i:, i] = column / np.sqrt(column[0])
    return factor


def solve_lower(factor: Array, right: Array) -> Array:
    """Solve L x = right for lower factors (K, K, ...) and vectors (K, ...)."""
    x = np.empty(np.broadcast_shapes(right.shape, factor.shape[1:]))
    for i in range(len(factor)):
        x[i] = (right[i] - np.einsum("k...,k...->...", factor[i, :i], x[:i])) / factor[i, i]
    return x


def solve_upper(factor: Array, right: Array) -> Array:
    """Solve L'x = right."""
    x = np.empty(np.broadcast_shapes(right.shape, factor.shape[1:]))
    for i in reversed(range(len(factor))):
        known = np.einsum("k...,k...->...", factor[i + 1 :, i], x[i + 1 :])
        x[i] = (right[i] - known) / factor[i, i]
    return x


def log_diagonal(factor: Array) -> Array:
    """Log determinants of lower factors (K, K, ...)."""
    logs = [np.log(factor[i, i]) for i in range(len(factor))]
    return np.asarray(sum(logs))
