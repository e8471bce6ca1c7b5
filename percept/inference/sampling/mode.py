"""A mode of a log density and the curvature there, by vectorised finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
    gradient, hessian = (np.nan_to_num(part, posinf=0.0, neginf=0.0) for part in (gradient, hessian))
    return gradient, hessian


def _limited_inverse(hessian: Array) -> Array:
    """Inverse of -H with its eigenvalues between 1e-6 and 4: priors have unit scale."""
    values, vectors = np.linalg.eigh(-hessian)
    return (vectors / np.clip(values, 0.25, 1e6)) @ vectors.T
