"""emcee moves for several ensembles that advance side by side and never see each other.

One sampler carries the walkers of all ensembles, so that one call evaluates the density for all of
them; each ensemble proposes and accepts from its own generator, within its own walkers.

emcee's snooker move is not among them: up to release 3.1.6 it does not sample the density it is
given, and intervals come out too narrow with clean diagnostics.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import emcee
import numpy as np
from emcee.moves.move import Move
from numpy.typing import NDArray

from percept.inference.sampling.proposal import Proposal

__all__ = ["DifferentialMove", "EllipticMove", "IndependentMove", "standard_moves"]

Array = NDArray[np.float64]
Generators = Sequence[np.random.RandomState]
_SHARES = (0.4, 0.4, 0.2)
_JITTER = 1e-5


class _EnsemblesMove(Move):  # type: ignore[misc]  # emcee is untyped
    """Metropolis-Hastings step of all ensembles, each with its own generator.

    Parameters
    ----------
    generators : sequence of numpy.random.RandomState
        One per ensemble; walkers are grouped in this order.
    """

    def __init__(self, generators: Generators) -> None:
        self._generators = generators

    def propose(self, model: emcee.model.Model, state: emcee.State) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Propose for every walker once and accept or not."""
        accepted = np.zeros(len(state.coords), dtype=bool)
        groups = np.split(np.arange(len(state.coords)), len(self._generators))
        for movers in self._rounds(groups):
            parts = [
                self._proposal(state.coords, group, moving, random)
                for group, moving, random in zip(groups, movers, self._generators, strict=True)
            ]
            proposed, factors = (np.concatenate(part) for part in zip(*parts, strict=True))
            log_prob, blobs = model.compute_log_prob_fn(proposed)
            moving = np.concatenate(movers)
            draws = np.concatenate(
                [random.rand(len(m)) for m, random in zip(movers, self._generators, strict=True)]
            )
            taken = np.zeros(len(state.coords), dtype=bool)
            with np.errstate(divide="ignore", invalid="ignore"):
                taken[moving] = np.log(draws) < factors + log_prob - state.log_prob[moving]
            order = np.argsort(moving)
            subset = np.zeros(len(state.coords), dtype=bool)
            subset[moving] = True
            new = emcee.State(proposed[order], log_prob=log_prob[order], blobs=blobs)
            state = self.update(state, new, taken, subset)
            accepted |= taken
        return state, accepted

    def _rounds(self, groups: list[NDArray[np.intp]]) -> list[list[NDArray[np.intp]]]:
        """Which walkers of each ensemble move together: all of them, in one round."""
        return [groups]

    @abstractmethod
    def _proposal(
        self, coords: Array, group: NDArray[np.intp], moving: NDArray[np.intp], random: np.random.RandomState
    ) -> tuple[Array, Array]:
        """Propose for the moving walkers of one ensemble; return also the log Hastings factors."""


class _LawMove(_EnsemblesMove):
    """A step that leaves a fitted law invariant, judged by the density over the law."""

    def __init__(self, generators: Generators, law: Proposal) -> None:
        super().__init__(generators)
        self._law = law

    def _proposal(
        self, coords: Array, group: NDArray[np.intp], moving: NDArray[np.intp], random: np.random.RandomState
    ) -> tuple[Array, Array]:
        before = coords[moving]
        after = self._step(before, random)
        both = self._law.log_density(np.concatenate([before, after]))
        return after, both[: len(moving)] - both[len(moving) :]

    @abstractmethod
    def _step(self, coords: Array, random: np.random.RandomState) -> Array:
        """Step from each point."""


class IndependentMove(_LawMove):
    """Independent draws from the law: they decorrelate at once where the law fits."""

    def _step(self, coords: Array, random: np.random.RandomState) -> Array:
        return self._law.draw(len(coords), random)


class EllipticMove(_LawMove):
    """Turns about the law's centre by random angles: short enough to leave places it serves badly."""

    def _step(self, coords: Array, random: np.random.RandomState) -> Array:
        return self._law.turn(coords, random)


class DifferentialMove(_EnsemblesMove):
    """Differential evolution (ter Braak 2006) between the halves of an ensemble; needs no law."""

    def _rounds(self, groups: list[NDArray[np.intp]]) -> list[list[NDArray[np.intp]]]:
        shuffled = [random.permutation(group) for group, random in zip(groups, self._generators, strict=True)]
        half = [len(group) // 2 for group in groups]
        return [
            [group[:middle] for group, middle in zip(shuffled, half, strict=True)],
            [group[middle:] for group, middle in zip(shuffled, half, strict=True)],
        ]

    def _proposal(
        self, coords: Array, group: NDArray[np.intp], moving: NDArray[np.intp], random: np.random.RandomState
    ) -> tuple[Array, Array]:
        others = np.setdiff1d(group, moving)
        count, size = len(moving), coords.shape[1]
        first = random.randint(len(others), size=count)
        second = (first + random.randint(1, len(others), size=count)) % len(others)
        reach = 2.38 / np.sqrt(2.0 * size) * (1.0 + _JITTER * random.randn(count, 1))
        return coords[moving] + reach * (coords[others[first]] - coords[others[second]]), np.zeros(count)


def standard_moves(law: Proposal, generators: Generators) -> list[tuple[Move, float]]:
    """Return the moves of a run with their shares, for `emcee.EnsembleSampler(moves=...)`.

    Parameters
    ----------
    law : Proposal
        Fitted law, frozen.
    generators : sequence of numpy.random.RandomState
        One per ensemble.

    Returns
    -------
    list of (emcee move, share)
    """
    return [
        (IndependentMove(generators, law), _SHARES[0]),
        (EllipticMove(generators, law), _SHARES[1]),
        (DifferentialMove(generators), _SHARES[2]),
    ]
