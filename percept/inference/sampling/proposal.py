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
    _constant: float = dataclasses.field(init=False, repr=False)
    _cosh: Array = dataclasses.field(init=False, repr=False)
    _sinh: Array = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        size = self.centre.size
        constant = (
            special.gammaln(0.5 * (_DF + size))
            - special.gammaln(0.5 * _DF)
            - 0.5 * size * math.log(math.pi * _DF)
            - float(np.log(np.diag(self.factor)).sum() + np.log(self.width).sum())
        )
        object.__setattr__(self, "_constant", constant)
        object.__setattr__(self, "_cosh", np.cosh(self.skew))
        object.__setattr__(self, "_sinh", np.sinh(self.skew))

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

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` points, shape (count, d)."""
        normal = rng.standard_normal((count, self.centre.size))
        return self.from_noise(normal, rng.standard_gamma(0.5 * _DF, size=count))

    def from_noise(self, normal: Array, gamma: Array) -> Array:
        """Turn noise into points of the law.

        Parameters
        ----------
        normal : ndarray, shape (N, d)
            Standard normal noise.
        gamma : ndarray, shape (N,)
            Standard gamma noise of shape `gamma_shape`.

        Returns
        -------
        ndarray, shape (N, d)
        """
        radius = np.sqrt(0.5 * _DF / gamma)
        return self._map(self.centre + radius[:, None] * (normal @ self.factor.T))

    @property
    def gamma_shape(self) -> float:
        """Shape of the gamma noise that `from_noise` wants."""
        return 0.5 * _DF

    @property
    def turn_shape(self) -> float:
        """Shape of the gamma noise that `turn` wants."""
        return 0.5 * (_DF + self.centre.size)

    def turn(self, points: Array, normal: Array, gamma: Array, angle: Array) -> Array:
        """Turn points about the centre, leaving the law invariant.

        A t law is normal given its radius: drawing the radius given the point and rotating towards
        a normal draw of that radius is reversible with respect to the law, at any angle.

        Parameters
        ----------
        points, normal : ndarray, shape (N, d)
            Points, and standard normal noise.
        gamma : ndarray, shape (N,)
            Standard gamma noise of shape `turn_shape`.
        angle : ndarray, shape (N,)
            rad; a right angle forgets the point's direction.

        Returns
        -------
        ndarray, shape (N, d)
        """
        z = self._unmap(points)[0] - self.centre
        whitened = self.inverse @ z.T
        distance = np.einsum("dn,dn->n", whitened, whitened)
        radius = np.sqrt(0.5 * (_DF + distance) / gamma)
        towards = radius[:, None] * (normal @ self.factor.T)
        turned = np.cos(angle)[:, None] * z + np.sin(angle)[:, None] * towards
        return self._map(self.centre + turned)

    def _map(self, z: Array) -> Array:
        # sinh(asinh(z) + e) by the addition theorem: no transcendental function per value.
        return self.location + self.width * (z * self._cosh + np.sqrt(1.0 + z * z) * self._sinh)

    def _unmap(self, points: Array) -> tuple[Array, Array]:
        """Z of each point, and dz/dx up to the constant 1/width."""
        linear = (points - self.location) / self.width
        root = np.sqrt(1.0 + linear * linear)
        return linear * self._cosh - root * self._sinh, self._cosh - linear / root * self._sinh

    def log_density(self, points: Array) -> Array:
        """Log density at points of shape (N, d), shape (N,)."""
        z, slope = self._unmap(points)
        whitened = self.inverse @ (z - self.centre).T
        distance = np.einsum("dn,dn->n", whitened, whitened)
        size = self.centre.size
        return self._constant + np.log(slope).sum(axis=1) - 0.5 * (_DF + size) * np.log1p(distance / _DF)


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
