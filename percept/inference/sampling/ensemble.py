"""One emcee ensemble, advanced in pieces that can be stopped, stored and taken up again."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.sampling.moves import moves
from percept.inference.sampling.proposal import Proposal

__all__ = ["EnsembleState", "Target", "advance", "start"]

Array = NDArray[np.float64]


class Target(Protocol):
    """A log density to sample."""

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), shape (W,); -inf allowed, NaN not."""


@dataclasses.dataclass(frozen=True, eq=False)
class EnsembleState:
    """Everything an ensemble needs to go on.

    Attributes
    ----------
    coords : ndarray, shape (W, d)
        Walkers.
    log_density : ndarray, shape (W,)
        Their log densities.
    random : tuple
        State of the ensemble's own generator (legacy Mersenne Twister tuple).
    accepted : ndarray of int, shape (W,)
        Accepted proposals per walker so far.
    steps : int
        Steps taken so far.
    """

    coords: Array
    log_density: Array
    random: tuple[Any, ...]
    accepted: NDArray[np.int64]
    steps: int


def start(target: Target, points: Array, seed: np.random.SeedSequence) -> EnsembleState:
    """Place walkers and seed the ensemble's generator.

    Parameters
    ----------
    target : Target
        The density.
    points : ndarray, shape (W, d)
        First positions.
    seed : numpy.random.SeedSequence
        The ensemble's own seed.

    Returns
    -------
    EnsembleState

    Raises
    ------
    RefusalError
        If the density is NaN anywhere, or -inf everywhere, naming the coordinates.
    """
    log_density = target(points)
    bad = np.isnan(log_density)
    if bad.any():
        where = points[int(np.argmax(bad))]
        raise RefusalError(f"the log density is NaN at {_describe(target.names, where)}.")
    if np.all(np.isneginf(log_density)):
        raise RefusalError(
            f"the log density is -inf at every walker, for example at {_describe(target.names, points[0])}.",
            hint="Check the data and the priors of these parameters.",
        )
    # emcee's random_state setter takes nothing but the legacy tuple, and ignores the rest in silence.
    state = np.random.RandomState(np.random.MT19937(seed)).get_state(legacy=True)
    return EnsembleState(
        np.array(points), log_density, tuple(state), np.zeros(len(points), dtype=np.int64), 0
    )


def _describe(names: list[str], point: Array) -> str:
    extreme = np.argsort(-np.abs(point))[:4]
    return ", ".join(f"{names[i]} = {point[i]:.6g}" for i in sorted(extreme.tolist()))


def advance(
    target: Target, law: Proposal, state: EnsembleState, *, steps: int, stride: int
) -> tuple[EnsembleState, Array]:
    """Run an ensemble for some steps and keep every `stride`-th position.

    Parameters
    ----------
    target : Target
        The density.
    law : Proposal
        Proposal, frozen.
    state : EnsembleState
        Where to go on from.
    steps : int
        Steps to take, a multiple of `stride`.
    stride : int
        Keep one position in so many.

    Returns
    -------
    state : EnsembleState
        Where the ensemble stands now.
    kept : ndarray, shape (steps // stride, W, d)
        Positions kept.
    """
    import emcee

    walkers, dimension = state.coords.shape
    sampler = emcee.EnsembleSampler(walkers, dimension, target, moves=moves(law), vectorize=True)
    current = emcee.State(state.coords, log_prob=state.log_density, random_state=state.random)
    kept = np.empty((steps // stride, walkers, dimension))
    accepted, before = state.accepted.copy(), state.log_density
    chain = sampler.sample(current, iterations=steps, store=False, skip_initial_state_check=True)
    for step, current in enumerate(chain, start=1):
        accepted += current.log_prob != before
        before = np.array(current.log_prob)
        if step % stride == 0:
            kept[step // stride - 1] = current.coords
    random = tuple(sampler.random_state) if steps else state.random
    after = EnsembleState(
        np.array(current.coords), np.array(current.log_prob), random, accepted, state.steps + steps
    )
    return after, kept
