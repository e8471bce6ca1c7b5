"""percept's density and mixture limits under emcee's own moves: what the moves alone cost."""

from __future__ import annotations

import time
from collections.abc import Callable

import emcee
import numpy as np

from percept.inference.sampling.diagnostics import autocorrelation_time, normal_scores
from reports.fitted import KINDS, Fitted, estimands_of
from reports.studies import Observed

_WALKERS = 256  # Where the coordinates do not ask for more
_KEPT_EVERY = 10  # Steps
_BURN_IN = 0.25  # Of the steps


def sampler(study: Observed) -> Callable[[float, int], Fitted]:
    """Return what samples a study in so many steps of each walker, from a seed."""
    estimands = estimands_of(study)
    model = estimands.model
    dimension = len(model.names)
    # emcee refuses an ensemble of fewer.
    walkers = max(_WALKERS, 2 * dimension)

    def fit(steps: float, seed: int) -> Fitted:
        started = time.perf_counter()
        points = 0.5 * np.random.default_rng(seed).standard_normal((walkers, dimension))
        ensemble = emcee.EnsembleSampler(walkers, dimension, model, vectorize=True)
        # emcee takes nothing but a legacy state here, and ignores the rest in silence.
        random_state = np.random.RandomState(seed).get_state(legacy=True)
        state = emcee.State(points, random_state=random_state)
        ensemble.run_mcmc(state, int(steps), skip_initial_state_check=True)
        chain = ensemble.get_chain(discard=int(_BURN_IN * steps), thin=_KEPT_EVERY)
        components = estimands.components(chain.reshape(-1, dimension))
        scores = normal_scores(components.reshape(*chain.shape[:2], -1))
        slowest = float(autocorrelation_time(scores[None]).max())
        effective = len(components) / slowest
        parts = list(estimands.estimates(components))
        value = np.concatenate([estimates.value for estimates, _ in parts])
        sd = np.concatenate([influence.std(axis=0) for _, influence in parts])
        shape = (len(KINDS), 2, len(estimands.model.cells))
        return Fitted(
            value.reshape(shape),
            (sd / np.sqrt(effective)).reshape(shape),
            effective,
            time.perf_counter() - started,
            {"acceptance": float(np.mean(ensemble.acceptance_fraction))},
        )

    return fit
