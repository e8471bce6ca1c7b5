"""From the chains of a general sampler to limits."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from percept.bench.peers.endpoints import limits_of_draws
from percept.bench.peers.engines import Fitted

Array = NDArray[np.float64]


def fitted(beta: Array, spread: Array, seed: int, seconds: float, notes: dict[str, float]) -> Fitted:
    """Take limits from the draws of several chains."""
    started = time.perf_counter()
    chains, draws = beta.shape[:2]
    limits = limits_of_draws(
        beta.reshape(chains, draws, -1), spread.reshape(chains, draws, -1), np.random.default_rng(seed)
    )
    return Fitted({"draws": limits}, seconds + time.perf_counter() - started, notes)
