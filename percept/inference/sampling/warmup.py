"""Warm-up: from a density to a frozen transport and starting points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.sampling.coordinates import Affine, Target, Transported, describe_point
from percept.inference.sampling.moves import Ensembles, Reference
from percept.inference.sampling.transport import Transport

Array = NDArray[np.float64]


_ROUNDS = 3
#: Steps of each adaptive run, how many of them are left out at its start, and the stride of those
#: kept.
_RUNS = ((48, 16, 4), (80, 16, 2))


def warm_up(
    target: Target, shape: tuple[int, int], seed: np.random.SeedSequence
) -> tuple[Transported, Array]:
    """Fit a transport to a density and find starting points.

    Mode and curvature give the first map; importance weights refine it; short runs give the samples
    to which the transport is fitted.
    """
    adapt_seed, *run_seeds = seed.spawn(1 + len(_RUNS))
    rng = np.random.default_rng(adapt_seed)
    mode, covariance = find_mode(target, np.zeros(len(target.names)))
    here = Transported(target, Affine.normal(mode, covariance))
    for _ in range(_ROUNDS):
        z, log_weights = _weigh(here, rng, shape)
        # Tempered, or a few lucky draws would decide the covariance.
        weights = _weights(log_weights, at_least=min(0.5 * len(z), 10.0 * mode.size))
        here = Transported(target, Affine.fit(here.map(z), weights))
    points = starting_points(here, rng, shape)
    for (steps, skipped, stride), run_seed in zip(_RUNS, run_seeds, strict=True):
        kept = Ensembles(here, points, run_seed).advance(steps, stride)[:, skipped // stride :]
        here = Transported(target, Transport.fit(here.map(kept.reshape(-1, mode.size))))
        points = starting_points(here, rng, shape)
    return here, points


def starting_points(here: Transported, rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Choose starting points (E, W, d): draws taken by their weights, evened out so that many are chosen."""
    z, log_weights = _weigh(here, rng, shape)
    chosen = rng.choice(
        len(z), size=shape[0] * shape[1], p=_weights(log_weights, at_least=0.05 * len(z))
    )
    return z[chosen].reshape(*shape, -1)


def _weigh(
    here: Transported, rng: np.random.Generator, shape: tuple[int, int]
) -> tuple[Array, Array]:
    """Draws from the reference law, and the log of the density over that law."""
    size = len(here.names)
    law = Reference(size)
    z = law.draw(max(2048, 40 * size, 2 * shape[0] * shape[1]), rng)
    values = here(z)
    if np.all(np.isneginf(values)):
        raise RefusalError(
            "the log density is -inf at every walker, for example at"
            f" {describe_point(here.names, z[0])}.",
            hint="Check the data and the priors of these parameters.",
        )
    return z, values - law.log_density(z)


def _weights(log_weights: Array, *, at_least: float) -> Array:
    """Normalised weights, raised to the largest power in (0, 1] that leaves the wanted effective size."""
    shifted = log_weights - np.max(log_weights)
    power = 1.0
    while True:
        weights = np.exp(power * shifted)
        weights /= weights.sum()
        if 1.0 / float(weights @ weights) >= at_least or power < 1e-6:
            return weights
        power *= 0.8


Density = Callable[[Array], Array]

_STEPS = 30  # of Newton, at most
_STEP = 1e-2  # finite differences of a log density whose coordinates have unit scale
#: Of more coordinates the curvature is taken along each alone: pairs would be too many.
_MOST_PAIRED = 128


def find_mode(density: Density, start: Array) -> tuple[Array, Array]:
    """Climb to a mode and measure the curvature there.

    Newton steps on central differences, with the Hessian's eigenvalues kept negative and the step
    halved until the density rises; all points of one step are evaluated in one call.
    """
    point, lengths = start, 0.5 ** np.arange(12)
    value = float(density(point[None])[0])
    for _ in range(_STEPS):
        gradient, hessian = _derivatives(density, point)
        covariance = _limited_inverse(hessian)
        step = covariance @ gradient
        trials = point + lengths[:, None] * step
        values = density(trials)
        best = int(np.argmax(values))
        if not values[best] > value:
            break
        rise = values[best] - value
        point, value = trials[best], float(values[best])
        if rise < 1e-3:
            break
    return point, _limited_inverse(_derivatives(density, point)[1])


def _derivatives(density: Density, point: Array) -> tuple[Array, Array]:
    size = point.size
    steps = _STEP * np.eye(size)
    rows, columns = np.triu_indices(size if size <= _MOST_PAIRED else 0, 1)
    points = np.concatenate(
        [
            point[None],
            point + steps,
            point - steps,
            point + steps[rows] + steps[columns],
            point - steps[rows] - steps[columns],
        ]
    )
    values = density(points)
    centre, up, down = values[0], values[1 : size + 1], values[size + 1 : 2 * size + 1]
    both = values[2 * size + 1 :].reshape(2, -1)
    with np.errstate(invalid="ignore"):
        gradient = (up - down) / (2.0 * _STEP)
        hessian = np.diag((up + down - 2.0 * centre) / _STEP**2)
        # f(x+hi+hj) + f(x-hi-hj) - 2f = h²(Hii + Hjj + 2Hij)
        mixed = (both.sum(axis=0) - 2.0 * centre) / _STEP**2
        mixed = 0.5 * (mixed - hessian[rows, rows] - hessian[columns, columns])
    hessian[rows, columns] = mixed
    hessian[columns, rows] = mixed
    # At the edge of the impossible the differences are infinite and say nothing.
    gradient, hessian = (
        np.nan_to_num(part, posinf=0.0, neginf=0.0) for part in (gradient, hessian)
    )
    return gradient, hessian


def _limited_inverse(hessian: Array) -> Array:
    """Inverse of -H with its eigenvalues between 1e-6 and 4: priors have unit scale."""
    values, vectors = np.linalg.eigh(-hessian)
    return (vectors / np.clip(values, 0.25, 1e6)) @ vectors.T
