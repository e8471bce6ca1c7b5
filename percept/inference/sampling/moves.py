"""A log density to sample, and ensembles of walkers that advance on it side by side.

emcee carries the walkers of all ensembles in one sampler, so that one call evaluates the density
for all of them. Walkers live in the coordinates of a transport, where the target resembles the
reference law. A move leaves that law invariant, and a step is accepted by the density over the law.
No walker ever sees another: all are independent chains.

emcee's acceptance is not used: it weighs one step at a time, where independent draws of several
steps share one call of the density. Fits of the published study take 1.3 times as long with it.
emcee's snooker move is not among the moves: up to release 3.1.6 it does not sample the density it
is given, and intervals come out too narrow with clean diagnostics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.imports import standing_in


def _gaussian_kde(*arguments: Any, **options: Any) -> Any:
    """Stand for SciPy's until a move of emcee's that percept does not use asks for it."""
    from scipy import stats

    return stats.gaussian_kde(*arguments, **options)


# emcee would import all of scipy.stats for that move, which takes a tenth of a fit.
with standing_in({"scipy.stats": SimpleNamespace(gaussian_kde=_gaussian_kde)}):
    import emcee

Array = NDArray[np.float64]
#: A log density of points (N, d), shape (N,).
Density = Callable[[Array], Array]

#: Tails a little heavier than normal: a proposal must not miss what the transport did. There are as
#: many degrees of freedom as dimensions: with fewer, the radius alone would not look normal.
_FEWEST_DF = 20.0
#: Share of independent draws among the steps. Walkers leave a far tail by rotations alone, and a
#: limit that hangs on such a tail needs them wherever the bulk is served well.
_INDEPENDENT = 0.6
#: Steps whose independent draws are weighed in one density call.
_AHEAD = 4
#: Coordinates that a message names.
_MOST_NAMED = 4


class Target(Protocol):
    """A log density to sample."""

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), shape (W,); -inf allowed, NaN not."""


def describe_point(names: list[str], point: Array) -> str:
    """Write out the four coordinates farthest from zero, in order."""
    by_size = np.argsort(-np.abs(point))
    extreme = sorted(by_size[:_MOST_NAMED].tolist())
    return ", ".join(f"{names[i]} = {point[i]:.6g}" for i in extreme)


@dataclass(frozen=True, eq=False)
class Transported:
    """A target in the coordinates of a map, whose values are never NaN."""

    target: Target
    #: Takes points (N, d) to the target's coordinates, and returns them with log abs det of the
    #: Jacobian, shape (N,).
    transport: Callable[[Array], tuple[Array, Array]]

    def map(self, z: Array) -> Array:
        """Take points to the target's coordinates."""
        points, _ = self.transport(z)
        return points

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d) of the map's coordinates, shape (W,)."""
        mapped, log_jacobian = self.transport(points)
        values = self.target(mapped)
        invalid = np.isnan(values)
        if invalid.any():
            first = int(np.argmax(invalid))
            where = describe_point(self.target.names, mapped[first])
            raise RefusalError(f"the log density is NaN at {where}.")
        return values + log_jacobian


