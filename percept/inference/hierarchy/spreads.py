"""Coordinates that follow the data, for the SDs of one level: between subjects, or trials.

For one quantity, log sigma = m + U h + omega e over J cells. h are the multiples of the prior SDs
of the trend's two columns U, and h and e are standard normal. A rough likelihood
N(log sigma; l, diag(1/w)) makes log sigma, given omega, normal with some covariance C. The
coordinates u are C^(-1/2) times the distance from its mean: neither a centred nor a non-centred
form is good for all data. The rough likelihood shapes the coordinates alone: the Jacobian is
included, so the prior is exact.

The trend is integrated out of log sigma. It has its own coordinates, and follows its exact law
given log sigma and omega, of which the data say nothing more.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["SpreadMap", "TiedSpreads"]

Array = NDArray[np.float64]


class Spreads(NamedTuple):
    """Log SDs at W sets of coordinates. Of one quantity, the arrays have no axis P."""

    log_sigma: Array  # (P, J, W)
    multiples: Array  # (P, 2, W) Coefficients of the trend over their prior SDs
    log_density: Array  # (W,) Of the coordinates under the prior, up to a constant


@dataclasses.dataclass(frozen=True, eq=False)
class _LowerFactor:
    """Lower factors L of 2 x 2 matrices, entries (W,)."""

    l11: Array
    l21: Array
    l22: Array

    def solve(self, right: Array) -> tuple[Array, Array]:
        """L^(-1) times vectors (2, W)."""
        first = right[0] / self.l11
        return first, (right[1] - self.l21 * first) / self.l22


class SpreadMap:
    """Map coordinates to the spreads of one quantity at one level.

    Parameters
    ----------
    centre : float
        Prior mean m of log sigma.
    loadings : ndarray
        Columns U of the trend times their prior SDs, (2, J).
    rough_mean, rough_weight : ndarray
        Rough likelihood of log sigma, l and w, (J,); a cell of weight zero has none.
    """

    def __init__(
        self, centre: float, loadings: Array, rough_mean: Array, rough_weight: Array
    ) -> None:
        cells = loadings.shape[1]
        self._centre = centre
        # Padded, so that a single cell has two singular values too.
        padded = np.pad(loadings, ((0, 0), (0, 1)))
        self._turn, singular_values, basis = np.linalg.svd(padded, full_matrices=False)
        # U' = turn diag(size) basis: the two multiples turn'h are independent given log sigma.
        self._size = singular_values[:, None]
        self._basis = np.where(self._size > 0, basis[:, :cells], 0.0)
        self._loading = self._size * self._basis
        first, second = self._loading
        self._products = np.stack([first * first, first * second, second * second])
        self._rough_departure = (rough_mean - centre)[:, None]  # l - m
        self._weight = rough_weight[:, None]

    def __call__(self, u: Array, omega: Array, trend: Array, shift: Array | float = 0.0) -> Spreads:
        """Map u (J, W), omega (W,) and trend (2, W), the rough means moved by a shift (J, W)."""
        rough_departure = self._rough_departure + shift
        variance = omega * omega
        # Given the trend: the precision of e under prior and rough likelihood, and its part q of w.
        precision = 1.0 + self._weight * variance
        root = np.sqrt(precision)
        weight = self._weight / precision
        h, root_det = self._turned_multiples(u / root, weight, precision, omega, rough_departure)
        middle = self._loading.T @ h
        # log sigma = m + middle + omega e: nothing is divided by an omega that may be tiny.
        e = weight * omega * (rough_departure - middle) + u / root
        # The prior's covariance UU' + omega² I differs from omega² I along the basis alone.
        e_along = self._basis @ e
        e_across = e - self._basis.T @ e_along
        along = self._size * h + omega * e_along
        variance_along = variance + self._size * self._size
        share = along / variance_along
        squares = np.einsum("jw,jw->w", e_across, e_across) + np.einsum("rw,rw->w", along, share)
        log_determinants = np.log(precision).sum(axis=0) + np.log(variance_along).sum(axis=0)
        log_density = np.log(root_det) - 0.5 * (squares + log_determinants)
        # The law of turn'h given log sigma: mean size share, SD omega / √variance_along.
        conditional_sd = omega / np.sqrt(variance_along)
        turned = self._size * share + conditional_sd * (self._turn.T @ trend)
        return Spreads(self._centre + middle + omega * e, self._turn @ turned, log_density)

    def _turned_multiples(
        self, u: Array, weight: Array, precision: Array, omega: Array, rough_departure: Array
    ) -> tuple[Array, Array]:
        """Multiples turn'h in log sigma, (2, W), and the root of det(omega² I + B), (W,).

        Given the trend the cells are independent, with variances omega²/s, s = 1 + w omega². With
        LL' = N the precision of the trend's multiples given the rough likelihood and
        G = s^(-1/2) U L'^(-1), the covariance is C = omega² s^(-1/2) (I + GG'/omega²) s^(-1/2). Its
        root needs that of the 2 x 2 matrix omega² I + B, B = G'G, alone. The given u is
        s^(-1/2) times the coordinates.
        """
        lower = self._precision_factor(weight)
        b11, b12, b22 = self._b(precision, lower)
        variance = omega * omega
        d11 = variance + b11
        d22 = variance + b22
        root_det = np.sqrt(d11 * d22 - b12 * b12)
        # The root of a 2 x 2 matrix D is (D + √det(D) I) / √(trace(D) + 2 √det(D)). The root R of
        # omega² I + B, plus omega I, is what takes whitened multiples to u: a root of C takes v to
        # s^(-1/2) (omega v + G (R + omega I)^(-1) G'v), by R² = omega² I + B.
        over = 1.0 / np.sqrt(d11 + d22 + 2.0 * root_det)
        r11 = omega + (d11 + root_det) * over
        r12 = b12 * over
        r22 = omega + (d22 + root_det) * over
        det = r11 * r22 - r12 * r12
        first, second = lower.solve(self._loading @ u)
        y1 = (r22 * first - r12 * second) / det
        y2 = (r11 * second - r12 * first) / det
        # The mean L'^(-1) L^(-1) U'q(l - m), and the departure L'^(-1) y from it.
        mean1, mean2 = lower.solve(self._loading @ (weight * rough_departure))
        h2 = (y2 + mean2) / lower.l22
        h1 = (y1 + mean1 - lower.l21 * h2) / lower.l11
        return np.stack([h1, h2]), root_det

    def _precision_factor(self, weight: Array) -> _LowerFactor:
        """Lower factor of N = I + U' diag(q) U, q the weights (J, W) given omega."""
        n11, n12, n22 = self._products @ weight
        l11 = np.sqrt(1.0 + n11)
        # 1 + n22 - l21², without the difference of large numbers that the last two may be.
        det_n = np.maximum(n11 * n22 - n12 * n12, 0.0)
        l22 = np.sqrt((1.0 + n11 + n22 + det_n) / (1.0 + n11))
        return _LowerFactor(l11, n12 / l11, l22)

    def _b(self, precision: Array, lower: _LowerFactor) -> tuple[Array, Array, Array]:
        """Entries 11, 12 and 22 of B = L^(-1) U' diag(1/s) U L'^(-1)."""
        c11, c12, c22 = self._products @ (1.0 / precision)
        tilt = lower.l21 / lower.l11
        b11 = c11 / (lower.l11 * lower.l11)
        b12 = (c12 - tilt * c11) / (lower.l11 * lower.l22)
        c22_across = c22 - 2.0 * tilt * c12 + tilt * tilt * c11
        b22 = np.maximum(c22_across, 0.0) / (lower.l22 * lower.l22)
        return b11, b12, b22


