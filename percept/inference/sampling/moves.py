"""emcee moves for several ensembles that advance side by side and never see each other.

One sampler carries the walkers of all ensembles, so that one call evaluates the density for all of
them; each ensemble proposes and accepts from its own generator, within its own walkers.

emcee's snooker move is not among them: up to release 3.1.6 it does not sample the density it is
given, and intervals come out too narrow with clean diagnostics.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence

import emcee
import numpy as np
from emcee.moves.move import Move
from numpy.typing import NDArray

from percept.inference.sampling.proposal import Proposal

__all__ = ["DifferentialMove", "EllipticMove", "IndependentMove", "standard_moves"]

Array = NDArray[np.float64]
Generators = Sequence[np.random.RandomState]
#: Indices of walkers, one array per ensemble.
Groups = list[NDArray[np.intp]]
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
            moving = np.concatenate(movers)
            proposed, factors = self._proposal(state.coords, groups, movers)
            log_prob, blobs = model.compute_log_prob_fn(proposed)
            draws = self._noise(movers, lambda random, count: random.random_sample(count))
            taken = np.zeros(len(state.coords), dtype=bool)
            with np.errstate(divide="ignore", invalid="ignore"):
                taken[moving] = np.log(draws) < factors + log_prob - state.log_prob[moving]
            subset = np.zeros(len(state.coords), dtype=bool)
            subset[moving] = True
            order = np.argsort(moving)
            new = emcee.State(proposed[order], log_prob=log_prob[order], blobs=blobs)
            state = self.update(state, new, taken, subset)
            accepted |= taken
        return state, accepted

    def _noise(self, movers: Groups, draw: Callable[[np.random.RandomState, int], Array]) -> Array:
        """Noise for every moving walker, each ensemble's from its own generator."""
        return np.concatenate(
            [draw(random, len(group)) for group, random in zip(movers, self._generators, strict=True)]
        )

    def _rounds(self, groups: Groups) -> list[Groups]:
        """Which walkers of each ensemble move together: all of them, in one round."""
        return [groups]

    @abstractmethod
    def _proposal(self, coords: Array, groups: Groups, movers: Groups) -> tuple[Array, Array]:
        """Propose for the moving walkers, ensemble by ensemble; and the log Hastings factors."""


class _LawMove(_EnsemblesMove):
    """A step that leaves a fitted law invariant, judged by the density over the law."""

    def __init__(self, generators: Generators, law: Proposal) -> None:
        super().__init__(generators)
        self._law = law

    def _proposal(self, coords: Array, groups: Groups, movers: Groups) -> tuple[Array, Array]:
        before = coords[np.concatenate(movers)]
        after = self._step(before, movers)
        both = self._law.log_density(np.concatenate([before, after]))
        return after, both[: len(before)] - both[len(before) :]

    def _normal(self, movers: Groups) -> Array:
        size = self._law.centre.size
        return self._noise(movers, lambda random, count: random.standard_normal((count, size)))

    @abstractmethod
    def _step(self, coords: Array, movers: Groups) -> Array:
        """Step from each point."""


class IndependentMove(_LawMove):
    """Independent draws from the law: they decorrelate at once where the law fits."""

    def _step(self, coords: Array, movers: Groups) -> Array:
        shape = self._law.gamma_shape
        gamma = self._noise(movers, lambda random, count: random.standard_gamma(shape, size=count))
        return self._law.from_noise(self._normal(movers), gamma)


class EllipticMove(_LawMove):
    """Turns about the law's centre by random angles: short enough to leave places it serves badly."""

    def _step(self, coords: Array, movers: Groups) -> Array:
        shape = self._law.turn_shape
        gamma = self._noise(movers, lambda random, count: random.standard_gamma(shape, size=count))
        angle = self._noise(movers, lambda random, count: 0.5 * np.pi * random.random_sample(count))
        return self._law.turn(coords, self._normal(movers), gamma, angle)


class DifferentialMove(_EnsemblesMove):
    """Differential evolution (ter Braak 2006) between the halves of an ensemble; needs no law."""

    def _rounds(self, groups: Groups) -> list[Groups]:
        shuffled = [random.permutation(group) for group, random in zip(groups, self._generators, strict=True)]
        half = [len(group) // 2 for group in groups]
        return [
            [group[:middle] for group, middle in zip(shuffled, half, strict=True)],
            [group[middle:] for group, middle in zip(shuffled, half, strict=True)],
        ]

    def _proposal(self, coords: Array, groups: Groups, movers: Groups) -> tuple[Array, Array]:
        size = coords.shape[1]
        differences, reach = [], []
        for group, moving, random in zip(groups, movers, self._generators, strict=True):
            others = np.setdiff1d(group, moving)
            first = random.randint(len(others), size=len(moving))
            second = (first + random.randint(1, len(others), size=len(moving))) % len(others)
            differences.append(coords[others[first]] - coords[others[second]])
            reach.append(1.0 + _JITTER * random.standard_normal((len(moving), 1)))
        length = 2.38 / np.sqrt(2.0 * size) * np.concatenate(reach)
        moving = np.concatenate(movers)
        return coords[moving] + length * np.concatenate(differences), np.zeros(len(moving))


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
