"""Simultaneous bands for the empirical distribution of values that should be uniform."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Counts = NDArray[np.int64]
_HALVINGS = 40


class EcdfBand:
    """Bounds of the number of values below each inner edge of equal bins."""

    def __init__(self, count: int, bins: int, tail: float) -> None:
        self.count, self.tail = count, tail
        self.edges = np.arange(1, bins) / bins
        self.lower: Counts = np.asarray(stats.binom.ppf(0.5 * tail, count, self.edges), dtype=np.int64)
        self.upper: Counts = np.asarray(stats.binom.isf(0.5 * tail, count, self.edges), dtype=np.int64)

    def probability(self) -> float:
        """Probability that uniform values stay within the bounds at all edges at once.

        Counts below successive edges are a Markov chain with binomial steps, so the probability is a
        product of small matrices (Säilynoja, Bürkner & Vehtari 2022).
        """
        at = np.arange(self.lower[0], self.upper[0] + 1)
        mass = stats.binom.pmf(at, self.count, self.edges[0])
        for k in range(1, self.edges.size):
            step = (self.edges[k] - self.edges[k - 1]) / (1.0 - self.edges[k - 1])
            to = np.arange(self.lower[k], self.upper[k] + 1)
            mass = mass @ stats.binom.pmf(to[None, :] - at[:, None], (self.count - at)[:, None], step)
            at = to
        return float(mass.sum())

    def below(self, values: NDArray[np.float64]) -> Counts:
        """Count values below each edge, shape (bins - 1,)."""
        return np.searchsorted(np.sort(values), self.edges, side="left")

    def holds(self, values: NDArray[np.float64]) -> bool:
        """Whether the counts of values stay within the bounds."""
        below = self.below(values)
        return bool(np.all((below >= self.lower) & (below <= self.upper)))

    def least_tail(self, values: NDArray[np.float64]) -> float:
        """Smallest two-sided tail probability of a count, over the edges."""
        below = self.below(values)
        low = stats.binom.cdf(below, self.count, self.edges)
        high = stats.binom.sf(below - 1, self.count, self.edges)
        return float(min(1.0, 2.0 * np.minimum(low, high).min()))


@functools.cache
def ecdf_band(count: int, bins: int, error: float) -> EcdfBand:
    """Find the narrowest band that uniform values leave with at most the probability given."""
    low, high = 0.0, float(np.log(bins))  # logarithms of error/tail: between one edge and a union of all
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if EcdfBand(count, bins, error * float(np.exp(-middle))).probability() >= 1.0 - error:
            high = middle
        else:
            low = middle
    return EcdfBand(count, bins, error * float(np.exp(-high)))
