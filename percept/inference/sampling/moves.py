"""emcee moves for several ensembles that advance side by side and never see each other.

One sampler carries the walkers of all ensembles, so that one call evaluates the density for all of
them; each ensemble proposes and accepts from its own generator, within its own walkers. Walkers
live in the coordinates of a transport, where the target resembles the reference law.

emcee's snooker move is not among them: up to release 3.1.6 it does not sample the density it is
given, and intervals come out too narrow with clean diagnostics.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence

import emcee
import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.coordinates import Target

Array = NDArray[np.float64]


#: Tails a little heavier than normal: a proposal must not miss what the transport did. As many
#: degrees of freedom as dimensions, or the radius alone would tell the law from a normal one.
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
#: Least and most share of independent draws. Walkers leave a far tail by rotations alone, and a
#: limit that hangs on such a tail needs them wherever the bulk is served well.
_LEAST_INDEPENDENT, _MOST_INDEPENDENT = 0.1, 0.6
#: Walkers by whose jumps moves are compared, a fraction: those the transport serves worst leave
#: last, and decide how long a run remembers.
_WORST = 0.1
#: Cost of an independent draw over that of a rotation: several steps share one density call.
_COST_INDEPENDENT = 0.8
#: Steps whose independent draws are weighed in one density call.
_AHEAD = 4


class ReferenceMove(emcee.moves.Move):  # type: ignore[misc]  # emcee is untyped
    """Metropolis-Hastings step of all walkers at once, each ensemble with its own generator.

    Steps leave the reference law invariant, and are judged by the density over that law.
    """

    def __init__(self, generators: Generators, law: Reference) -> None:
        self._generators = generators
        self._law = law
        self._offers: list[tuple[Array, Array, Array]] = []
        self.steps, self.jumped = (
            0,
            0.0,
        )  # Steps taken, and the sum of their worst walkers' squared jumps
        self.accepted: Array | int = 0  # Accepted steps per walker

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Propose for every walker once and accept or not."""
        coords, log_prob = state.coords.copy(), state.log_prob.copy()
        if not self._offers:
            offered = self._by_ensemble(coords, self._draw).swapaxes(0, 1)
            flat = np.ascontiguousarray(offered).reshape(-1, coords.shape[1])
            # The density itself: emcee's own call goes through every value in Python, and its
            # wrapper prints all of them when a run is interrupted.
            density = getattr(model.log_prob_fn, "f", model.log_prob_fn)
            parts = (flat, density(flat), self._law.log_density(flat))
            steps = (np.split(part, offered.shape[0]) for part in parts)
            self._offers = list(zip(*steps, strict=True))
        points, values, log_law = self._offers.pop()
        uniform = self._by_ensemble(coords, lambda own, generator: generator.random(len(own)))
        weight = log_prob - self._law.log_density(coords)
        with np.errstate(divide="ignore", invalid="ignore"):
            accepted = np.log(uniform) < values - log_law - weight
        worst = np.argsort(-weight)[: max(1, round(_WORST * len(coords)))]
        jumps = np.where(accepted[worst, None], points[worst] - coords[worst], 0.0)
        self.steps, self.jumped = self.steps + 1, self.jumped + float(np.square(jumps).mean())
        self.accepted = self.accepted + accepted
        coords[accepted], log_prob[accepted] = points[accepted], values[accepted]
        return emcee.State(coords, log_prob=log_prob), accepted

    def _by_ensemble(
        self, coords: Array, draw: Callable[[Array, np.random.Generator], Array]
    ) -> Array:
        """Draw for the walkers (N, d) of each ensemble by its own generator."""
        groups = np.split(coords, len(self._generators))
        return np.concatenate(
            [draw(own, g) for own, g in zip(groups, self._generators, strict=True)]
        )

    @abstractmethod
    def _draw(self, coords: Array, generator: np.random.Generator) -> Array:
        """Points for the walkers (n, d) of an ensemble at this step and maybe some more, (n, steps, d)."""


