"""Warm-up: from a density to a frozen proposal and starting points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.checked import Target, refuse_impossible
from percept.inference.sampling.ensembles import advance, start
from percept.inference.sampling.mode import find_mode
from percept.inference.sampling.proposal import Proposal

__all__ = ["warm_up"]

Array = NDArray[np.float64]
_ROUNDS = 4
_STEPS = 48
_STRIDE = 12


def warm_up(target: Target, shape: tuple[int, int], seed: np.random.SeedSequence) -> tuple[Proposal, Array]:
    """Fit a proposal to a density and find starting points.

    Mode and curvature give the first law; importance weights refine it; a short run gives
     the sample to which the final, skewed law is fitted.

    Parameters
    ----------
    target : Target
        The density.
    shape : tuple of int
        Ensembles and walkers that starting points are wanted for.
    seed : numpy.random.SeedSequence
        Seed of the warm-up.

    Returns
    -------
    proposal : Proposal
        Frozen from here on.
    points : ndarray, shape (ensembles, walkers, d)
        Last positions of the warm-up's own ensembles.
    """
    adapt_seed, run_seed = seed.spawn(2)
    mode, covariance = find_mode(target, np.zeros(len(target.names)))
    count = shape[0] * shape[1]
    law, points = _importance_rounds(
        target, Proposal.normal(mode, covariance), np.random.default_rng(adapt_seed), count
    )
    state = start(target, points[:count].reshape(*shape, -1), run_seed)
    state, kept = advance(target, law, state, steps=_STEPS, stride=_STRIDE)
    return Proposal.fit(kept[:, 1:].reshape(-1, mode.size)), state.coords


def _importance_rounds(
    target: Target, law: Proposal, rng: np.random.Generator, walkers: int
) -> tuple[Proposal, Array]:
    """Draw, weigh by density over law, fit the weighted sample; and resample the last round."""
    size = law.centre.size
    draws = max(2048, 40 * size, walkers)
    for last in [False] * (_ROUNDS - 1) + [True]:
        points = law.draw(draws, rng)
        values = target(points)
        refuse_impossible(target, points, values)
        log_weights = values - law.log_density(points)
        # Tempered, or a few lucky draws would decide the covariance.
        weights = _weights(log_weights, at_least=min(0.5 * draws, 10.0 * size))
        if last:
            chosen = rng.choice(draws, size=draws, p=_weights(log_weights, at_least=0.05 * draws))
        law = Proposal.fit(points, weights, skewed=False)
    return law, points[chosen]


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
