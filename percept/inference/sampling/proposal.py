"""An independence proposal: a multivariate t law, each coordinate skewed to fit a sample."""

from __future__ import annotations

import dataclasses
import math
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

__all__ = ["Proposal"]

Array = NDArray[np.float64]
_DF = 15.0
_QUANTILE = 2.0  # skewness is read off the quantiles at Phi(-2), 1/2 and Phi(2)
_RATIO = 3.3  # most a coordinate's upper spread may exceed its lower, or the other way round


@dataclasses.dataclass(frozen=True, eq=False)
class Proposal:
    """Law of x = location + width sinh(asinh(z) + skew), z multivariate t.

    Attributes
    ----------
    location, width, skew : ndarray, shape (d,)
        The map of each coordinate; skew 0 leaves it linear.
    centre : ndarray, shape (d,)
        Centre of z.
    factor : ndarray, shape (d, d)
        Lower Cholesky factor of the scale matrix of z.
    inverse : ndarray, shape (d, d)
        Inverse of `factor`.
    """

    location: Array
    width: Array
    skew: Array
    centre: Array
    factor: Array
    inverse: Array

    @classmethod
    def normal(cls, centre: Array, covariance: Array) -> Self:
        """Law without skewness, of given centre (d,) and covariance (d, d)."""
        size = centre.size
        return cls._with(np.zeros(size), np.ones(size), np.zeros(size), centre, covariance)

    @classmethod
    def fit(cls, points: Array, weights: Array | None = None, *, skewed: bool = True) -> Self:
        """Fit the law to a sample.

        Parameters
        ----------
        points : ndarray, shape (N, d)
            Sample, N well above d.
        weights : ndarray, shape (N,), optional
            Weights that sum to one; equal by default.
        skewed : bool
            Whether to fit the skewness of each coordinate.

        Returns
        -------
        Proposal
        """
        size = points.shape[1]
        share = np.full(len(points), 1.0 / len(points)) if weights is None else weights
        location, width, skew = np.zeros(size), np.ones(size), np.zeros(size)
        if skewed:
            location, width, skew = _skewness(points)
        z = np.sinh(np.arcsinh((points - location) / width) - skew) if skewed else points
        centre = share @ z
        deviation = z - centre
        covariance = (share[:, None] * deviation).T @ deviation
        return cls._with(location, width, skew, centre, covariance)

    @classmethod
    def _with(cls, location: Array, width: Array, skew: Array, centre: Array, covariance: Array) -> Self:
        # A t law's covariance is df/(df - 2) times its scale matrix; a ridge lets a thin sample be factored.
        scale = covariance * ((_DF - 2.0) / _DF)
        scale = scale + 1e-10 * np.trace(scale) / len(scale) * np.eye(len(scale))
        factor = np.linalg.cholesky(scale)
        return cls(location, width, skew, centre, factor, np.linalg.inv(factor))

    def draw(self, count: int, rng: np.random.Generator | np.random.RandomState) -> Array:
        """Draw `count` points, shape (count, d)."""
        normal = rng.standard_normal((count, self.centre.size))
        radius = np.sqrt(_DF / rng.chisquare(_DF, size=count))
        return self._map(self.centre + radius[:, None] * (normal @ self.factor.T))

    def turn(self, points: Array, rng: np.random.RandomState) -> Array:
        """Turn points about the centre by random angles, leaving the law invariant.

        A t law is normal given its radius: drawing the radius given the point and rotating towards
        a normal draw of that radius is reversible with respect to the law.

        Parameters
        ----------
        points : ndarray, shape (N, d)
            Points.
        rng : numpy.random.RandomState
            Source of randomness.

        Returns
        -------
        ndarray, shape (N, d)
        """
        count, size = points.shape
        z = np.sinh(np.arcsinh((points - self.location) / self.width) - self.skew) - self.centre
        whitened = self.inverse @ z.T
        distance = np.einsum("dn,dn->n", whitened, whitened)
        precision = rng.standard_gamma(0.5 * (_DF + size), size=count) / (0.5 * (_DF + distance))
        towards = (rng.standard_normal((count, size)) @ self.factor.T) / np.sqrt(precision)[:, None]
        angle = 0.5 * math.pi * rng.random_sample((count, 1))
        return self._map(self.centre + np.cos(angle) * z + np.sin(angle) * towards)

    def _map(self, z: Array) -> Array:
        return self.location + self.width * np.sinh(np.arcsinh(z) + self.skew)

    def log_density(self, points: Array) -> Array:
        """Log density at points of shape (N, d), shape (N,)."""
        size = self.centre.size
        linear = (points - self.location) / self.width
        angle = np.arcsinh(linear) - self.skew
        whitened = self.inverse @ (np.sinh(angle) - self.centre).T
        distance = np.einsum("dn,dn->n", whitened, whitened)
        constant = (
            special.gammaln(0.5 * (_DF + size))
            - special.gammaln(0.5 * _DF)
            - 0.5 * size * math.log(math.pi * _DF)
            - float(np.log(np.diag(self.factor)).sum() + np.log(self.width).sum())
        )
        jacobian = np.log(np.cosh(angle) / np.sqrt(1.0 + linear * linear)).sum(axis=1)
        return constant + jacobian - 0.5 * (_DF + size) * np.log1p(distance / _DF)


def _skewness(points: Array) -> tuple[Array, Array, Array]:
    """Location, width and skew that match three quantiles of each coordinate.

    With a = asinh(q), the upper over the lower spread of sinh(asinh(z) + e) between z = -q, 0, q is
    cosh(e + a/2)/cosh(e - a/2), which is solved for e.
    """
    low, middle, high = np.quantile(points, special.ndtr([-_QUANTILE, 0.0, _QUANTILE]), axis=0)
    angle = math.asinh(_QUANTILE)
    ratio = np.clip((high - middle) / (middle - low), 1.0 / _RATIO, _RATIO)
    up, down = math.exp(0.5 * angle), math.exp(-0.5 * angle)
    skew = 0.5 * np.log((ratio * up - down) / (up - ratio * down))
    width = (high - low) / (np.sinh(angle + skew) - np.sinh(skew - angle))
    return middle - width * np.sinh(skew), width, skew
