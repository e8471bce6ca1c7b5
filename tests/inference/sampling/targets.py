"""Targets whose law is known, with exact draws and functions that are uniform under it."""

from __future__ import annotations

import numpy as np
from scipy import special, stats

from percept.inference.sampling.gate import Estimates


class Normal:
    """Independent standard normals; uniform: each coordinate's CDF."""

    def __init__(self, dimension):
        self.names = [f"x[{i}]" for i in range(dimension)]

    def __call__(self, points):
        return -0.5 * (points**2).sum(axis=1)

    def exact(self, count, rng):
        return rng.standard_normal((count, len(self.names)))

    def uniforms(self, points):
        return special.ndtr(points)


class Correlated(Normal):
    """Normal with correlations up to 0.95 and scales over two decades; uniform: coordinates and
    contrasts."""

    def __init__(self, dimension=6):
        super().__init__(dimension)
        rng = np.random.default_rng(77)
        mix = np.eye(dimension) + 0.9 * np.tril(rng.normal(size=(dimension, dimension)), -1)
        self.factor = np.diag(np.logspace(-1, 1, dimension)) @ mix
        self.inverse = np.linalg.inv(self.factor)

    def __call__(self, points):
        return -0.5 * ((points @ self.inverse.T) ** 2).sum(axis=1)

    def exact(self, count, rng):
        return rng.standard_normal((count, len(self.names))) @ self.factor.T

    def uniforms(self, points):
        sd = np.sqrt((self.factor**2).sum(axis=1))
        return special.ndtr(np.hstack([points / sd, points @ self.inverse.T]))


class SkewedHeavy(Normal):
    """Gumbel (skewed) and Student t with 4 degrees of freedom (heavy) coordinates in turn."""

    def __init__(self, dimension=5):
        super().__init__(dimension)
        self._laws = [stats.gumbel_r() if i % 2 == 0 else stats.t(4) for i in range(dimension)]

    def __call__(self, points):
        heavy, skewed = points[:, 1::2], points[:, ::2]
        with np.errstate(over="ignore"):
            return -2.5 * np.log1p(heavy**2 / 4).sum(axis=1) - (skewed + np.exp(-skewed)).sum(
                axis=1
            )

    def exact(self, count, rng):
        return np.stack([law.ppf(rng.random(count)) for law in self._laws], axis=1)

    def uniforms(self, points):
        return np.stack(
            [law.cdf(column) for law, column in zip(self._laws, points.T, strict=True)], axis=1
        )


def deviations(uniforms):
    """Moments of uniforms over ensembles, in standard errors of the ensembles' scatter.

    Parameters
    ----------
    uniforms : ndarray, shape (E, ..., Q)
        Uniform variables if the sampler is right; ensembles independent.

    Returns
    -------
    ndarray, shape (2 Q + 1,)
        Student t with E - 1 degrees of freedom each; the last is the second moment over all Q
        together.
    """
    ensembles, count = uniforms.shape[0], uniforms.shape[-1]
    centred = uniforms.reshape(ensembles, -1, count) - 0.5
    first, second = centred.mean(axis=1), (centred**2).mean(axis=1) - 1 / 12
    found = np.concatenate([first, second, second.mean(axis=1, keepdims=True)], axis=1)
    return found.mean(axis=0) / (found.std(axis=0, ddof=1) / np.sqrt(ensembles))


def limit(ensembles, count, error=1e-4):
    """Bound that the largest of `count` such t variables stays within, but for probability
    `error`."""
    return float(stats.t.isf(0.5 * error / count, ensembles - 1))


class Means:
    """Posterior means of functions of the coordinates, their scale being the posterior SD."""

    def __init__(self, names, function):
        self._names = names
        self._function = function

    def components(self, points):
        return np.asarray(self._function(points))

    def estimates(self, components):
        mean = components.mean(axis=0)
        yield Estimates(self._names, mean, components.std(axis=0)), components - mean
