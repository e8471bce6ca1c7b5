"""Log SDs of one level of one quantity or two, about their trends.

A level is the scatter between subjects or between trials. Each quantity has a `TrendMap`. The rough
likelihood of the second quantity moves with the log SDs of the first, as `RoughLikelihood` says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.log_linear import LogSpreads
from percept.inference.hierarchy.rough_likelihood import RoughLikelihood
from percept.inference.hierarchy.trend_map import TrendMap

__all__ = ["TiedSpreads", "stacked"]

Array = NDArray[np.float64]


def stacked(spreads: Sequence[LogSpreads]) -> LogSpreads:
    """Spreads of several quantities in one record: log SDs (P, C, W) and multiples (P, K, W)."""
    log_sigmas = [quantity.log_sigma for quantity in spreads]
    multiples = [quantity.multiples for quantity in spreads]
    log_densities = [quantity.log_density for quantity in spreads]
    return LogSpreads(
        log_sigma=np.stack(log_sigmas),
        multiples=np.stack(multiples),
        log_density=np.sum(log_densities, axis=0),
    )


class TiedSpreads:
    """Map coordinates to the log SDs of P quantities in J environments.

    Parameters
    ----------
    centre : float
        Prior mean of log sigma.
    loadings : ndarray
        Columns of the trend times their prior SDs, (P, 2, J).
    rough : RoughLikelihood
        What the data say of log sigma; its cells are the environments.

    Attributes
    ----------
    weight : ndarray
        Weights of the rough likelihood, (P, J): a unit of the coordinates is shorter by
        √(1 + weight) than a prior SD.
    """

    def __init__(
        self,
        centre: float,
        loadings: Array,
        rough: RoughLikelihood,
    ) -> None:
        self.weight = rough.weight
        self._rough = rough
        self._maps = []
        for loading, mean, weight in zip(loadings, rough.mean, rough.weight, strict=True):
            trend_map = TrendMap(centre, loading, mean, weight)
            self._maps.append(trend_map)

    def __call__(self, u: Array, omega: Array, trend: Array) -> LogSpreads:
        """Map coordinates (P, J, W), given omega (P, W) and the trend's (P, 2, W), to spreads."""
        spreads: list[LogSpreads] = []
        shift: Array | float = 0.0
        for p, trend_map in enumerate(self._maps):
            if p == 1:
                first = spreads[0]
                shift = self._rough.shift_of_second(first.log_sigma)
            quantity = trend_map(u[p], omega[p], trend[p], shift)
            spreads.append(quantity)
        return stacked(spreads)
