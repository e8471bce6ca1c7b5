"""Log SDs of one quantity about a trend, mapped from coordinates that follow the data.

The log SDs of one level (between subjects, or between trials) in J environments are

    log sigma = m + U h + omega e

    m       prior mean, one number
    U       columns of the trend, constant and slope, times their prior SDs, (J, 2)
    h       coefficients of the columns over their prior SDs, (2,), standard normal
    omega   SD of log sigma about the trend, one number
    e       departures from the trend over omega, (J,), standard normal

The data give log sigma a rough likelihood N(log sigma; l, diag(1/w)), with l and w (J,). Given
omega, log sigma is then normal with some mean and covariance C. The coordinates of log sigma are

    u = C^(-1/2) (log sigma - mean)

so that they are near standard normal under the posterior. Neither a centred nor a non-centred form
is that for all data. The rough likelihood shapes the coordinates alone: the Jacobian is included,
so the prior is exact.

Given omega, prior and rough likelihood give in turn

    s = 1 + w omega²                      precision of e given h, (J,)
    q = w / s                             weight of l about the trend, (J,)
    L L' = I + U' diag(q) U               precision of h, (2, 2)
    G = diag(s)^(-1/2) U L'^(-1)          (J, 2)
    C = diag(s)^(-1/2) (omega² I + G G') diag(s)^(-1/2)

A root of C needs the root of a 2 x 2 matrix only. With B = G'G and R = (omega² I + B)^(1/2),

    (omega² I + G G')^(1/2) = omega I + G (R + omega I)^(-1) G'

and the map from u is, with nothing divided by an omega that may be tiny,

    y = (R + omega I)^(-1) G'u
    h = L'^(-1) (L^(-1) U' diag(q) (l - m) + y)
    e = omega q (l - m - U h) + u / √s

This h is one of many that give the same log sigma. The prior density is that of log sigma, with
the trend integrated out. The trend has two coordinates of its own, standard normal, and takes its
exact law given log sigma and omega, of which the data say nothing more.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["LogSpreads", "TrendMap"]

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)


@dataclasses.dataclass(frozen=True, eq=False)
class LogSpreads:
    """Log SDs at W sets of coordinates, and what they are made of."""

    log_sigma: Array  # (C, W)
    multiples: Array  # (K, W) h: coefficients over their prior SDs
    log_density: Array  # (W,) Of the coordinates under the prior


class TrendMap:
    """Map coordinates to the log SDs of one quantity at one level.

    Parameters
    ----------
    centre : float
        Prior mean m of log sigma.
    loadings : ndarray
        U', (K, J) with K at most two; missing rows are zero.
    rough_mean, rough_weight : ndarray
        Rough likelihood of log sigma, l and w, (J,); an environment of weight zero has none.
    """

    def __init__(
        self,
        centre: float,
        loadings: Array,
        rough_mean: Array,
        rough_weight: Array,
    ) -> None:
        count, environments = loadings.shape
        #: K
        self._count = count
        self._centre = centre
        self._weight = rough_weight[:, None]  # (J, 1) w
        self._rough_departure = (rough_mean - centre)[:, None]  # (J, 1) l - m
        # Turn the trend: U' = rotation diag(sizes) directions. All formulas hold for the turned
        # columns, which are orthogonal, and the turned coefficients rotation'h.
        # Padded to two rows, and so that a single environment has two singular values too.
        padded = np.pad(loadings, ((0, 2 - count), (0, 1)))
        self._rotation, sizes, directions = np.linalg.svd(padded, full_matrices=False)
        self._sizes = sizes[:, None]  # (2, 1)
        # A direction without size is arbitrary: it may even point into the padding.
        within = directions[:, :environments]
        self._directions = np.where(self._sizes > 0, within, 0.0)  # (2, J)
        self._loadings = self._sizes * self._directions  # (2, J) U' turned
        constant, slope = self._loadings
        products = [
            constant * constant,
            constant * slope,
            slope * slope,
        ]
        #: (3, J) Times x (J,), these give the entries 11, 12 and 22 of U' diag(x) U.
        self._products = np.stack(products)

    def __call__(
        self,
        trend: Array,
        u: Array,
        omega: Array,
        shift: Array | float = 0.0,
    ) -> LogSpreads:
        """Map coordinates to log SDs at W sets of scales.

        Parameters
        ----------
        trend : ndarray
            Coordinates of the trend, (K, W), standard normal.
        u : ndarray
            Coordinates of log sigma, (J, W).
        omega : ndarray
            SD of log sigma about the trend, (W,).
        shift : ndarray, optional
            What is added to the rough means l, (J, W).
        """
        rough_departure = self._rough_departure + shift
        variance = omega * omega
        precision = 1.0 + self._weight * variance  # s
        weight = self._weight / precision  # q
        scaled_u = u / np.sqrt(precision)
        lower = self._trend_factor(weight)
        b = self._b(precision, lower)
        widened = b.plus_identity(variance)  # omega² I + B
        solver = widened.root().plus_identity(omega)  # R + omega I
        g_u = lower.solve(self._loadings @ scaled_u)  # G'u
        y = solver.solve(g_u)
        pull = self._loadings @ (weight * rough_departure)
        whitened_mean = lower.solve(pull)
        h = lower.solve_transposed(y + whitened_mean)
        about_trend = self._loadings.T @ h  # U h
        unexplained = rough_departure - about_trend
        e = omega * weight * unexplained + scaled_u

        # The prior covariance omega² I + UU' of log sigma is omega² I but along two directions.
        e_along = self._directions @ e
        e_across = e - self._directions.T @ e_along
        along = self._sizes * h + omega * e_along
        variance_along = variance + self._sizes * self._sizes
        whitened_along = along / variance_along
        squares = np.einsum("jw,jw->w", e_across, e_across)
        squares += np.einsum("rw,rw->w", along, whitened_along)
        # Half of log det C less half of log det(omega² I + UU'): powers of omega cancel.
        log_precision = np.log(precision).sum(axis=0)
        log_variance = np.log(variance_along).sum(axis=0)
        root_determinant = np.sqrt(widened.determinant())
        subtracted = squares + (log_precision + log_variance)
        log_density = np.log(root_determinant) - 0.5 * subtracted
        log_density -= 0.5 * _LOG_2PI * len(u)

        # The turned coefficients are independent given log sigma, with these means and SDs.
        conditional_mean = self._sizes * whitened_along
        conditional_sd = omega / np.sqrt(variance_along)
        # Missing rows have no coordinates.
        turned_trend = self._rotation[: self._count].T @ trend
        turned = conditional_mean + conditional_sd * turned_trend
        multiples = self._rotation @ turned
        return LogSpreads(
            log_sigma=self._centre + about_trend + omega * e,
            multiples=multiples[: self._count],
            log_density=log_density,
        )

    def _trend_factor(self, weight: Array) -> _Lower:
        """L, from the weights q (J, W)."""
        n11, n12, n22 = self._products @ weight  # U' diag(q) U
        first = 1.0 + n11
        l11 = np.sqrt(first)
        # 1 + n22 - l21², without the difference of large numbers that the last two may be.
        determinant = np.maximum(n11 * n22 - n12 * n12, 0.0)
        whole = first + n22 + determinant
        l22 = np.sqrt(whole / first)
        return _Lower(l11, n12 / l11, l22)

    def _b(self, precision: Array, lower: _Lower) -> _Symmetric:
        """B = G'G = L^(-1) U' diag(1/s) U L'^(-1), from the precisions s (J, W)."""
        inverse = 1.0 / precision
        c11, c12, c22 = self._products @ inverse  # U' diag(1/s) U
        l11 = lower.l11
        l22 = lower.l22
        tilt = lower.l21 / l11
        c12_across = c12 - tilt * c11
        c22_across = c22 - 2.0 * tilt * c12 + tilt * tilt * c11
        # Rounding may leave a square just below zero.
        c22_across = np.maximum(c22_across, 0.0)
        return _Symmetric(
            s11=c11 / (l11 * l11),
            s12=c12_across / (l11 * l22),
            s22=c22_across / (l22 * l22),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Lower:
    """Lower triangular matrices L."""

    l11: Array
    l21: Array
    l22: Array

    def solve(self, right: Array) -> Array:
        """L^(-1) times vectors."""
        x = np.empty_like(right)
        x[0] = right[0] / self.l11
        remaining = right[1] - self.l21 * x[0]
        x[1] = remaining / self.l22
        return x

    def solve_transposed(self, right: Array) -> Array:
        """L'^(-1) times vectors."""
        x = np.empty_like(right)
        x[1] = right[1] / self.l22
        remaining = right[0] - self.l21 * x[1]
        x[0] = remaining / self.l11
        return x


@dataclasses.dataclass(frozen=True, eq=False)
class _Symmetric:
    """Symmetric matrices, positive definite wherever a root or a solution is asked for."""

    s11: Array
    s12: Array
    s22: Array

    def plus_identity(self, factor: Array) -> _Symmetric:
        """Sum with the identity matrix times a factor (W,)."""
        return _Symmetric(self.s11 + factor, self.s12, self.s22 + factor)

    def determinant(self) -> Array:
        """Return the determinants."""
        product = self.s11 * self.s22
        return product - self.s12 * self.s12

    def root(self) -> _Symmetric:
        """Symmetric square root of a matrix D: (D + √det(D) I) / √(trace(D) + 2 √det(D))."""
        root_determinant = np.sqrt(self.determinant())
        trace = self.s11 + self.s22
        scale = 1.0 / np.sqrt(trace + 2.0 * root_determinant)
        shifted = self.plus_identity(root_determinant)
        return _Symmetric(
            s11=shifted.s11 * scale,
            s12=shifted.s12 * scale,
            s22=shifted.s22 * scale,
        )

    def solve(self, right: Array) -> Array:
        """Inverse times vectors."""
        determinant = self.determinant()
        x = np.empty_like(right)
        x[0] = self.s22 * right[0] - self.s12 * right[1]
        x[1] = self.s11 * right[1] - self.s12 * right[0]
        return x / determinant
