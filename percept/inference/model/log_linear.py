"""SDs of cells that follow log-linear columns, in coordinates that the data have shaped.

For one quantity, log sigma = m + U h + omega e over C cells: the columns U hold the trend and the
contrasts of factors, and h (K,) and e (C,) are standard normal. Given omega, a rough likelihood
N(log sigma; l, diag(1/w)) of the data makes (h, e) normal once more, and the coordinates (u, v) are
its standardised form:

    q = w / (1 + w omega²)
    LL' = I + U' diag(q) U
    h = L'^-1 (L^-1 U' diag(q) (l - m) + u)
    e = omega q (l - m - U h) + v / sqrt(1 + w omega²)

The coordinates are then near standard normal under the posterior, whether omega is large or nearly
zero. The rough likelihood shapes the coordinates alone: their density under the prior is exact, the
normal density of h and e times the Jacobian prod(1 + w omega²)^(-1/2) / det L.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.small_cholesky import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
)

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
        departure = np.where(rough_weight > 0, rough_mean - centre, 0.0)
        self._rough_departure = departure[:, None]  # l - m
        self._weight = rough_weight[:, None]
        products = columns[:, None] * columns[None]
        self._products = products.reshape(-1, columns.shape[1])

    def __call__(self, u: Array, v: Array, omega: Array, shift: Array | float = 0.0) -> LogSpreads:
        """Map coordinates u (K, W) and v (C, W), given omega (W,).

        The means of the rough likelihood are moved by a shift (C, W).
        """
        rough_departure = self._rough_departure + shift
        precision = 1.0 + self._weight * omega**2  # of e, given h
        weight = self._weight / precision  # q
        h, log_det_factor = self._coefficients(u, weight, rough_departure)
        middle = self.columns.T @ h
        e = omega * weight * (rough_departure - middle) + v / np.sqrt(precision)
        squares = np.einsum("kw,kw->w", h, h) + np.einsum("cw,cw->w", e, e)
        # The prior of h and e times the Jacobian of the map.
        log_precision = np.log(precision).sum(axis=0)
        log_density = -0.5 * (squares + log_precision) - log_det_factor
        log_density -= 0.5 * _LOG_2PI * (len(u) + len(v))
        return LogSpreads(self.centre + middle + omega * e, h, log_density)

    def _coefficients(self, u: Array, weight: Array, rough_departure: Array) -> tuple[Array, Array]:
        """Multiples h (K, W), and log det L (W,)."""
        size = len(u)
        precision = (self._products @ weight).reshape(size, size, -1)
        diagonal = np.arange(size)
        precision[diagonal, diagonal] += 1.0
        factor = lower_factor(precision)
        right = self.columns @ (weight * rough_departure)
        # mean + L'^-1 u with the mean L'^-1 L^-1 right, in one solution.
        whitened_mean = solve_lower(factor, right)
        return solve_upper(factor, whitened_mean + u), log_diagonal(factor)
