"""Ensembles of walkers, advanced in pieces that can be stopped, stored and taken up again."""

from __future__ import annotations

import dataclasses
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.checked import Checked, Target, refuse_impossible
from percept.inference.sampling.moves import standard_moves
from percept.inference.sampling.reference import Reference

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Ensembles:
    """Everything E ensembles of W walkers need to go on."""

    coords: Array  # (E, W, d) Walkers
    log_density: Array  # (E, W) Their log densities
    schedule: tuple[Any, ...]
    generators: tuple[dict[str, Any], ...]  # State of each ensemble's own generator
    accepted: NDArray[np.int64]  # (E, W) Accepted steps per walker so far
    steps: int  # Steps taken so far


def start(target: Target, points: Array, seed: np.random.SeedSequence) -> Ensembles:
    """Place walkers and give every ensemble a generator of its own."""
    ensembles, walkers, dimension = points.shape
    flat = points.reshape(-1, dimension)
    log_density = Checked(target)(flat)
    refuse_impossible(target, flat, log_density)
    schedule, *generators = seed.spawn(1 + ensembles)
    return Ensembles(
        points.copy(),
        log_density.reshape(ensembles, walkers),
        # emcee's random_state setter takes nothing but the legacy tuple, and ignores the rest in silence.
        tuple(np.random.RandomState(np.random.MT19937(schedule)).get_state(legacy=True)),
        tuple(dict(np.random.PCG64(child).state) for child in generators),
        np.zeros((ensembles, walkers), dtype=np.int64),
        0,
    )


def advance(
    target: Target, state: Ensembles, *, steps: int, stride: int, walkers: int | None = None
) -> tuple[Ensembles, Array]:
    """Run all ensembles for some steps and keep every `stride`-th position."""
    ensembles, own, dimension = state.coords.shape
    walkers = own if walkers is None else walkers
    generators = [np.random.Generator(np.random.PCG64()) for _ in range(ensembles)]
    for generator, stored in zip(generators, state.generators, strict=True):
        generator.bit_generator.state = stored
    moves = standard_moves(Reference(dimension), generators)
    sampler = emcee.EnsembleSampler(ensembles * own, dimension, target, moves=moves, vectorize=True)
    current = emcee.State(
        state.coords.reshape(-1, dimension),
        log_prob=state.log_density.ravel(),
        random_state=state.schedule,
        copy=True,
    )
    kept = np.empty((ensembles, steps // stride, walkers, dimension))
    accepted, before = state.accepted.ravel().copy(), state.log_density.ravel()
    chain = sampler.sample(current, iterations=steps, store=False, skip_initial_state_check=True)
    for step, current in enumerate(chain, start=1):
        accepted += current.log_prob != before
        before = np.array(current.log_prob)
        if step % stride == 0:
            kept[:, step // stride - 1] = current.coords.reshape(state.coords.shape)[:, :walkers]
    after = Ensembles(
        np.array(current.coords).reshape(state.coords.shape),
        np.array(current.log_prob).reshape(state.log_density.shape),
        tuple(sampler.random_state) if steps else state.schedule,
        tuple(dict(generator.bit_generator.state) for generator in generators),
        accepted.reshape(state.accepted.shape),
        state.steps + steps,
    )
    return after, kept
