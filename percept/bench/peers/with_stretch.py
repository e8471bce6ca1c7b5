"""percept's collapsed density and mixture limits with emcee's stretch moves: what the moves alone cost."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from percept.bench.peers.engines import Fitted, Sampler
from percept.bench.peers.responses import Responses
from percept.bench.peers.walkers import KEPT_EVERY, effective_draws, stretch
from percept.bench.peers.with_percept import estimands_of, limits_of_mixture

Array = NDArray[np.float64]


def prepare(study: Responses, source: str) -> Sampler:
    """Read the study and make the density."""
    del study
    estimands = estimands_of(source)
    model = estimands.model

    def start(walkers: int, rng: np.random.Generator) -> Array:
        return 0.5 * rng.standard_normal((walkers, len(model.names)))

    def sample(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        kept, acceptance = stretch(model, start, int(budget), seed)
        components = estimands.components(kept.reshape(-1, kept.shape[2]))
        effective, steps = effective_draws(components.reshape(*kept.shape[:2], -1))
        limits = limits_of_mixture(estimands, components, effective)
        return Fitted(
            {"mixture": limits},
            time.perf_counter() - started,
            {"acceptance": acceptance, "autocorrelation_time": steps * KEPT_EVERY},
        )

    return sample
