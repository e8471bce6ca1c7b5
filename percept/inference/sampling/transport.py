"""A fitted change of coordinates that makes a sample look standard normal.

Two layers lead from standard coordinates z over y to the target's x:

    all coordinates together      y = L z
    each coordinate by itself     x_i = S_i(y_i)

L is a lower factor of a correlation matrix, and S_i an increasing spline (`margins`). The log
Jacobian is the sum of log diag(L) and of log S_i'.

The map assumes nothing of the target but a sample, and any such map is exact: a poor fit costs
steps of the sampler, not accuracy. Walkers live at z, so that only this direction is ever needed.

A fit goes the other way: the sample's normal scores stand for y. Both layers keep only what stands
out of chance. Further layers, in which some coordinates bend or widen others, gain a tenth in
autocorrelation times: the model's own coordinates leave them little to do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.sampling.diagnostics import normal_scores
from percept.inference.sampling.margins import Spline

__all__ = ["Transport"]

Array = NDArray[np.float64]

#: Standard errors within which a correlation may count as none. Chance leaves six once in 500
#: million pairs: no sample needs a higher level.
_NOISE_LEVELS = np.arange(2.0, 6.5, 0.5)
#: Largest fraction of the correlations kept that may be chance: most are real then.
_MOST_BY_CHANCE = 0.5
#: Correlations that have no factor are multiplied by this until they have one: each was shrunk by
#: itself, and together they may fit no joint law.
_SHRINKAGE = 0.9
#: Points mapped at a time: their temporaries stay in the processor's cache.
_MOST_POINTS = 1024


@dataclass(frozen=True, eq=False)
class Transport:
    """Map from standard coordinates to a target's d."""

    factor: Array  # (d, d) Lower factor L
    spline: Spline  # Layer of the single coordinates

    @classmethod
    def fit(cls, points: Array) -> Self:
        """Fit to a sample (N, d), N well above d, whose quarters are independent of one another."""
        scores = normal_scores(points)
        effective = _effective_draws(scores)
        return cls(_factor(scores, effective), Spline.fit(points, effective))

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""
        log_determinant = np.log(np.diag(self.factor)).sum()
        points = np.empty_like(z)
        log_jacobians = np.empty(len(z))
        for start in range(0, len(z), _MOST_POINTS):
            part = slice(start, start + _MOST_POINTS)
            x, log_slopes = self.spline(self.factor @ z[part].T)
            points[part] = x.T
            log_jacobians[part] = log_slopes + log_determinant
        return points, log_jacobians


def _effective_draws(y: Array) -> float:
    """Effective draws of normal scores (N, d), by how much their quarters differ.

    Their means and products of pairs have variance 4/N in a quarter of N independent draws. The
    draws count as the N at which this is the variance between the quarters.
    """
    pairs = np.triu_indices(y.shape[1], 1)
    moments = []
    for quarter in np.array_split(y, 4):
        means = quarter.mean(axis=0)
        products = quarter.T @ quarter / len(quarter)
        moments.append(np.concatenate([means, products[pairs]]))
    variance = np.var(moments, axis=0, ddof=1).mean()
    return float(min(len(y), 4.0 / variance))


def _factor(scores: Array, effective: float) -> Array:
    """Lower factor of the correlations of scores (N, d), shrunk towards zero.

    A sample of few independent draws has as many chance correlations as pairs, and together they
    would make a worse map than none. A correlation r with standard error 1/sqrt(N) lies |r| sqrt(N)
    errors from zero. With noise level t it becomes r max(1 - t²/(N r²), 0): zero within t errors,
    and nearly r far beyond.
    """
    correlation = np.atleast_2d(np.corrcoef(scores.T))
    # The floor is zero for all purposes but the division below.
    square = effective * np.maximum(correlation**2, 1e-300)
    noise = _noise_level(square[np.triu_indices(len(square), 1)])
    correlation *= np.maximum(1.0 - noise**2 / square, 0.0)
    while True:
        np.fill_diagonal(correlation, 1.0)
        try:
            factor = np.linalg.cholesky(correlation)
            return np.asarray(factor)
        except np.linalg.LinAlgError:
            correlation *= _SHRINKAGE


def _noise_level(squares: Array) -> float:
    """Level in standard errors below which squared correlations, in squared errors, count as none.

    Chance leaves 2 Phi(-t) P of P pairs beyond a level t. The lowest level is chosen at which these
    are at most `_MOST_BY_CHANCE` of the pairs that do lie beyond; failing that, the last one.
    """
    beyond = squares[:, None] > _NOISE_LEVELS**2
    by_chance = 2.0 * special.ndtr(-_NOISE_LEVELS) * len(squares)
    real = by_chance <= _MOST_BY_CHANCE * beyond.sum(axis=0)
    real[-1] = True
    return float(_NOISE_LEVELS[np.argmax(real)])