class TiedSpreads:
    """Spreads of one level of one quantity or two, the second's given the first's.

    The rough likelihood of log sigma of b is N(l + slope (log sigma of k - its l), (1 - tie²)/w).
    Near a correlation of one the ratio of the two is known far better than either.

    Parameters
    ----------
    centre : float
        Prior mean of log sigma.
    loadings : ndarray
        Columns of the trend times their prior SDs, (P, 2, J).
    rough_mean, rough_weight : ndarray
        Rough likelihood of log sigma, (P, J).
    tie : float
        Correlation of the rough log SDs of both quantities.
    """

    def __init__(
        self, centre: float, loadings: Array, rough_mean: Array, rough_weight: Array, tie: float
    ) -> None:
        tied = (rough_weight > 0).all(axis=0)
        self.weight = rough_weight.copy()
        self.weight[1:] /= np.where(tied, 1.0 - tie * tie, 1.0)
        self._maps = []
        for arguments in zip(loadings, rough_mean, self.weight, strict=True):
            self._maps.append(SpreadMap(centre, *arguments))
        ratio = rough_weight[0] / np.where(tied, rough_weight[-1], 1.0)
        self._slope = np.where(tied, tie * np.sqrt(ratio), 0.0)[:, None]
        self._rough_mean = rough_mean[0][:, None]

    def __call__(self, u: Array, omega: Array, trend: Array) -> Spreads:
        """Map coordinates (P, J, W), given omega (P, W) and the trend (P, 2, W), to spreads."""
        first = self._maps[0](u[0], omega[0], trend[0])
        spreads = [first]
        for second_map in self._maps[1:]:
            shift = self._slope * (first.log_sigma - self._rough_mean)
            spreads.append(second_map(u[1], omega[1], trend[1], shift))
        return Spreads(
            log_sigma=np.stack([spread.log_sigma for spread in spreads]),
            multiples=np.stack([spread.multiples for spread in spreads]),
            log_density=np.sum([spread.log_density for spread in spreads], axis=0),
        )
