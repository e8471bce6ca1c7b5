"""A multivariate-t proposal fitted to a density before sampling starts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import special

__all__ = ["StudentT", "adapt", "find_mode"]

Array = NDArray[np.float64]
Density = Callable[[Array], Array]

_STEP = 1e-2  # finite differences of a log density whose coordinates have unit scale


@dataclasses.dataclass(frozen=True, eq=False)
class StudentT:
    """Multivariate t law.

    Attributes
    ----------
    centre : ndarray, shape (d,)
        Location.
    factor : ndarray, shape (d, d)
        Lower Cholesky factor of the scale matrix.
    df : float
        Degrees of freedom.
    """

    centre: Array
    factor: Array
    df: float

    def draw(self, count: int, rng: np.random.Generator | np.random.RandomState) -> Array:
        """Draw `count` points, shape (count, d)."""
        normal = rng.standard_normal((count, self.centre.size))
        radius = np.sqrt(self.df / rng.chisquare(self.df, size=count))
        return self.centre + radius[:, None] * (normal @ self.factor.T)

    def log_density(self, points: Array) -> Array:
        """Log density at points of shape (N, d), shape (N,)."""
        size = self.centre.size
        whitened = self.inverse @ (points - self.centre).T
        distance = np.einsum("dn,dn->n", whitened, whitened)
        constant = (
            special.gammaln(0.5 * (self.df + size))
            - special.gammaln(0.5 * self.df)
            - 0.5 * size * math.log(math.pi * self.df)
            - float(np.log(np.diag(self.factor)).sum())
        )
        return constant - 0.5 * (self.df + size) * np.log1p(distance / self.df)

    @property
    def inverse(self) -> Array:
        """Inverse of `factor`."""
        return np.linalg.solve(self.factor, np.eye(self.centre.size))


def find_mode(density: Density, start: Array, *, iterations: int = 30) -> tuple[Array, Array]:
    """Climb to a mode and measure the curvature there.

    Newton steps on central differences, with the Hessian's eigenvalues kept negative and the step
    halved until the density rises; all points of one step are evaluated in one call.

    Parameters
    ----------
    density : callable
        Log density of points (N, d), returning (N,).
    start : ndarray, shape (d,)
        Where to begin.
    iterations : int
        Most Newton steps.

    Returns
    -------
    mode : ndarray, shape (d,)
        The point reached.
    covariance : ndarray, shape (d, d)
        Inverse of the negative Hessian there, eigenvalues limited to [1e-6, 4].
    """
    point, lengths = start, 0.5 ** np.arange(12)
    value = float(density(point[None])[0])
    for _ in range(iterations):
        gradient, hessian = _derivatives(density, point)
        covariance = _limited_inverse(hessian)
        step = covariance @ gradient
        trials = point + lengths[:, None] * step
        values = density(trials)
        best = int(np.argmax(values))
        if not values[best] > value:
            break
        rise = values[best] - value
        point, value = trials[best], float(values[best])
        if rise < 1e-3:
            break
    return point, _limited_inverse(_derivatives(density, point)[1])


def _derivatives(density: Density, point: Array) -> tuple[Array, Array]:
    size = point.size
    steps = _STEP * np.eye(size)
    rows, columns = np.triu_indices(size, 1)
    points = np.concatenate(
        [
            point[None],
            point + steps,
            point - steps,
            point + steps[rows] + steps[columns],
            point - steps[rows] - steps[columns],
        ]
    )
    values = density(points)
    centre, up, down = values[0], values[1 : size + 1], values[size + 1 : 2 * size + 1]
    both = values[2 * size + 1 :].reshape(2, -1)
    gradient = (up - down) / (2.0 * _STEP)
    hessian = np.diag((up + down - 2.0 * centre) / _STEP**2)
    # f(x+hi+hj) + f(x-hi-hj) - 2f = h²(Hii + Hjj + 2Hij)
    mixed = (both.sum(axis=0) - 2.0 * centre) / _STEP**2
    mixed = 0.5 * (mixed - hessian[rows, rows] - hessian[columns, columns])
    hessian[rows, columns] = mixed
    hessian[columns, rows] = mixed
    return gradient, hessian


def _limited_inverse(hessian: Array) -> Array:
    """Inverse of -H with its eigenvalues between 1e-6 and 4: priors have unit scale."""
    values, vectors = np.linalg.eigh(-np.nan_to_num(hessian))
    return (vectors / np.clip(values, 0.25, 1e6)) @ vectors.T


def adapt(
    density: Density,
    start: StudentT,
    rng: np.random.Generator,
    *,
    draws: int = 1024,
    rounds: int = 6,
) -> tuple[StudentT, Array]:
    """Fit a t law to a density by importance weights.

    Each round draws from the current law, weighs by density over law (tempered until the weights
    are worth at least a few times the dimension), and takes the weighted mean and covariance.

    Parameters
    ----------
    density : callable
        Log density of points (N, d), returning (N,).
    start : StudentT
        First law.
    rng : numpy.random.Generator
        Source of randomness.
    draws : int
        Draws per round.
    rounds : int
        Rounds.

    Returns
    -------
    law : StudentT
        The fitted law.
    points : ndarray, shape (draws, d)
        Points resampled by their weights, to start walkers from.
    """
    law = start
    size = law.centre.size
    kept, kept_log_weights = [], []
    for _ in range(rounds):
        points = law.draw(draws, rng)
        log_weights = density(points) - law.log_density(points)
        kept.append(points)
        kept_log_weights.append(log_weights)
        weights = _tempered(log_weights, at_least=min(0.5 * draws, 10.0 * size))
        centre = weights @ points
        deviation = points - centre
        covariance = (weights[:, None] * deviation).T @ deviation
        # The t law's covariance is df/(df - 2) times its scale matrix.
        law = StudentT(centre, np.linalg.cholesky(covariance * (law.df - 2.0) / law.df), law.df)
    weights = _tempered(kept_log_weights[-1], at_least=2.0)
    chosen = rng.choice(draws, size=draws, p=weights)
    return law, kept[-1][chosen]


def _tempered(log_weights: Array, *, at_least: float) -> Array:
    """Normalised weights raised to the largest power in (0, 1] that leaves the wanted effective size."""
    shifted = log_weights - log_weights.max()
    power = 1.0
    for _ in range(40):
        weights = np.exp(power * shifted)
        weights /= weights.sum()
        if 1.0 / float(weights @ weights) >= at_least:
            break
        power *= 0.8
    return weights
