"""Pareto-smoothed importance weights, as ArviZ makes them and without its imports.

Importing ArviZ takes longer than sampling an ordinary study. Method: Vehtari, Simpson, Gelman, Yao
and Gabry (2024), Pareto smoothed importance sampling, JMLR 25(72).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

__all__ = ["good_index", "smoothed_log_weights"]

Array = NDArray[np.float64]

#: Tail index above which no number of draws helps.
_WORST_INDEX = 0.7
#: Draws up to which a fixed part of them is the tail; beyond, its size goes with their root.
_FEW_DRAWS = 225
#: Part of few draws that is their tail.
_TAIL_OF_FEW = 0.2
#: Draws of the tail, over the root of all draws.
_TAIL_PER_ROOT = 3.0
#: Candidates for the generalized Pareto law of any tail; longer tails have more.
_LEAST_CANDIDATES = 30
#: Scale of the prior of the candidates, over the lower quartile of the tail.
_PRIOR_SCALE = 3
#: Draws that the prior of the index counts for, and the index that it expects.
_PRIOR_DRAWS = 10
_PRIOR_INDEX = 0.5
#: Candidates of less weight change nothing in double precision.
_LEAST_COUNTED = 10 * np.finfo(float).eps


def good_index(draws: int) -> float:
    """Return the tail index up to which weights of so many draws can be trusted."""
    return min(1.0 - 1.0 / float(np.log10(draws)), _WORST_INDEX)


def smoothed_log_weights(log_ratios: Array) -> tuple[Array, float]:
    """Replace the largest importance ratios by quantiles of a Pareto law fitted to them.

    Parameters
    ----------
    log_ratios : ndarray, shape (S,)
        Log importance ratios of independent draws, at least 25.

    Returns
    -------
    log_weights : ndarray, shape (S,)
        Logarithms of weights whose sum is one.
    index : float
        Tail index k of the ratios.
    """
    log_weights = log_ratios - log_ratios.max()
    draws = log_weights.size
    in_tail = int(_TAIL_OF_FEW * draws)
    if draws > _FEW_DRAWS:
        in_tail = int(_TAIL_PER_ROOT * math.sqrt(draws))
    order = np.argsort(log_weights)
    tail = order[draws - in_tail :]
    largest = log_weights[tail[-1]]
    cutoff = np.exp(log_weights[order[draws - in_tail - 1]])
    index, scale = _pareto_fit(np.exp(log_weights[tail]) - cutoff)
    if math.isfinite(index):
        probabilities = np.arange(0.5, in_tail) / in_tail
        exceedances = scale * np.expm1(-index * np.log1p(-probabilities)) / index
        log_weights[tail] = np.minimum(np.log(cutoff + exceedances), largest)
    return log_weights - special.logsumexp(log_weights), index


def _pareto_fit(exceedances: Array) -> tuple[float, float]:
    """Estimate index and scale of a generalized Pareto law from sorted values, by Zhang-Stephens.

    A weighted mean over candidates of the ratio of index and scale; the index then leans to its
    prior.
    """
    size = exceedances.size
    candidates = _LEAST_CANDIDATES + int(math.sqrt(size))
    quartile = exceedances[int(size / 4 + 0.5) - 1]
    ratios = 1 - np.sqrt(candidates / (np.arange(1, candidates + 1) - 0.5))
    ratios /= _PRIOR_SCALE * quartile
    ratios += 1 / exceedances[-1]
    indices = np.log1p(-ratios[:, None] * exceedances).mean(axis=1)
    log_likelihood = size * (np.log(-ratios / indices) - indices - 1)
    weights = np.exp(log_likelihood - special.logsumexp(log_likelihood))
    counted = weights >= _LEAST_COUNTED
    weights = weights[counted] / weights[counted].sum()
    ratio = np.sum(ratios[counted] * weights)
    index = np.log1p(-ratio * exceedances).mean()
    leaning = size * index + _PRIOR_DRAWS * _PRIOR_INDEX
    return float(leaning / (size + _PRIOR_DRAWS)), float(-index / ratio)
