"""emcee's own stretch moves on any vectorised density, and the information in what they give."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WALKERS = 256
KEPT_EVERY = 10
_BURN_IN = 0.25


def stretch(
    density: Callable[[Array], Array],
    start: Callable[[int, np.random.Generator], Array],
    steps: int,
    seed: int,
) -> tuple[Array, float]:
    """Run emcee as its tutorial does; the first quarter is dropped."""
    import emcee

    points = start(WALKERS, np.random.default_rng(seed))
    sampler = emcee.EnsembleSampler(WALKERS, points.shape[1], density, vectorize=True)
    # emcee takes nothing but a legacy state here, and ignores the rest in silence.
    state = emcee.State(points, random_state=np.random.RandomState(seed).get_state(legacy=True))
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    chain = np.asarray(sampler.get_chain(discard=int(_BURN_IN * steps), thin=KEPT_EVERY))
    return chain, float(np.mean(sampler.acceptance_fraction))


def effective_draws(series: Array) -> tuple[float, float]:
    """Effective draws of the slowest of several series."""
    from percept.inference.sampling.diagnostics import autocorrelation_time, normal_scores

    time = float(autocorrelation_time(normal_scores(series)[None]).max())
    return series.shape[0] * series.shape[1] / time, time
