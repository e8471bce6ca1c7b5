"""How draws of a posterior become an estimate with limits and their Monte Carlo error."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from percept.inference.classical.variability import Bounded
from percept.inference.model.laws import Moments
from percept.inference.sampling.endpoints import mixture_quantile
from percept.study.basics import Array


@dataclass(frozen=True)
class DrawLimits:
    """Takes the median and both limits of draws."""

    level: float
    effective: int  # Independent draws that the draws are worth

    def of(self, draws: Array) -> Bounded:
        """Bound what is drawn, (S,).

        The share of draws below a quantile errs by √(tail (1 − tail)/effective). The quantiles at
        one such error to either side say how far the limit errs.
        """
        tail = 0.5 * (1.0 - self.level)
        tail_error = math.sqrt(tail * (1.0 - tail) / self.effective)
        smaller_tail = tail - tail_error
        larger_tail = tail + tail_error
        tails = np.clip([tail, smaller_tail, larger_tail], 0.0, 1.0)
        lower, lower_outside, lower_inside = np.quantile(draws, tails).tolist()
        upper, upper_outside, upper_inside = np.quantile(draws, 1.0 - tails).tolist()
        error_of_lower = 0.5 * (lower_inside - lower_outside)
        error_of_upper = 0.5 * (upper_outside - upper_inside)
        median = float(np.median(draws))
        return Bounded(median, lower, upper, error=max(error_of_lower, error_of_upper))


def bounded_means(laws: Moments, level: float, effective: int) -> list[Bounded]:
    """Bound what is normal given each draw, by roots of mixtures.

    The draws are worth `effective` independent ones.
    """
    tail = 0.5 * (1.0 - level)
    mean = laws.mean
    sd = laws.sd
    lower, influence_on_lower = mixture_quantile(mean, sd, tail, upper=False)
    upper, influence_on_upper = mixture_quantile(mean, sd, tail, upper=True)
    sd_of_lower = influence_on_lower.std(axis=0)
    sd_of_upper = influence_on_upper.std(axis=0)
    errors = np.maximum(sd_of_lower, sd_of_upper) / math.sqrt(effective)
    estimates = mean.mean(axis=0)
    columns = np.stack([estimates, lower, upper, errors], axis=1)
    return [Bounded(*numbers) for numbers in columns.tolist()]
