"""Limits of a function of a target's coordinates whose conditional law has no known form.

A draw's conditional law along a line through it comes from the target's density at a few points of
that line. The posterior of the function is the equal-weight mixture of these laws over all draws.
The line runs along the covariance of coordinates and function, where the function varies most. What
is left for chance is small, so that some hundred draws tell more than many thousand would by their
own values.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from percept.inference.sampling.endpoints import batch_errors
from percept.inference.sampling.gate import Run
from percept.inference.sampling.moves import Target

__all__ = ["LineLimits", "line_limits"]

Array = NDArray[np.float64]

#: Points of a line where the density is computed, in SDs along it: a normal law has 2e-6 beyond.
_NODES = np.linspace(-4.8, 4.8, 9)
#: Points that its logarithm is interpolated at, 24 to a step of these, for the law between them.
_FINE = np.linspace(-4.8, 4.8, 193)
#: Multiples of the golden ratio fill an interval evenly.
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
#: Draws whose lines are taken first; their number doubles until the tolerance is met, or to the
#: most: more lines than this take longer than the sampling did.
_FIRST_LINES = 256
_MOST_LINES = 8192


@dataclasses.dataclass(frozen=True)
class LineLimits:
    """Limits of one function, and its median."""

    lower: float
    upper: float
    median: float
    error: float  # Larger Monte Carlo standard error of both limits, in half-widths


def line_limits(
    target: Target, run: Run, function: Callable[[Array], Array], level: float
) -> LineLimits:
    """Limits that leave out equal tails, to the run's tolerance if its draws suffice.

    Parameters
    ----------
    target : Target
        Log density of points (W, d).
    run : Run
        Finished sampling of the target.
    function : callable
        Takes points (W, d) to values (W,).
    level : float
        Probability between the limits.

    Returns
    -------
    LineLimits
    """
    points = run.points.reshape(-1, run.points.shape[-1])
    batch = run.batches(every=True)
    # Every batch has its share of the first lines.
    order = np.random.default_rng(run.settings.seed).permutation(len(points))
    points = points[order]
    batch = batch[order]
    direction, along = _steepest(points, function(points))
    most = min(_MOST_LINES, len(points))
    tails = np.array([0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    start = 0
    stop = min(_FIRST_LINES, most)
    parts = []
    while True:
        some = slice(start, stop)
        parts.append(_laws(target, function, direction, points[some], along[some]))
        values = np.concatenate([part[0] for part in parts])
        weights = np.concatenate([part[1] for part in parts])
        limits = _limits(values, weights, batch[:stop], tails)
        if limits.error <= run.settings.tolerance or stop == most:
            return limits
        start = stop
        stop = min(2 * stop, most)


def _steepest(points: Array, values: Array) -> tuple[Array, Array]:
    """Direction (d,) in which a function varies most, an SD long, and draws' places on it (S,)."""
    centred = points - points.mean(axis=0)
    slopes, *_ = np.linalg.lstsq(centred, values - values.mean(), rcond=None)
    fitted = centred @ slopes
    size = fitted.std()
    return centred.T @ fitted / (len(points) * size), fitted / size


def _laws(
    target: Target,
    function: Callable[[Array], Array],
    direction: Array,
    points: Array,
    along: Array,
) -> tuple[Array, Array]:
    """Values (S, fine points) of the function on the lines of draws, and their probabilities."""
    steps = _NODES - along[:, None]
    nodes = points[:, None] + steps[..., None] * direction
    flat = nodes.reshape(-1, points.shape[1])
    log_density = target(flat).reshape(steps.shape)
    values = function(flat).reshape(steps.shape)
    # A density of zero has no logarithm to interpolate: e^-1000 of the highest stands for it.
    highest = log_density.max(axis=1, keepdims=True)
    log_density = np.maximum(log_density - highest, -1e3)
    fine = CubicSpline(_NODES, log_density, axis=1)(_FINE)
    weights = np.exp(fine - fine.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    fine_values = CubicSpline(_NODES, values, axis=1)(_FINE)
    # Lines of a straight function have the same values: spread evenly over the steps between these,
    # each line's own part of a step apart.
    shift = (np.arange(len(points)) * _GOLDEN) % 1.0 - 0.5
    return fine_values + shift[:, None] * np.gradient(fine_values, axis=1), weights


def _limits(values: Array, weights: Array, batch: NDArray[np.intp], tails: Array) -> LineLimits:
    """Quantiles of the mixture of laws, and the errors that batches of draws show."""
    order = np.argsort(values, axis=None)
    ordered = values.ravel()[order]
    cumulative = np.cumsum(weights.ravel()[order]) / len(values)
    lower, median, upper = np.interp([tails[0], 0.5, tails[1]], cumulative, ordered)
    half_width = 0.5 * (upper - lower)
    errors = []
    for limit, below in zip((lower, upper), tails, strict=True):
        tail = min(below, 1.0 - below)
        # The density at the limit from quantiles half and one and a half tails out.
        ends = np.interp([below - 0.5 * tail, below + 0.5 * tail], cumulative, ordered)
        density = tail / (ends[1] - ends[0])
        beyond = (weights * (values <= limit)).sum(axis=1)
        (spread,) = batch_errors(beyond[:, None], batch)
        errors.append(spread / density / half_width)
    return LineLimits(float(lower), float(upper), float(median), float(max(errors)))
