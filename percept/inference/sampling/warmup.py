"""Warm-up: from a density to a fitted transport and starting points.

Mode and curvature give the first map, importance weights refine it, and short runs give the samples
to which the transport is fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.sampling.coordinates import Affine, Target, Transported, describe_point
from percept.inference.sampling.moves import Ensembles, ReferenceLaw
from percept.inference.sampling.transport import Transport

__all__ = ["find_mode", "starting_points", "warm_up"]

Array = NDArray[np.float64]
Density = Callable[[Array], Array]

#: Times that importance weights refine the first map.
_ROUNDS = 3
#: Draws that are weighted, at least, and for each coordinate.
_FEWEST_DRAWS = 2048
_DRAWS_PER_COORDINATE = 40
#: Effective draws per coordinate, or share of all, below which weights are tempered.
_EFFECTIVE_PER_COORDINATE = 10.0
_EFFECTIVE_SHARE = 0.5
#: The same share for starting points, of which many should differ.
_STARTING_SHARE = 0.05
#: Factor between the powers that weights are tempered by, and the last power.
_TEMPERING = 0.8
_LEAST_POWER = 1e-6
#: Newton steps at most.
_STEPS = 30
#: Halvings of a Newton step that are tried.
_HALVINGS = 12
#: Rise of the log density by a step below which the mode is found.
_SMALL_RISE = 1e-3
#: Finite difference of a log density whose coordinates have unit scale.
_DIFFERENCE = 1e-2
#: Of more coordinates the curvature is taken along each alone: pairs would be too many.
_MOST_PAIRED = 128
#: Least and largest curvature that is believed: priors have unit scale.
_LEAST_CURVATURE = 0.25
_MOST_CURVATURE = 1e6
#: Share of the product of two lengths below which a scalar product of the vectors is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class _ShortRun:
    """A run that a transport is fitted to."""

    steps: int
    skipped: int  # Steps at its start that are left out
    stride: int  # Steps between kept positions


_RUNS = (
    _ShortRun(steps=48, skipped=16, stride=4),
    _ShortRun(steps=80, skipped=16, stride=2),
)


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
        Ensembles and walkers of each.
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
        A density that is -inf wherever it was tried, or NaN somewhere.
    """
    adapt_seed, *run_seeds = seed.spawn(1 + len(_RUNS))
    rng = np.random.default_rng(adapt_seed)
    size = len(target.names)
    mode, covariance = find_mode(target, np.zeros(size))
    transported = Transported(target, Affine.normal(mode, covariance))
    for _ in range(_ROUNDS):
        z, log_weights = _weigh(transported, rng, shape)
        # Tempered, or a few lucky draws would decide the covariance.
        wanted = min(_EFFECTIVE_SHARE * len(z), _EFFECTIVE_PER_COORDINATE * size)
        weights = _tempered(log_weights, wanted)
        affine = Affine.fit(transported.map(z), weights)
        transported = Transported(target, affine)
    points = starting_points(transported, rng, shape)
    for run, run_seed in zip(_RUNS, run_seeds, strict=True):
        walkers = Ensembles(transported, points, run_seed)
        walked = walkers.advance(run.steps, run.stride)
        kept = walked[:, run.skipped // run.stride :]
        transport = Transport.fit(transported.map(kept.reshape(-1, size)))
        transported = Transported(target, transport)
        points = starting_points(transported, rng, shape)
    return transported, points


def starting_points(
    transported: Transported,
    rng: np.random.Generator,
    shape: tuple[int, int],
) -> Array:
    """Choose starting points (E, W, d) among draws from the reference law, by tempered weights."""
    z, log_weights = _weigh(transported, rng, shape)
    weights = _tempered(log_weights, _STARTING_SHARE * len(z))
    count = shape[0] * shape[1]
    chosen = rng.choice(len(z), size=count, p=weights)
    return z[chosen].reshape(*shape, -1)


def _weigh(
    transported: Transported,
    rng: np.random.Generator,
    shape: tuple[int, int],
) -> tuple[Array, Array]:
    """Draws from the reference law, and the log of the density over that law."""
    size = len(transported.names)
    law = ReferenceLaw(size)
    walkers = shape[0] * shape[1]
    count = max(_FEWEST_DRAWS, _DRAWS_PER_COORDINATE * size, 2 * walkers)
    z = law.draw(count, rng)
    values = transported(z)
    if np.all(np.isneginf(values)):
        raise RefusalError(
            "the log density is -inf at every point tried, for example at"
            f" {describe_point(transported.names, transported.map(z[:1])[0])}.",
            hint="Check the data and the priors of these parameters.",
        )
    return z, values - law.log_density(z)


def _tempered(log_weights: Array, effective: float) -> Array:
    """Normalised weights, raised to the largest power in (0, 1] that leaves the effective size."""
    shifted = log_weights - np.max(log_weights)
    power = 1.0
    while True:
        weights = np.exp(power * shifted)
        weights /= weights.sum()
        size = 1.0 / float(weights @ weights)
        if size >= effective or power < _LEAST_POWER:
            return weights
        power *= _TEMPERING


def find_mode(density: Density, start: Array) -> tuple[Array, Array]:
    """Climb to a mode (d,) and measure the covariance (d, d) that the curvature there gives.

    Newton steps with gradients by central differences, each halved until the density rises. The
    curvature begins as that along each coordinate alone. Every step then corrects it by how the
    gradient changed (Broyden, Fletcher, Goldfarb and Shanno, 1970). It is measured in full at the
    mode alone: pairs of coordinates take most density values.
    """
    point = start
    value = float(density(point[None])[0])
    lengths = 0.5 ** np.arange(_HALVINGS)
    gradient, hessian = _derivatives(density, point, paired=False)
    precision = -hessian
    for _ in range(_STEPS):
        step = _limited_inverse(precision) @ gradient
        trials = point + lengths[:, None] * step
        values = density(trials)
        best = int(np.argmax(values))
        if not values[best] > value:
            break
        rise = values[best] - value
        moved = trials[best] - point
        point = trials[best]
        value = float(values[best])
        if rise < _SMALL_RISE:
            break
        before = gradient
        gradient, _ = _derivatives(density, point, paired=False)
        precision = _corrected(precision, moved, before - gradient)
    _, hessian = _derivatives(density, point, paired=point.size <= _MOST_PAIRED)
    return point, _limited_inverse(-hessian)


def _corrected(precision: Array, moved: Array, fall: Array) -> Array:
    """Change a precision as little as makes it explain the fall of the gradient over a move."""
    length = float(np.linalg.norm(moved))
    along = float(fall @ moved)
    if along <= _ROUNDING * length * float(np.linalg.norm(fall)):
        # The density is not concave here, and a precision cannot be negative.
        return precision
    expected = precision @ moved
    expected_along = float(expected @ moved)
    # A precision that expected no fall along the move holds nothing to take away.
    if abs(expected_along) > _ROUNDING * length * float(np.linalg.norm(expected)):
        precision = precision - np.outer(expected, expected) / expected_along
    return precision + np.outer(fall, fall) / along


def _derivatives(density: Density, point: Array, *, paired: bool) -> tuple[Array, Array]:
    """Gradient and Hessian by central differences, zero where these are infinite.

    Without pairs of coordinates the Hessian is diagonal.
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
    # At the edge of the impossible the differences are infinite and say nothing.
    gradient = np.nan_to_num(gradient, posinf=0.0, neginf=0.0)
    return gradient, np.nan_to_num(hessian, posinf=0.0, neginf=0.0)


def _limited_inverse(precision: Array) -> Array:
    """Inverse of a precision with its eigenvalues limited."""
    values, vectors = np.linalg.eigh(precision)
    limited = np.clip(values, _LEAST_CURVATURE, _MOST_CURVATURE)
    return (vectors / limited) @ vectors.T
