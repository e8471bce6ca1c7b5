"""Estimates from kept draws with what tells how far they can be believed.

Influence functions, the largest arrays of a run, live here alone: parts of the estimands are judged apart, by
whoever works on them, and numbers come back.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.diagnostics import (
    autocorrelation_time,
    monte_carlo_error,
    normal_scores,
    rank_rhat,
    some_walkers,
)
from percept.inference.sampling.estimands import Estimands, Estimates

Array = NDArray[np.float64]
#: Values whose ranks are compared: chance alone then leaves R-hat within 0.001 of one.
_RANKED = 1 << 14


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """Estimates and how far they can be believed."""

    estimates: Estimates  # Q estimates
    errors: Array  # (Q,) Monte Carlo standard errors
    times: Array  # (Q,) Autocorrelation times of the influence functions, in kept positions
    slowest: float  # The longest of them, and of the times of the ranks of what is kept per draw
    rhat: float | None  # Largest rank R-hat across ensembles of influence functions and of what is kept


def judge(estimands: Estimands, components: Array, tolerance: float, *, full: bool) -> Judged:
    """Estimate, and measure errors and convergence."""
    parts = [_judge_part(part, components, tolerance, full) for part in estimands.parts()]
    estimates = Estimates(
        tuple(name for part in parts for name in part.estimates.names),
        np.concatenate([part.estimates.value for part in parts]),
        np.concatenate([part.estimates.scale for part in parts]),
    )
    # Ranks: a heavy tail would make the autocorrelation that of its few extreme draws.
    varying = np.ptp(components, axis=(0, 1, 2)) > 0
    scores = normal_scores(some_walkers(components[..., varying]))
    slowest = float(autocorrelation_time(scores).max(initial=max(part.slowest for part in parts)))
    rhats = [part.rhat for part in parts]
    known = [rhat for rhat in rhats if rhat is not None]
    return Judged(
        estimates,
        np.concatenate([part.errors for part in parts]),
        np.concatenate([part.times for part in parts]),
        slowest,
        max([*known, _rhat(scores, slowest)]) if len(known) == len(rhats) else None,
    )


def _judge_part(estimands: Estimands, components: Array, tolerance: float, full: bool) -> Judged:
    estimates, influence = estimands.estimate(components.reshape(-1, components.shape[-1]))
    series = influence.reshape(*components.shape[:3], -1)
    times = autocorrelation_time(some_walkers(series))
    errors = monte_carlo_error(series, times)
    slowest = float(times.max())
    wanted = full or bool(np.all(errors <= tolerance * estimates.scale))
    return Judged(estimates, errors, times, slowest, _rhat(series, slowest) if wanted else None)


def _rhat(series: Array, slowest: float) -> float:
    """Largest rank R-hat of series (E, T, W, V), at about every independent position."""
    ensembles, length, _, count = series.shape
    apart = some_walkers(series[:, :: max(1, round(min(slowest, length / 4.0)))], _RANKED)
    return float(rank_rhat(apart.reshape(ensembles, -1, count)).max(initial=1.0))
