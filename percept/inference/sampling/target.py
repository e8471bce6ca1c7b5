"""A log density to sample, the same density in other coordinates, and its mode.

The mode, and the covariance that the curvature there gives, are a first map for the sampler and no
more: nothing that is reported rests on its accuracy. Coordinates have unit scale under their prior,
and the posterior is mostly narrower.

d are the coordinates of the density, and N points share one call of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError

__all__ = ["Affine", "Density", "Target", "Transported", "describe_point", "find_mode"]

Array = NDArray[np.float64]
#: Ridge on a covariance, of its mean variance, that lets a thin sample be factored.
_RIDGE = 1e-10
#: Coordinates that a message names.
_MOST_NAMED = 4
#: A log density of points (N, d), shape (N,).
Density = Callable[[Array], Array]
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


class Target(Protocol):
    """A log density to sample."""

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), shape (W,); -inf allowed, NaN not."""


class CoordinateMap(Protocol):
    """A smooth map from standard coordinates to a target's."""

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""


def describe_point(names: list[str], point: Array) -> str:
    """Write out the four coordinates farthest from zero, in order."""
    by_size = np.argsort(-np.abs(point))
    extreme = sorted(by_size[:_MOST_NAMED].tolist())
    return ", ".join(f"{names[i]} = {point[i]:.6g}" for i in extreme)


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


class Transported:
    """A target in the coordinates of a map, whose values are never NaN."""

    def __init__(self, target: Target, transport: CoordinateMap) -> None:
        self._target = target
        self._transport = transport

    @property
    def names(self) -> list[str]:
        """Names of the target's coordinates."""
        return self._target.names

    def map(self, z: Array) -> Array:
        """Take points to the target's coordinates."""
        points, _ = self._transport(z)
        return points

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d) of the map's coordinates, shape (W,)."""
        mapped, log_jacobian = self._transport(points)
        values = self._target(mapped)
        invalid = np.isnan(values)
        if invalid.any():
            first = int(np.argmax(invalid))
            where = describe_point(self.names, mapped[first])
            raise RefusalError(f"the log density is NaN at {where}.")
        return values + log_jacobian


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
    first = _derivatives(density, point, paired=False)
    gradient = first.gradient
    precision = -first.hessian
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
        gradient = _derivatives(density, point, paired=False).gradient
        precision = _corrected(precision, move, before - gradient)
    paired = point.size <= _MOST_PAIRED
    at_mode = _derivatives(density, point, paired=paired)
    return point, _limited_inverse(-at_mode.hessian)


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


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Derivatives of a log density at a point."""

    gradient: Array  # (d,)
    hessian: Array  # (d, d) Diagonal where pairs of coordinates were not measured


def _derivatives(density: Density, point: Array, *, paired: bool) -> _Derivatives:
    """Gradient and Hessian by central differences, zero where these are infinite."""
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
    return _Derivatives(
        gradient=np.nan_to_num(gradient, posinf=0.0, neginf=0.0),
        hessian=np.nan_to_num(hessian, posinf=0.0, neginf=0.0),
    )


def _limited_inverse(precision: Array) -> Array:
    """Inverse of a precision (d, d), its eigenvalues limited to curvatures that are believed."""
    values, vectors = np.linalg.eigh(precision)
    limited = np.clip(values, _LEAST_CURVATURE, _MOST_CURVATURE)
    return (vectors / limited) @ vectors.T
