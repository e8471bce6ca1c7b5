"""Warm-up: from a density to a fitted transport and starting points.

A transport is a map from standard coordinates z, in which the target resembles the reference law of
`moves`, to the target's coordinates. The warm-up begins with no draws of the target and fits ever
better maps, each to better draws than the one before. `warm_up` takes these steps:

1. The mode of the density and its curvature there give a linear map (`find_mode`), a first one:
   coordinates have unit scale under their prior, and the posterior is mostly narrower.
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

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.sampling.moves import (
    Density,
    Ensembles,
    ReferenceLaw,
    Target,
    Transported,
    describe_point,
)
from percept.inference.sampling.transport import Transport

Array = NDArray[np.float64]

#: Times that weighted draws refine the linear map. From 1 to 6 a fit takes times that differ no
#: more than twofold, without order. Several guard against a curvature that does not
#: describe the bulk.
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
#: Steps between kept positions; neighbours differ too little to count twice.
_STRIDE = 2
#: Ridge on a covariance, of its mean variance, that lets a thin sample be factored.
_RIDGE = 1e-10
#: Newton steps at most. Studies of 14 to 34 coordinates take 7 to 11; more would hint at a ridge,
#: of which the sampler finds the rest.
_MOST_STEPS = 30
#: Lengths that are tried of a Newton step, each half the one before: down to 1/2048 of it. All are
#: tried in one call of the density.
_LENGTHS = 12
#: Rise of the log density by a step below which the mode is found. The log density of draws lies
#: about d/2 below its mode, so that a thousandth moves no draw.
_SMALL_RISE = 1e-3
#: Step of finite differences, where coordinates have unit scale. A larger one sees the third and
#: fourth derivatives: their error grows with its square. A smaller one sees rounding, which grows
#: with the inverse square: here to about 1e-9 of curvature for log densities of a thousand.
_DIFFERENCE = 1e-2
#: Most coordinates whose curvature is measured in pairs. That takes d (d - 1) density values,
#: 16,000 for 128. With more coordinates the curvature is taken along each alone.
_MOST_PAIRED = 128
#: Least curvature that is believed: an SD of two. Priors have unit SD, and a posterior is rarely
#: wider. An SD larger than two is therefore found as two.
_LEAST_CURVATURE = 0.25
#: Largest curvature that is believed: an SD of a thousandth. A larger one would be the edge of an
#: impossible region.
_MOST_CURVATURE = 1e6
#: Share of the product of two lengths below which a scalar product of the vectors is rounding: some
#: thousand times the rounding of one number.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Affine:
    """Linear map from standard coordinates."""

    centre: Array  # (d,) Where zero goes
    factor: Array  # (d, d) Lower factor of the covariance

    @classmethod
    def normal(cls, centre: Array, covariance: Array) -> Self:
        """Map standard coordinates to a given centre (d,) and covariance (d, d)."""
        size = len(covariance)
        ridge = _RIDGE * np.trace(covariance) / size * np.eye(size)
        return cls(centre, np.linalg.cholesky(covariance + ridge))

    @classmethod
    def fit(cls, points: Array, weights: Array) -> Self:
        """Fit to points (N, d) with weights (N,) that sum to one."""
        centre = weights @ points
        deviation = points - centre
        weighted = weights[:, None] * deviation
        return cls.normal(centre, weighted.T @ deviation)

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""
        log_determinant = np.log(np.diag(self.factor)).sum()
        points = self.centre + z @ self.factor.T
        return points, np.full(len(z), log_determinant)


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
    size = len(transported.target.names)
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
        raise RefusalError(
            f"the log density is -inf at {count - possible} of {count} points, for example at"
            f" {describe_point(transported.target.names, point)}.",
            hint="Check the data and the priors of these parameters.",
        )
    return z, values - law.log_density(z)


def find_mode(density: Density, start: Array) -> tuple[Array, Array]:
    """Climb to a mode, and measure the covariance that the curvature there gives.

    Newton steps with gradients by central differences, each shortened to the length that raises the
    density most. The curvature begins as that along each coordinate alone. Every step then corrects
    it by how the gradient changed (Broyden, Fletcher, Goldfarb and Shanno, 1970). It is measured in
    full at the mode alone: pairs of coordinates take most density values.

    Parameters
    ----------
    density : callable
        Log density of points (N, d), shape (N,); -inf allowed. Coordinates have unit scale.
    start : ndarray
        Where to start, shape (d,).

    Returns
    -------
    mode : ndarray
        Shape (d,).
    covariance : ndarray
        Shape (d, d), with SDs from 0.001 to 2 along its axes.
    """
    point = start
    at_start = density(point[None])
    value = float(at_start[0])
    lengths = 0.5 ** np.arange(_LENGTHS)
    gradient, hessian = _derivatives(density, point, paired=False)
    precision = -hessian
    for _ in range(_MOST_STEPS):
        step = _limited_inverse(precision) @ gradient
        trials = point + lengths[:, None] * step
        values = density(trials)
        best = int(np.argmax(values))
        if not values[best] > value:
            break
        rise = values[best] - value
        move = trials[best] - point
        point = trials[best]
        value = float(values[best])
        if rise < _SMALL_RISE:
            break
        before = gradient
        gradient, _ = _derivatives(density, point, paired=False)
        precision = _corrected(precision, move, before - gradient)
    _, hessian = _derivatives(density, point, paired=point.size <= _MOST_PAIRED)
    return point, _limited_inverse(-hessian)


def _corrected(precision: Array, move: Array, fall: Array) -> Array:
    """Change a precision (d, d) as little as makes it explain the fall of the gradient on a move.

    Gradients are of the log density, so that its precision times the move is the fall (d,).
    """
    length = float(np.linalg.norm(move))
    along = float(fall @ move)
    if along <= _ROUNDING * length * float(np.linalg.norm(fall)):
        # The density is not concave here, and a precision cannot be negative.
        return precision
    expected = precision @ move
    expected_along = float(expected @ move)
    # A precision that expected no fall along the move holds nothing to take away.
    if abs(expected_along) > _ROUNDING * length * float(np.linalg.norm(expected)):
        precision = precision - np.outer(expected, expected) / expected_along
    return precision + np.outer(fall, fall) / along


def _derivatives(density: Density, point: Array, *, paired: bool) -> tuple[Array, Array]:
    """Gradient (d,) and Hessian (d, d) by central differences, zero where these are infinite.

    The Hessian is diagonal where pairs of coordinates are not measured.
    """
    size = point.size
    steps = _DIFFERENCE * np.eye(size)
    rows, columns = np.triu_indices(size if paired else 0, 1)
    pairs = steps[rows] + steps[columns]
    around = (
        point[None],
        point + steps,
        point - steps,
        point + pairs,
        point - pairs,
    )
    values = density(np.concatenate(around))
    centre = values[0]
    ends = np.cumsum([1, size, size, len(pairs)])
    _, up, down, both_up, both_down = np.split(values, ends)
    with np.errstate(invalid="ignore"):
        gradient = (up - down) / (2.0 * _DIFFERENCE)
        curvature = (up + down - 2.0 * centre) / _DIFFERENCE**2
        # f(x+hi+hj) + f(x-hi-hj) - 2f = h²(Hii + Hjj + 2Hij)
        mixed = (both_up + both_down - 2.0 * centre) / _DIFFERENCE**2
        mixed = 0.5 * (mixed - curvature[rows] - curvature[columns])
    hessian = np.diag(curvature)
    hessian[rows, columns] = mixed
    hessian[columns, rows] = mixed
    # Next to impossible points the differences are infinite, and are left out.
    gradient = np.nan_to_num(gradient, posinf=0.0, neginf=0.0)
    return gradient, np.nan_to_num(hessian, posinf=0.0, neginf=0.0)


def _limited_inverse(precision: Array) -> Array:
    """Inverse of a precision (d, d), its eigenvalues limited to curvatures that are believed."""
    values, vectors = np.linalg.eigh(precision)
    limited = np.clip(values, _LEAST_CURVATURE, _MOST_CURVATURE)
    return (vectors / limited) @ vectors.T