class ReferenceLaw:
    """Multivariate t about zero with unit scale matrix."""

    def __init__(self, dimension: int) -> None:
        self.dimension = dimension
        self._df = max(_FEWEST_DF, float(dimension))
        self._total_df = self._df + dimension

    def log_density(self, points: Array) -> Array:
        """Log density at points (N, d) but for a constant, shape (N,)."""
        square = np.einsum("nd,nd->n", points, points)
        return -0.5 * self._total_df * np.log1p(square / self._df)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` points, shape (count, d)."""
        gamma = rng.standard_gamma(0.5 * self._df, size=count)
        radius = np.sqrt(0.5 * self._df / gamma)
        normal = rng.standard_normal((count, self.dimension))
        return radius[:, None] * normal

    def rotate(self, points: Array, rng: np.random.Generator) -> Array:
        """Rotate points about zero by random angles, leaving the law invariant.

        A t law is normal given its radius. Drawing the radius given the point and rotating towards
        a normal draw of that radius is reversible with respect to the law, at any angle.
        """
        count = len(points)
        square = np.einsum("nd,nd->n", points, points)
        gamma = rng.standard_gamma(0.5 * self._total_df, size=count)
        radius = np.sqrt(0.5 * (self._df + square) / gamma)
        # Many small angles: in a far tail only short steps are accepted.
        angle = 0.5 * math.pi * rng.random(count) ** 2
        sine = (np.sin(angle) * radius)[:, None]
        towards = sine * rng.standard_normal(points.shape)
        return np.cos(angle)[:, None] * points + towards


class ReferenceMove(emcee.moves.Move):  # type: ignore[misc]  # emcee is untyped
    """Metropolis-Hastings step of all walkers at once.

    Points are drawn for walkers (N, d), for one step or several, (steps N, d), in a way that leaves
    the law invariant.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        law: ReferenceLaw,
        draw: Callable[[Array], Array],
    ) -> None:
        self._rng = rng
        self._law = law
        self._draw = draw
        # Of each step to come: points (N, d), their log density and that of the law, (N,).
        self._offers: list[tuple[Array, Array, Array]] = []
        self.accepted: Array | int = 0  # Accepted steps per walker

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """Propose for every walker once and accept or not."""
        coords = state.coords.copy()
        log_prob = state.log_prob.copy()
        if not self._offers:
            points = self._draw(coords)
            steps = len(points) // len(coords)
            # The density itself: emcee's `compute_log_prob_fn` unpacks values one by one, for
            # blobs.
            weighed = (points, model.log_prob_fn(points), self._law.log_density(points))
            self._offers = list(zip(*(np.split(array, steps) for array in weighed), strict=True))
        offered, offered_log_prob, offered_log_law = self._offers.pop()
        uniform = self._rng.random(len(coords))
        log_weight = log_prob - self._law.log_density(coords)
        with np.errstate(divide="ignore", invalid="ignore"):
            accepted = np.log(uniform) < offered_log_prob - offered_log_law - log_weight
        self.accepted = self.accepted + accepted
        coords[accepted] = offered[accepted]
        log_prob[accepted] = offered_log_prob[accepted]
        return emcee.State(coords, log_prob=log_prob), accepted


def standard_moves(
    law: ReferenceLaw,
    rng: np.random.Generator,
) -> list[tuple[ReferenceMove, float]]:
    """Return the moves of a run with their shares, for `emcee.EnsembleSampler(moves=...)`.

    Independent draws decorrelate at once where the transport fits. No draw depends on where a
    walker is, so the draws of several steps share one density call. Rotations are preconditioned
    Crank-Nicolson steps for a t law: small angles leave places that the transport serves badly.
    """
    independent = ReferenceMove(rng, law, lambda walkers: law.draw(_AHEAD * len(walkers), rng))
    rotated = ReferenceMove(rng, law, lambda walkers: law.rotate(walkers, rng))
    return [(independent, _INDEPENDENT), (rotated, 1.0 - _INDEPENDENT)]


class Ensembles:
    """E ensembles of W walkers on a log density."""

    def __init__(
        self,
        density: Density,
        points: Array,
        seed: np.random.SeedSequence,
    ) -> None:
        """Start from points (E, W, d), which are left as they are."""
        self._density = density
        self._shape = points.shape
        flat = points.reshape(-1, points.shape[-1])
        schedule_seed, draw_seed = seed.spawn(2)
        self._rng = np.random.default_rng(draw_seed)
        # emcee's random_state setter takes nothing but the legacy tuple, and ignores the rest in
        # silence.
        legacy = np.random.RandomState(np.random.MT19937(schedule_seed))
        random_state = legacy.get_state(legacy=True)
        log_prob = density(flat)
        self._state = emcee.State(flat, log_prob=log_prob, random_state=random_state, copy=True)
        self.accepted = np.zeros(len(flat))  # (E W,) Accepted steps per walker so far
        self.steps = 0  # Steps taken so far

    def advance(self, steps: int, stride: int) -> Array:
        """Run all ensembles for some steps; every `stride`-th position, (E, T, W, d)."""
        ensembles, walkers, dimension = self._shape
        law = ReferenceLaw(dimension)
        moves = standard_moves(law, self._rng)
        sampler = emcee.EnsembleSampler(
            ensembles * walkers, dimension, self._density, moves=moves, vectorize=True
        )
        # emcee's wrapper prints all walkers to the terminal when a density is interrupted.
        sampler.log_prob_fn = self._density
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
        return kept
