"""Several ensembles of walkers that advance side by side and never see each other.

One emcee sampler carries the walkers of all ensembles, so that one call evaluates the density for
all of them.
"""

from __future__ import annotations

import emcee
import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.coordinates import Target
from percept.inference.sampling.moves import Schedule, standard_moves
from percept.inference.sampling.reference import ReferenceLaw

__all__ = ["Ensembles"]

Array = NDArray[np.float64]


class Ensembles:
    """E ensembles of W walkers on a target, each ensemble with a generator of its own."""

    def __init__(self, target: Target, points: Array, seed: np.random.SeedSequence) -> None:
        """Start from points (E, W, d), which are left as they are."""
        self._target = target
        self._shape = points.shape
        flat = points.reshape(-1, points.shape[-1])
        schedule_seed, *seeds = seed.spawn(1 + len(points))
        self._generators = [np.random.Generator(np.random.PCG64(child)) for child in seeds]
        # emcee's random_state setter takes nothing but the legacy tuple, and ignores the rest in
        # silence.
        legacy = np.random.RandomState(np.random.MT19937(schedule_seed))
        random_state = legacy.get_state(legacy=True)
        self._state = emcee.State(flat, log_prob=target(flat), random_state=random_state, copy=True)
        self.accepted = np.zeros(len(flat))  # (E W,) Accepted steps per walker so far
        self.steps = 0  # Steps taken so far
        self.schedule = Schedule()

    def advance(self, steps: int, stride: int, *, learn: bool = False) -> Array:
        """Run all ensembles for some steps; every `stride`-th position, (E, T, W, d).

        A run that learns sets the schedule of its moves to what these steps earned.
        """
        ensembles, walkers, dimension = self._shape
        law = ReferenceLaw(dimension)
        moves = standard_moves(law, self._generators, self.schedule.independent)
        sampler = emcee.EnsembleSampler(
            ensembles * walkers, dimension, self._target, moves=moves, vectorize=True
        )
        # emcee's wrapper prints all walkers to the terminal when a density is interrupted.
        sampler.log_prob_fn = self._target
        kept = np.empty((ensembles, steps // stride, walkers, dimension))
        chain = sampler.sample(
            self._state,
            iterations=steps // stride,
            thin_by=stride,
            store=False,
            skip_initial_state_check=True,
        )
        for position, state in enumerate(chain):
            kept[:, position] = state.coords.reshape(self._shape)
            self._state = state
        for move, _ in moves:
            self.accepted += move.accepted
        self.steps += steps
        if learn:
            (independent, _), (rotation, _) = moves
            self.schedule = Schedule.earned(independent, rotation)
        return kept