class IndependentMove(ReferenceMove):
    """Independent draws from the reference law: they decorrelate at once where the transport fits.

    No draw depends on where a walker is, so the draws of several steps share one density call.
    """

    def _draw(self, coords: Array, generator: np.random.Generator) -> Array:
        count, size = coords.shape
        return self._law.draw(_AHEAD * count, generator).reshape(count, _AHEAD, size)


class PCNMove(ReferenceMove):
    """Preconditioned Crank-Nicolson steps for a t law: rotations towards a fresh draw, by random angles.

    Small angles leave places that the transport serves badly.
    """

    def _draw(self, coords: Array, generator: np.random.Generator) -> Array:
        return self._law.rotate(coords, generator)[:, None]


def standard_moves(
    law: Reference, generators: Generators, independent: float = 0.5
) -> list[tuple[ReferenceMove, float]]:
    """Return the moves of a run with their shares, for `emcee.EnsembleSampler(moves=...)`."""
    return [
        (IndependentMove(generators, law), independent),
        (PCNMove(generators, law), 1.0 - independent),
    ]


def _earned(moves: Sequence[tuple[ReferenceMove, float]]) -> tuple[float, float]:
    """Share of independent draws, by the squared jumps of both kinds for the same cost; and a step's jump.

    Jumps are in standard coordinates, each about the normal score of one of the target's, and of
    the walkers that the transport serves worst.
    """
    each = np.array([move.jumped / max(move.steps, 1) for move, _ in moves])
    worth = each / (_COST_INDEPENDENT, 1.0)
    share = worth[0] / worth.sum() if worth.any() else 0.5
    share = float(np.clip(share, _LEAST_INDEPENDENT, _MOST_INDEPENDENT))
    return share, float(share * each[0] + (1.0 - share) * each[1])


class Ensembles:
    """E ensembles of W walkers on a target, each ensemble with a generator of its own."""

    def __init__(self, target: Target, points: Array, seed: np.random.SeedSequence) -> None:
        self._target, self._shape = target, points.shape
        flat = points.reshape(-1, points.shape[-1])
        schedule, *generators = seed.spawn(1 + len(points))
        self._generators = [np.random.Generator(np.random.PCG64(child)) for child in generators]
        # emcee's random_state setter takes nothing but the legacy tuple, and ignores the rest in
        # silence.
        random_state = np.random.RandomState(np.random.MT19937(schedule)).get_state(legacy=True)
        self._state = emcee.State(flat, log_prob=target(flat), random_state=random_state, copy=True)
        self.accepted = np.zeros(len(flat))  # (E W,) Accepted steps per walker so far
        self.steps = 0  # Steps taken so far
        self.independent = 0.5  # Share of independent draws among the steps
        self.jump = math.nan  # Mean squared jump of a step where that share was chosen

    def advance(self, steps: int, stride: int, *, learn: bool = False) -> Array:
        """Run all ensembles for some steps; every `stride`-th position, (E, T, W, d).

        A run that learns sets the share of independent draws to what these steps earned.
        """
        ensembles, walkers, dimension = self._shape
        moves = standard_moves(Reference(dimension), self._generators, self.independent)
        sampler = emcee.EnsembleSampler(
            ensembles * walkers, dimension, self._target, moves=moves, vectorize=True
        )
        kept = np.empty((ensembles, steps // stride, walkers, dimension))
        chain = sampler.sample(
            self._state,
            iterations=steps // stride,
            thin_by=stride,
            store=False,
            skip_initial_state_check=True,
        )
        for position, self._state in enumerate(chain):
            kept[:, position] = self._state.coords.reshape(self._shape)
        self.accepted += sum(move.accepted for move, _ in moves)
        self.steps += steps
        if learn:
            self.independent, self.jump = _earned(moves)
        return kept
