"""emcee moves for several ensembles that advance side by side and never see each other.

One sampler carries the walkers of all ensembles, so that one call evaluates the density for all of
them; each ensemble proposes and accepts from its own generator, within its own walkers. Walkers live in the
coordinates of a transport, where the target resembles the reference law.

emcee's snooker move is not among them: up to release 3.1.6 it does not sample the density it is
given, and intervals come out too narrow with clean diagnostics.
"""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Sequence

import emcee
import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.reference import Reference

Array = NDArray[np.float64]
Generators = Sequence[np.random.Generator]
#: Indices of walkers, one array per ensemble.
Groups = list[NDArray[np.intp]]
#: A log density, points (N, d) to (N,).
Density = Callable[[Array], Array]
#: Shares of the kinds of step: in many coordinates few independent draws are accepted, and turns are.
_SHARES, _SHARES_OF_MANY, _MANY = (0.6, 0.3, 0.1), (0.2, 0.7, 0.1), 48
_AHEAD = 4  # steps whose independent draws are weighed in one density call
_JITTER = 1e-5


@dataclasses.dataclass(frozen=True, eq=False)
class Offer:
    """What is offered to N moving walkers."""

    points: Array  # (N, d) Where they would go
    log_density: Array  # (N,) The target's log density there
    log_ratio: Array  # (N,) Log density of offering the way back, less that of offering the way there


class _EnsemblesMove(emcee.moves.Move):  # type: ignore[misc]  # emcee is untyped
    """Metropolis-Hastings step of all ensembles, each with its own generator."""

    def __init__(self, generators: Generators) -> None:
        self._generators = generators

    def propose(self, model: emcee.model.Model, state: emcee.State) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Propose for every walker once and accept or not."""
        coords, log_prob = state.coords.copy(), state.log_prob.copy()
        accepted = np.zeros(len(coords), dtype=bool)
        for movers in self._rounds(np.split(np.arange(len(coords)), len(self._generators))):
            moving = np.concatenate(movers)
            # The density itself: emcee's own call goes through every value in Python, and its wrapper prints
            # all of them when a run is interrupted.
            offer = self._offer(getattr(model.log_prob_fn, "f", model.log_prob_fn), coords, movers)
            uniform = [g.random(len(group)) for group, g in zip(movers, self._generators, strict=True)]
            with np.errstate(divide="ignore", invalid="ignore"):
                gain = offer.log_ratio + offer.log_density - log_prob[moving]
                taken = np.log(np.concatenate(uniform)) < gain
            moved = moving[taken]
            coords[moved], log_prob[moved] = offer.points[taken], offer.log_density[taken]
            accepted[moved] = True
        return emcee.State(coords, log_prob=log_prob), accepted

    def _rounds(self, groups: Groups) -> list[Groups]:
        """Which walkers of each ensemble move together: all of them, in one round."""
        return [groups]

    @abstractmethod
    def _offer(self, density: Density, coords: Array, movers: Groups) -> Offer:
        """Propose for the moving walkers, ensemble by ensemble."""


class _ReferenceMove(_EnsemblesMove):
    """A step that leaves the reference law invariant, judged by the density over that law."""

    def __init__(self, generators: Generators, reference: Reference) -> None:
        super().__init__(generators)
        self._reference = reference


class IndependentMove(_ReferenceMove):
    """Independent draws from the reference: they decorrelate at once where the transport fits.

    No draw depends on where a walker is, so those of several steps share one density call, which costs far
    less than a call for each.
    """

    def __init__(self, generators: Generators, reference: Reference) -> None:
        super().__init__(generators, reference)
        self._ahead: list[tuple[Array, Array, Array]] = []

    def _offer(self, density: Density, coords: Array, movers: Groups) -> Offer:
        law = self._reference
        if not self._ahead:
            drawn = [
                law.draw(_AHEAD * len(group), g).reshape(_AHEAD, len(group), -1)
                for group, g in zip(movers, self._generators, strict=True)
            ]
            points = np.concatenate(drawn, axis=1).reshape(-1, coords.shape[1])
            parts = (np.split(part, _AHEAD) for part in (points, density(points), law.log_density(points)))
            self._ahead = list(zip(*parts, strict=True))
        points, values, own = self._ahead.pop()
        return Offer(points, values, law.log_density(coords) - own)


class EllipticMove(_ReferenceMove):
    """Turns about zero by random angles: short enough to leave places the transport serves badly."""

    def _offer(self, density: Density, coords: Array, movers: Groups) -> Offer:
        law = self._reference
        points = np.concatenate(
            [law.turn(coords[group], g) for group, g in zip(movers, self._generators, strict=True)]
        )
        return Offer(points, density(points), law.log_density(coords) - law.log_density(points))


class DifferentialMove(_EnsemblesMove):
    """Differential evolution (ter Braak 2006) between the halves of an ensemble; needs no law."""

    def _rounds(self, groups: Groups) -> list[Groups]:
        shuffled = [g.permutation(group) for group, g in zip(groups, self._generators, strict=True)]
        half = [len(group) // 2 for group in groups]
        return [
            [group[:middle] for group, middle in zip(shuffled, half, strict=True)],
            [group[middle:] for group, middle in zip(shuffled, half, strict=True)],
        ]

    def _offer(self, density: Density, coords: Array, movers: Groups) -> Offer:
        size = coords.shape[1]
        groups = np.split(np.arange(len(coords)), len(self._generators))
        differences, reach = [], []
        for group, moving, g in zip(groups, movers, self._generators, strict=True):
            others = np.setdiff1d(group, moving)
            first = g.integers(len(others), size=len(moving))
            second = (first + g.integers(1, len(others), size=len(moving))) % len(others)
            differences.append(coords[others[first]] - coords[others[second]])
            reach.append(1.0 + _JITTER * g.standard_normal((len(moving), 1)))
        length = 2.38 / np.sqrt(2.0 * size) * np.concatenate(reach)
        moving = np.concatenate(movers)
        points = coords[moving] + length * np.concatenate(differences)
        return Offer(points, density(points), np.zeros(len(moving)))


def standard_moves(reference: Reference, generators: Generators) -> list[tuple[emcee.moves.Move, float]]:
    """Return the moves of a run with their shares, for `emcee.EnsembleSampler(moves=...)`."""
    moves = (
        IndependentMove(generators, reference),
        EllipticMove(generators, reference),
        DifferentialMove(generators),
    )
    shares = _SHARES if reference.dimension < _MANY else _SHARES_OF_MANY
    return list(zip(moves, shares, strict=True))
