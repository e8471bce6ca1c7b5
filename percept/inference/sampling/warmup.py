"""Warm-up: from a density to a frozen transport and starting points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.checked import Target, refuse_impossible
from percept.inference.sampling.ensembles import advance, start
from percept.inference.sampling.mode import find_mode
from percept.inference.sampling.reference import Reference
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.transported import Affine, Transported

Array = NDArray[np.float64]
_ROUNDS = 3
#: Steps of each adaptive run, how many of them are left out at its start, and the stride of those kept.
_RUNS = ((48, 16, 4), (80, 16, 2))


def warm_up(
    target: Target, shape: tuple[int, int], seed: np.random.SeedSequence
) -> tuple[Transported, Array]:
    """Fit a transport to a density and find starting points.

    Mode and curvature give the first map; importance weights refine it; short runs give the samples to which
    the transport is fitted.
    """
    adapt_seed, *run_seeds = seed.spawn(1 + len(_RUNS))
    rng = np.random.default_rng(adapt_seed)
    mode, covariance = find_mode(target, np.zeros(len(target.names)))
    here = Transported(target, Affine.normal(mode, covariance))
    for _ in range(_ROUNDS):
        z, log_weights = _weigh(here, rng, shape)
        # Tempered, or a few lucky draws would decide the covariance.
        weights = _weights(log_weights, at_least=min(0.5 * len(z), 10.0 * mode.size))
        here = Transported(target, Affine.fit(here.map(z), weights))
    points = _resample(here, rng, shape)
    for (steps, skipped, stride), run_seed in zip(_RUNS, run_seeds, strict=True):
        state = start(here, points, run_seed)
        kept = advance(here, state, steps=steps, stride=stride)[1][:, skipped // stride :]
        here, points = refine(target, here.map(kept.reshape(-1, mode.size)), shape, rng)
    return here, points


def refine(
    target: Target, points: Array, shape: tuple[int, int], rng: np.random.Generator
) -> tuple[Transported, Array]:
    """Fit a new transport to draws, and find starting points in its coordinates."""
    here = Transported(target, Transport.fit(points))
    return here, _resample(here, rng, shape)


def _weigh(here: Transported, rng: np.random.Generator, shape: tuple[int, int]) -> tuple[Array, Array]:
    """Draws from the reference law, and the log of the density over that law."""
    size = len(here.names)
    law = Reference(size)
    z = law.draw(max(2048, 40 * size, 2 * shape[0] * shape[1]), rng)
    values = here(z)
    refuse_impossible(here, z, values)
    return z, values - law.log_density(z)


def _resample(here: Transported, rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Choose starting points: draws taken by their weights, evened out so that many are chosen."""
    z, log_weights = _weigh(here, rng, shape)
    chosen = rng.choice(len(z), size=shape[0] * shape[1], p=_weights(log_weights, at_least=0.05 * len(z)))
    return z[chosen].reshape(*shape, -1)


def _weights(log_weights: Array, *, at_least: float) -> Array:
    """Normalised weights, raised to the largest power in (0, 1] that leaves the wanted effective size."""
    shifted = log_weights - np.max(log_weights)
    power = 1.0
    while True:
        weights = np.exp(power * shifted)
        weights /= weights.sum()
        if 1.0 / float(weights @ weights) >= at_least or power < 1e-6:
            return weights
        power *= 0.8
