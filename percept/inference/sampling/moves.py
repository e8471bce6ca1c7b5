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

from percept.inference.sampling.transport import Target, refuse_impossible

Array = NDArray[np.float64]


#: Tails a little heavier than normal: a proposal must not miss what the transport did. As many degrees of
#: freedom as dimensions, or the radius alone would tell the law from a normal one.
_FEWEST_DF = 20.0


class Reference:
    """Multivariate t about zero with unit scale matrix."""

    def __init__(self, dimension: int) -> None:
        self.dimension = dimension
        self._df = df = max(_FEWEST_DF, float(dimension))
        self._constant = (
            math.lgamma(0.5 * (df + dimension))
            - math.lgamma(0.5 * df)
            - 0.5 * dimension * math.log(math.pi * df)
        )

    def log_density(self, points: Array) -> Array:
        """Log density at points of shape (N, d), shape (N,)."""
        square = np.einsum("nd,nd->n", points, points)
        return self._constant - 0.5 * (self._df + self.dimension) * np.log1p(square / self._df)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` points, shape (count, d)."""
        radius = np.sqrt(0.5 * self._df / rng.standard_gamma(0.5 * self._df, size=count))
        return radius[:, None] * rng.standard_normal((count, self.dimension))

    def rotate(self, points: Array, rng: np.random.Generator) -> Array:
        """Rotate points about zero by random angles, leaving the law invariant.

        A t law is normal given its radius: drawing the radius given the point and rotating towards
        a normal draw of that radius is reversible with respect to the law, at any angle.
        """
        count = len(points)
        square = np.einsum("nd,nd->n", points, points)
        gamma = rng.standard_gamma(0.5 * (self._df + self.dimension), size=count)
        radius = np.sqrt(0.5 * (self._df + square) / gamma)
        # Many small angles: in a far tail only short steps are accepted.
        angle = 0.5 * math.pi * rng.random(count) ** 2
        towards = (np.sin(angle) * radius)[:, None] * rng.standard_normal(points.shape)
        return np.cos(angle)[:, None] * points + towards


Generators = Sequence[np.random.Generator]
#: A log density, points (N, d) to (N,).
Density = Callable[[Array], Array]
#: Least and most share of independent draws. Walkers leave a far tail by rotations alone, and a limit that
#: hangs on such a tail needs them wherever the bulk is served well.
_LEAST_INDEPENDENT, _MOST_INDEPENDENT = 0.1, 0.6
#: Walkers by whose jumps moves are compared, a fraction: those the transport serves worst leave last, and
#: decide how long a run remembers.
_WORST = 0.1
#: Cost of an independent draw over that of a rotation: several steps share one density call.
_COST_INDEPENDENT = 0.8
#: Steps whose independent draws are weighed in one density call.
_AHEAD = 4


class _ReferenceMove(emcee.moves.Move):  # type: ignore[misc]  # emcee is untyped
    """Metropolis-Hastings step of all walkers at once, each ensemble with its own generator.

    Steps leave the reference law invariant, and are judged by the density over that law.
    """

    def __init__(self, generators: Generators, law: Reference) -> None:
        self._generators = generators
        self._law = law
        self.steps, self.jumped = 0, 0.0  # Steps taken, and the sum of their worst walkers' squared jumps

    def propose(self, model: emcee.model.Model, state: emcee.State) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Propose for every walker once and accept or not."""
        coords, log_prob = state.coords.copy(), state.log_prob.copy()
        # The density itself: emcee's own call goes through every value in Python, and its wrapper prints all
        # of them when a run is interrupted.
        points, values, log_law = self._offer(getattr(model.log_prob_fn, "f", model.log_prob_fn), coords)
        uniform = self._by_ensemble(coords, lambda own, generator: generator.random(len(own)))
        weight = log_prob - self._law.log_density(coords)
        with np.errstate(divide="ignore", invalid="ignore"):
            accepted = np.log(uniform) < values - log_law - weight
        worst = np.argsort(-weight)[: max(1, round(_WORST * len(coords)))]
        jumps = np.where(accepted[worst, None], points[worst] - coords[worst], 0.0)
        self.steps, self.jumped = self.steps + 1, self.jumped + float(np.square(jumps).mean())
        coords[accepted], log_prob[accepted] = points[accepted], values[accepted]
        return emcee.State(coords, log_prob=log_prob), accepted

    def _by_ensemble(self, coords: Array, draw: Callable[[Array, np.random.Generator], Array]) -> Array:
        """Draw for the walkers (N, d) of each ensemble by its own generator."""
        groups = np.split(coords, len(self._generators))
        return np.concatenate([draw(own, g) for own, g in zip(groups, self._generators, strict=True)])

    @abstractmethod
    def _offer(self, density: Density, coords: Array) -> tuple[Array, Array, Array]:
        """Points (N, d) offered to the walkers, with their log density and that of the law, each (N,)."""


class IndependentMove(_ReferenceMove):
    """Independent draws from the reference law: they decorrelate at once where the transport fits.

    No draw depends on where a walker is, so the draws of several steps share one density call.
    """

    def __init__(self, generators: Generators, law: Reference) -> None:
        super().__init__(generators, law)
        self._ahead: list[tuple[Array, Array, Array]] = []

    def _offer(self, density: Density, coords: Array) -> tuple[Array, Array, Array]:
        if not self._ahead:
            law, size = self._law, coords.shape[1]
            drawn = self._by_ensemble(
                coords, lambda own, g: law.draw(_AHEAD * len(own), g).reshape(len(own), _AHEAD, size)
            )
            points = np.ascontiguousarray(drawn.swapaxes(0, 1)).reshape(-1, size)
            parts = (np.split(part, _AHEAD) for part in (points, density(points), law.log_density(points)))
            self._ahead = list(zip(*parts, strict=True))
        return self._ahead.pop()


class PCNMove(_ReferenceMove):
    """Preconditioned Crank-Nicolson steps for a t law: rotations towards a fresh draw, by random angles.

    Small angles leave places that the transport serves badly.
    """

    def _offer(self, density: Density, coords: Array) -> tuple[Array, Array, Array]:
        points = self._by_ensemble(coords, self._law.rotate)
        return points, density(points), self._law.log_density(points)


def standard_moves(
    law: Reference, generators: Generators, independent: float = 0.5
) -> list[tuple[_ReferenceMove, float]]:
    """Return the moves of a run with their shares, for `emcee.EnsembleSampler(moves=...)`."""
    return [(IndependentMove(generators, law), independent), (PCNMove(generators, law), 1.0 - independent)]


def _earned(moves: Sequence[tuple[_ReferenceMove, float]]) -> tuple[float, float]:
    """Share of independent draws, by the squared jumps of both kinds for the same cost; and a step's jump.

    Jumps are in standard coordinates, each about the normal score of one of the target's, and of the walkers
    that the transport serves worst.
    """
    each = np.array([move.jumped / max(move.steps, 1) for move, _ in moves])
    worth = each / (_COST_INDEPENDENT, 1.0)
    share = worth[0] / worth.sum() if worth.any() else 0.5
    share = float(np.clip(share, _LEAST_INDEPENDENT, _MOST_INDEPENDENT))
    return share, float(share * each[0] + (1.0 - share) * each[1])


@dataclasses.dataclass(frozen=True, eq=False)
class Ensembles:
    """Everything E ensembles of W walkers need to go on."""

    coords: Array  # (E, W, d) Walkers
    log_density: Array  # (E, W) Their log densities
    schedule: tuple[Any, ...]
    generators: tuple[dict[str, Any], ...]  # State of each ensemble's own generator
    accepted: NDArray[np.int64]  # (E, W) Accepted steps per walker so far
    steps: int  # Steps taken so far
    independent: float = 0.5  # Share of independent draws among the steps
    jump: float = math.nan  # Mean squared jump of a step where that share was chosen


def start(target: Target, points: Array, seed: np.random.SeedSequence) -> Ensembles:
    """Place walkers and give every ensemble a generator of its own."""
    ensembles, walkers, dimension = points.shape
    flat = points.reshape(-1, dimension)
    log_density = target(flat)
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
    target: Target, state: Ensembles, *, steps: int, stride: int, learn: bool = False
) -> tuple[Ensembles, Array]:
    """Run all ensembles for some steps and keep every `stride`-th position.

    A run that learns leaves the share of independent draws that these steps earned.
    """
    ensembles, walkers, dimension = state.coords.shape
    generators = [np.random.Generator(np.random.PCG64()) for _ in range(ensembles)]
    for generator, stored in zip(generators, state.generators, strict=True):
        generator.bit_generator.state = stored
    moves = standard_moves(Reference(dimension), generators, state.independent)
    sampler = emcee.EnsembleSampler(ensembles * walkers, dimension, target, moves=moves, vectorize=True)
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
            kept[:, step // stride - 1] = current.coords.reshape(state.coords.shape)
    after = Ensembles(
        np.array(current.coords).reshape(state.coords.shape),
        np.array(current.log_prob).reshape(state.log_density.shape),
        tuple(sampler.random_state) if steps else state.schedule,
        tuple(dict(generator.bit_generator.state) for generator in generators),
        accepted.reshape(state.accepted.shape),
        state.steps + steps,
        *(_earned(moves) if learn else (state.independent, state.jump)),
    )
    return after, kept
