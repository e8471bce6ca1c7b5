"""What the data say of the log SDs of one level, roughly: normal, and the second given the first.

For a quantity and a cell the rough likelihood is N(log sigma; mean, 1/weight). Samples of pairs
with the correlation rho have log SDs with a correlation of rho², here called tie. So the rough log
SDs of the second quantity are, given the log SDs of the first,

    mean_2 + slope (log sigma_1 - mean_1),  slope = tie √(weight_1 / weight_2)

with the weight weight_2 / (1 - tie²). Near a correlation of one the ratio of the two SDs is known
far better than either. All of it shapes coordinates alone and does not enter the posterior.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.rough_spreads import rough_between, rough_trial
from percept.inference.model.statistics import Statistics
from percept.inference.model.ties import tie_between, tie_trial

__all__ = ["RoughLikelihood", "likelihood_between", "likelihood_of_trials"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class RoughLikelihood:
    """Rough likelihood of the log SDs of P quantities (one or two) in C cells."""

    mean: Array  # (P, C) Of each quantity by itself
    weight: Array  # (P, C) Of the second given the first; zero where the data say nothing
    slope: Array  # (C,) Of the second quantity on the first

    @classmethod
    def tied(cls, mean: Array, weight: Array, tie: float) -> RoughLikelihood:
        """From means and weights (P, C) of each quantity by itself, and their correlation."""
        both = (weight > 0).all(axis=0)
        conditional = weight.copy()
        conditional[1:] /= np.where(both, 1.0 - tie * tie, 1.0)
        ratio = weight[0] / np.where(both, weight[-1], 1.0)
        slope = np.where(both, tie * np.sqrt(ratio), 0.0)
        return cls(mean, conditional, slope)

    def shift_of_second(self, log_sigma: Array, shift: Array | float = 0.0) -> Array:
        """Return what log SDs (C, W) of the first quantity add to the rough means of the second.

        The rough means of the first are themselves moved by a shift (C, W).
        """
        mean = self.mean[0][:, None]
        slope = self.slope[:, None]
        departure = log_sigma - mean - shift
        return np.asarray(slope * departure)


def likelihood_between(
    statistics: Statistics,
    loadings: Array,
    centre: float,
    single_sd: float,
    *,
    subject_effect: bool,
) -> RoughLikelihood:
    """Rough likelihood of the SDs between subjects, by the arguments of `rough_between`."""
    rough = rough_between(statistics, loadings, centre, single_sd, subject_effect=subject_effect)
    tie = tie_between(statistics, subject_effect=subject_effect)
    return RoughLikelihood.tied(rough.mean, rough.weight, tie)


def likelihood_of_trials(statistics: Statistics) -> RoughLikelihood:
    """Rough likelihood of the SDs between trials."""
    rough = rough_trial(statistics)
    return RoughLikelihood.tied(rough.mean, rough.weight, tie_trial(statistics))
