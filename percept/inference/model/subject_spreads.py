"""Subjects' own trial SDs, in coordinates that follow the data.

The log trial SD of subject i in cell c is log sigma_ec + phi_i, with phi_i ~ N(0, omega_s²) in
each quantity. The scatter of a subject's trials gives phi_i a rough likelihood: its rough log SD
l_i is N(a + phi_i, 1/w_i), with w_i = 2 df_i. The level a is common to all subjects and has a flat
prior here: only the cells' SDs tell it. With a fixed level 24 subjects take a third more draws.
Given omega_s the standardised f = phi/omega_s are then normal:

    precision    diag(s) - cc',  s = 1 + w omega_s²,  c = omega_s w / √(sum w)
    covariance   s^(-1/2) (I + (g² - 1) dd') s^(-1/2),  g² = sum w / sum (w/s)
    mean         covariance × omega_s w (l - l̄),  l̄ the mean of l weighted by w

with d the unit vector along w s^(-1/2). The coordinates v are standard normal under this law:

    f = mean + s^(-1/2) (I + (g - 1) dd') v

The mean of all phi keeps its prior, and the cells' SDs follow it. The rough likelihood shapes the
coordinates alone: their density under the prior is exact.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import Statistics

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)
#: Beside sums that are zero where no trial scatters: their ratios are then one, or zero.
_TINY = 1e-300


class SubjectSpreads:
    """Map from coordinates to phi: each subject's log trial SD, less that of the cell.

    Parameters
    ----------
    statistics : Statistics
        With the scatter of each subject's trials in each of C cells.
    """

    def __init__(self, statistics: Statistics) -> None:
        scatter = statistics.scatter
        quantities, _ = scatter.squares.shape
        df = np.zeros(statistics.group.shape)
        df[scatter.subject, scatter.cell] = scatter.df
        self._squares = np.zeros((quantities, *df.shape))  # (P, N, C)
        self._squares[:, scatter.subject, scatter.cell] = scatter.squares
        # A subject whose repeats are all equal has no log SD.
        scatters = self._squares.sum(axis=2, keepdims=True) > 0.0
        df = np.where(scatters, df, 0.0)
        of_cells = _variance(self._squares, df, axis=1)
        variance_ratio = _variance(self._squares / of_cells, df, axis=2)[..., 0]
        weight = 2.0 * df.sum(axis=2)  # (P, N) w
        log_sd = 0.5 * np.log(variance_ratio)
        total = np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
        weighted = (weight * log_sd).sum(axis=1, keepdims=True)
        about_level = log_sd - weighted / total
        #: (P, N, 1) w, and l - l̄
        self._weight = weight[..., None]
        self._rough = about_level[..., None]

    def __call__(
        self,
        coordinates: Array,
        omega: Array,
    ) -> tuple[Array, Array]:
        """Map coordinates (P, N, W) given omega_s (P, W) to phi (P, N, W) and log density (W,)."""
        omega = omega[:, None]
        precision = 1.0 + self._weight * omega * omega
        root = np.sqrt(precision)
        along = self._weight / root
        squares = np.square(along).sum(axis=1, keepdims=True)
        direction = along / np.sqrt(squares + _TINY)
        shares = self._weight / precision
        total = self._weight.sum(axis=1, keepdims=True) + _TINY
        total_share = shares.sum(axis=1, keepdims=True) + _TINY
        g = np.sqrt(total / total_share)
        pull = omega * self._weight * self._rough / root
        moved = (g * g - 1.0) * pull + (g - 1.0) * coordinates
        along = np.einsum("pnw,pnw->pw", direction, moved)
        f = (pull + coordinates + direction * along[:, None]) / root
        quantities, subjects, _ = coordinates.shape
        # The prior of f times the Jacobian of the map, g prod(s^(-1/2)).
        log_jacobian = np.log(g).sum(axis=(0, 1))
        log_jacobian -= np.log(root).sum(axis=(0, 1))
        squares = np.einsum("pnw,pnw->w", f, f)
        log_prior = -0.5 * (squares + _LOG_2PI * quantities * subjects)
        return omega * f, log_prior + log_jacobian

    def cells_given(self, phi: Array) -> Array:
        """How far phi (P, N, W) moves the rough log SDs of cells, (P, C, W)."""
        inverse_variance_ratios = np.exp(-2.0 * phi)
        adjusted = np.einsum("pnc,pnw->pcw", self._squares, inverse_variance_ratios)
        unadjusted = self._squares.sum(axis=1)[..., None]
        has_scatter = (adjusted > 0.0) & (unadjusted > 0.0)
        unmoved = np.ones_like(adjusted)
        variance_ratio = np.divide(adjusted, unadjusted, out=unmoved, where=has_scatter)
        return np.asarray(0.5 * np.log(variance_ratio))


def _variance(
    squares: Array,
    df: Array,
    axis: int,
) -> Array:
    """Variances from squares and df (P, N, C) summed over an axis; one where nothing scatters."""
    total = squares.sum(axis=axis, keepdims=True)
    total_df = df.sum(axis=axis, keepdims=True)
    variance = total / np.maximum(total_df, 1.0)
    return np.where(variance > 0.0, variance, 1.0)
