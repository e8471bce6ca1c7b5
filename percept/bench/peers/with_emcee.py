"""The model as users of emcee write it: the joint density, stretch moves, nothing integrated out."""

from __future__ import annotations

import time

import numpy as np

from percept.bench.peers.endpoints import Limits, limits_of_draws
from percept.bench.peers.engines import Fitted, Sampler
from percept.bench.peers.joint import PlainDensity, population
from percept.bench.peers.responses import Responses
from percept.bench.peers.walkers import KEPT_EVERY, effective_draws, stretch


def prepare(study: Responses, source: str) -> Sampler:
    """Make the density."""
    del source
    density = PlainDensity(study)

    def sample(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        rng = np.random.default_rng(seed)
        kept, acceptance = stretch(density, density.start, int(budget), seed)
        flat = kept.reshape(-1, density.dimension)
        beta, spread = (
            part.reshape(*kept.shape[:2], -1) for part in population(density.unknowns(flat), study.decades)
        )
        # Walkers are not chains: their draws are pooled in one, and the errors come from their own times.
        limits = limits_of_draws(beta.reshape(1, len(flat), -1), spread.reshape(1, len(flat), -1), rng)
        effective, steps = effective_draws(np.concatenate([beta, np.log(spread)], axis=2))
        error = limits.error * np.sqrt(max(1.0, limits.effective / effective))
        return Fitted(
            {"draws": Limits(limits.value, error, effective)},
            time.perf_counter() - started,
            {"acceptance": acceptance, "autocorrelation_time": steps * KEPT_EVERY},
        )

    return sample
