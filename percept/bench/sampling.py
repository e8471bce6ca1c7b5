"""Run time of the sampler against the error it was asked for, on a study."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from percept.inference.hierarchy.estimands import IntervalEstimands
from percept.inference.sampling.records import Settings
from percept.inference.sampling.run import sample
from percept.scene import Scene
from percept.sessions import read_sessions
from percept.study.bayesian import prepare


@dataclass(frozen=True)
class SamplingCost:
    """Medians over seeds of runs to one tolerance."""

    tolerance: float  # Monte Carlo error over half-width that was asked for
    seconds: float  # Wall time of a run, warm-up included
    steps: float  # Steps per ensemble
    worst_error: float  # Largest error over half-width that was reached
    autocorrelation_time: float  # Of the slowest reported quantity, in steps
    effective_draws_per_second: float  # Of that quantity
    passed: int  # Runs that passed the gate
    runs: int  # Runs


def sampling_cost(
    sessions: str | Path, scene: Scene, *, tolerances: Sequence[float] = (0.1, 0.02, 0.01), seeds: int = 5
) -> list[SamplingCost]:
    """Sample a study to several tolerances."""
    model = prepare(read_sessions(sessions), scene, ("k", "b")).model
    found = []
    for tolerance in tolerances:
        seconds, runs = [], []
        for seed in range(1, seeds + 1):
            begun = time.perf_counter()
            runs.append(sample(model, IntervalEstimands(model), Settings(tolerance=tolerance, seed=seed)))
            seconds.append(time.perf_counter() - begun)
        rates = [run.gate.effective_draws / spent for run, spent in zip(runs, seconds, strict=True)]
        found.append(
            SamplingCost(
                tolerance=tolerance,
                seconds=statistics.median(seconds),
                steps=statistics.median(run.steps for run in runs),
                worst_error=statistics.median(run.gate.worst_error for run in runs),
                autocorrelation_time=statistics.median(run.gate.autocorrelation_time for run in runs),
                effective_draws_per_second=statistics.median(rates),
                passed=sum(run.gate.passed for run in runs),
                runs=len(runs),
            )
        )
    return found
