"""emcee moves for several ensembles that advance side by side and never see each other.

One sampler carries the walkers of all ensembles, so that one call evaluates the density for all of
them; each ensemble proposes and accepts from its own generator, within its own walkers. Walkers live in the
coordinates of a transport, where the target resembles the reference law.

emcee's snooker move is not among them: up to release 3.1.6 it does not sample the density it is
given, and intervals come out too narrow with clean diagnostics.
"""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.transport import Checked, Target, refuse_impossible

Array = NDArray[np.float64]


_DF = 20.0  # tails a little heavier than normal: a proposal must not miss what the transport did


class Reference:
    """Multivariate t about zero with unit scale matrix."""

    def __init__(self, dimension: int) -> None:
        self.dimension = dimension
        self._constant = (
            math.lgamma(0.5 * (_DF + dimension))
            - math.lgamma(0.5 * _DF)
            - 0.5 * dimension * math.log(math.pi * _DF)
        )

    def log_density(self, points: Array) -> Array:
        """Log density at points of shape (N, d), shape (N,)."""
        square = np.einsum("nd,nd->n", points, points)
        return self._constant - 0.5 * (_DF + self.dimension) * np.log1p(square / _DF)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` points, shape (count, d)."""
        radius = np.sqrt(0.5 * _DF / rng.standard_gamma(0.5 * _DF, size=count))
        return radius[:, None] * rng.standard_normal((count, self.dimension))

    def turn(self, points: Array, rng: np.random.Generator) -> Array:
        """Turn points about zero by random angles, leaving the law invariant.

        A t law is normal given its radius: drawing the radius given the point and rotating towards
        a normal draw of that radius is reversible with respect to the law, at any angle.
        """
        count = len(points)
        square = np.einsum("nd,nd->n", points, points)
        gamma = rng.standard_gamma(0.5 * (_DF + self.dimension), size=count)
        radius = np.sqrt(0.5 * (_DF + square) / gamma)
        # Many small angles: in a far tail only short steps are accepted.
        angle = 0.5 * math.pi * rng.random(count) ** 2
        towards = (np.sin(angle) * radius)[:, None] * rng.standard_normal(points.shape)
        return np.cos(angle)[:, None] * points + towards


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
