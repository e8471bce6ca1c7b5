"""Warm-up: from a density to a fitted transport and starting points.

A transport is a map from standard coordinates z, in which the target resembles the reference law of
`moves`, to the target's coordinates. The warm-up begins with no draws of the target and fits ever
better maps, each to better draws than the one before. `warm_up` takes these steps:

1. The mode of the density and its curvature there give a linear map (`find_mode`).
2. Draws from the reference law are mapped. Their weights are the target's density over the law's
   (`_weigh`). Their weighted mean and covariance give the next linear map, `_ROUNDS` times.
3. Starting points are chosen among such draws by their weights (`starting_points`).
4. Walkers run from there for some steps, and a bent map is fitted to what they visit
   (`transport`). Steps 3 and 4 are done once for each of `_RUNS`, and step 3 once more.

Weights of a poor map leave few effective draws, 1 / (sum of squared weights). So weights are raised
to a power below one until enough draws count (`_tempered`).

Early samples are poor, and later ones mend them. So fits depend little on the numbers below: where
a comment says so, density values of fits of the published study differ by no more than between two
seeds. E are the ensembles of a run, W the walkers of each, d the coordinates, and N the points that
are weighted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.sampling.moves import Ensembles, ReferenceLaw
from percept.inference.sampling.target import Affine, Target, Transported, describe_point, find_mode
from percept.inference.sampling.transport import Transport

__all__ = ["starting_points", "warm_up"]

Array = NDArray[np.float64]

#: Times that weighted draws refine the linear map. From 1 to 6 a fit takes times that differ no
#: more than twofold, without order. Several guard against a curvature that tells little of the
#: bulk.
_ROUNDS = 3
#: Draws that are weighted for each coordinate. The variances of so many draws from a normal law are
#: right to a third in every direction (Marchenko and Pastur 1967). Four times as many do not help.
_DRAWS_PER_COORDINATE = 40
#: Draws that are weighted, at least: 51 or fewer coordinates have this many. One call of a density
#: hardly takes longer for them than for fewer.
_FEWEST_DRAWS = 2048
#: Draws that are weighted for each starting point, so that few are chosen twice.
_DRAWS_PER_WALKER = 2
#: Effective draws for each coordinate that weights must leave a linear map, if need be by
#: tempering. Variances are then right to a factor of two; 3 and 20 take no longer.
_EFFECTIVE_PER_COORDINATE = 10.0
#: Share of the draws that must be effective for starting points: a hundred different ones at least.
#: A larger share tempers more, and starts walkers farther from the target. Of 2,048 draws, the
#: fewest, this share is 102. Burn-in then parts the walkers that start at the same point.
_STARTING_SHARE = 0.05
#: Factor between the powers by which weights are tempered. The power found is within this factor of
#: the largest that would do.
_TEMPERING = 0.8
#: Power below which tempering ends. Weights are then equal unless log densities differ by millions.
_LEAST_POWER = 1e-6
#: Steps of the runs that a transport is fitted to. The map of the first is rough, so the second has
#: more draws. Without the second run a fit of the published study takes twice as many density
#: values; runs of twice the steps gain nothing.
_RUNS = (48, 80)
#: Steps at their start that are left out: walkers start from tempered weights.
_SKIPPED = 16
#: Steps between kept positions; neighbours are too much alike to count twice.
_STRIDE = 2


def _tempered(log_weight: Array, effective: float) -> Array:
    """Weights (N,) that sum to one, with at least so many effective draws.

    Untempered, a few lucky draws could decide all. So weights are raised to the largest power in
    (0, 1] that leaves the effective draws.
    """
    shifted = log_weight - np.max(log_weight)
    power = 1.0
    while True:
        weights = np.exp(power * shifted)
        weights /= weights.sum()
        found = 1.0 / float(weights @ weights)
        if found >= effective or power < _LEAST_POWER:
            return weights
        power *= _TEMPERING


def warm_up(
    target: Target,
    shape: tuple[int, int],
    seed: np.random.SeedSequence,
) -> tuple[Transported, Array]:
    """Fit a transport to a density and find starting points.

    Parameters
    ----------
    target : Target
        Log density whose coordinates have unit scale under the prior.
    shape : tuple of int
        Ensembles E, and walkers W of each.
    seed : SeedSequence
        Of the whole warm-up.

    Returns
    -------
    transported : Transported
        The target in the transport's coordinates.
    points : ndarray
        Starting points in these, shape (E, W, d).

    Raises
    ------
    RefusalError
        A density that is -inf at all points tried but one or none, or NaN somewhere.
    """
    adapt_seed, *run_seeds = seed.spawn(1 + len(_RUNS))
    rng = np.random.default_rng(adapt_seed)
    transported = _linear(target, rng, shape)
    points = starting_points(transported, rng, shape)
    for steps, run_seed in zip(_RUNS, run_seeds, strict=True):
        walkers = Ensembles(transported, points, run_seed)
        walked = walkers.advance(steps, _STRIDE)
        kept = walked[:, _SKIPPED // _STRIDE :]
        flat = kept.reshape(-1, kept.shape[-1])
        transport = Transport.fit(transported.map(flat))
        transported = Transported(target, transport)
        points = starting_points(transported, rng, shape)
    return transported, points


def _linear(target: Target, rng: np.random.Generator, shape: tuple[int, int]) -> Transported:
    """Map a target linearly: steps 1 and 2."""
    size = len(target.names)
    mode, covariance = find_mode(target, np.zeros(size))
    transported = Transported(target, Affine.normal(mode, covariance))
    for _ in range(_ROUNDS):
        z, log_weight = _weigh(transported, rng, shape)
        weights = _tempered(log_weight, _EFFECTIVE_PER_COORDINATE * size)
        transported = Transported(target, Affine.fit(transported.map(z), weights))
    return transported


def starting_points(
    transported: Transported,
    rng: np.random.Generator,
    shape: tuple[int, int],
) -> Array:
    """Choose starting points (E, W, d) among draws from the reference law, by tempered weights.

    Parameters
    ----------
    transported : Transported
        The target in the transport's coordinates.
    rng : numpy.random.Generator
        Source of the draws and of the choice.
    shape : tuple of int
        Ensembles E, and walkers W of each.

    Returns
    -------
    ndarray
        In the transport's coordinates.

    Raises
    ------
    RefusalError
        A density that is -inf at all draws but one or none, or NaN somewhere.
    """
    z, log_weight = _weigh(transported, rng, shape)
    weights = _tempered(log_weight, _STARTING_SHARE * len(z))
    ensembles, walkers = shape
    chosen = rng.choice(len(z), size=ensembles * walkers, p=weights)
    return z[chosen].reshape(*shape, -1)


def _weigh(
    transported: Transported,
    rng: np.random.Generator,
    shape: tuple[int, int],
) -> tuple[Array, Array]:
    """Draws (N, d) from the reference law, and the logs (N,) of the density over that law."""
    size = len(transported.names)
    law = ReferenceLaw(size)
    ensembles, walkers = shape
    count = max(
        _FEWEST_DRAWS,
        _DRAWS_PER_COORDINATE * size,
        _DRAWS_PER_WALKER * ensembles * walkers,
    )
    z = law.draw(count, rng)
    values = transported(z)
    impossible = np.isneginf(values)
    possible = count - int(impossible.sum())
    # A single draw spans no covariance, whose factor a linear map is.
    if possible < 2:
        point = transported.map(z[[np.argmax(impossible)]])[0]
        points = "all points tried but one" if possible else "every point tried"
        raise RefusalError(
            f"the log density is -inf at {points}, for example at"
            f" {describe_point(transported.names, point)}.",
            hint="Check the data and the priors of these parameters.",
        )
    return z, values - law.log_density(z)
