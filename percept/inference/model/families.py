"""Level at which the limits of a family of quantities hold together.

A score s stands for limits of level 2 Phi(s) - 1, each quantity by itself, as it does for curves.
Joint draws of the family tell how often some quantity lies outside its limits. The score searched
for leaves out as many as a single interval would. It is at most Bonferroni's, which always
suffices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from percept.inference.sampling.endpoints import mixture_quantile

__all__ = ["level_together"]

Array = NDArray[np.float64]

#: SDs of a normal to which the score is searched: a thousandth of a usual half-width.
_ACCURACY = 0.003


def level_together(mean: Array, sd: Array, values: Array, level: float) -> float:
    """Search for the level of single limits that hold a whole family.

    Parameters
    ----------
    mean, sd : ndarray
        Normal laws of L quantities given S posterior draws, shape (S, L).
    values : ndarray
        Joint posterior draws of the quantities, shape (N, L).
    level : float
        Probability that all quantities lie within their limits.

    Returns
    -------
    float
        Of single limits, from `level` to the one that Bonferroni's inequality gives.
    """
    count = values.shape[1]
    outside = 1.0 - level
    first = _score(outside)
    last = _score(outside / count)

    def excess(score: float) -> float:
        """Share of draws with a quantity outside, less what is allowed."""
        tail = float(special.ndtr(-score))
        lower, _ = mixture_quantile(mean, sd, tail, upper=False)
        upper, _ = mixture_quantile(mean, sd, tail, upper=True)
        leaves = (values < lower) | (values > upper)
        return float(leaves.any(axis=1).mean()) - outside

    score = last
    # Noise of the draws may put the crossing beyond either end.
    if excess(first) <= 0.0:
        score = first
    elif excess(last) < 0.0:
        score = float(optimize.brentq(excess, first, last, xtol=_ACCURACY))
    return 1.0 - 2.0 * float(special.ndtr(-score))


def _score(outside: float) -> float:
    """SDs of a normal beyond which a probability lies, half of it on either side."""
    return -float(special.ndtri(0.5 * outside))
