"""Limits of abs(Z_h) from the joint law of k and b, at single frequencies and for whole curves.

A score s stands for the level 2 Phi(s) - 1. The limits at a score are the radii r of two balls:

    P(abs(Z_h) <= r) = Phi(-s)  for the lower one,  Phi(s) for the upper one

Both sides are compared as normal scores, and r is searched for by its logarithm: one is nearly a
straight line over the other. `ball` gives the probability and its slope in log r.

Points that stand for the law give the rest, each with its curve of log abs(Z_h). A curve's farthest
score is the largest that it has at any frequency: limits hold whole curves with the probability of
all points whose farthest score is smaller. Points on devices of a posterior, each on another one,
average over devices: the limits of the law move by as much as the limits of these points.

The Monte Carlo error of a limit is that of the posterior draws behind the law. Batch i of the draws
puts dP_i more into the ball, which moves the limit by dP_i / phi(s) scores; the slope of the limit
over its score turns this into an error of log r.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.ball import Balls
from percept.boundary.law import BEYOND, PairLaw, Points
from percept.boundary.shares import score_of
from percept.errors import RefusalError
from percept.haptics.loop import Loop
from percept.haptics.perceived import perceived_magnitude
from percept.haptics.records import AnyDevice, Device
from percept.searches import rising_root

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Probabilities this near 0 or 1 have a finite normal score.
_LEAST_PROBABILITY = 1e-14
# Points of a law that is not drawn: they start the searches for its limits.
_FEW_POINTS = 600
# Points of a law of draws. The score that holds whole curves is known to 0.01 by them, a three
# hundredth of a band's half-width.
_POINTS = 4096
# The same where the SD of log k is above one: the device's mass cancels another k at each omega.
_MANY_POINTS = 16_384
# Runs of these points, whose scatter gives the error that devices add.
_RUNS = 8
# Score at which the order of integrals is chosen, that of the usual 99 % limits.
_USUAL_SCORE = 2.6
# SDs of a normal below which a limit's score counts as met: far less than a Monte Carlo error.
_SCORE_ACCURACY = 1e-6
# SDs of a normal to either side, over which slopes are taken from points.
_NEAR = 0.2
# Smallest probability beyond a limit: the grid of a law leaves out a fifth of this.
_LEAST_TAIL = 1e-5
# The least magnitude with a logarithm, N·s/m.
_TINY = np.finfo(np.float64).tiny
_SQRT_2PI = np.sqrt(2.0 * np.pi)


def _density(score: Array | float) -> Array:
    """Return the density of a standard normal."""
    log_ratio = -0.5 * np.square(score)
    return np.asarray(np.exp(log_ratio) / _SQRT_2PI)


@dataclass(frozen=True, eq=False)
class MagnitudeLimits:
    """Limits of abs(Z_h) at M frequencies."""

    lower: Array  # (M,) N·s/m
    upper: Array  # (M,) N·s/m
    errors: Array | None = None  # (2, M) Monte Carlo errors of their logarithms; None if not drawn
    device_share: float | None = None  # Of the squared log width; None with the device at a point

    def joined(self, inner: MagnitudeLimits) -> MagnitudeLimits:
        """Return limits that contain others too."""
        lower = np.minimum(self.lower, inner.lower)
        upper = np.maximum(self.upper, inner.upper)
        return replace(self, lower=lower, upper=upper)


class _Curves:
    """P curves of log abs(Z_h) with their probabilities, in order at each of M frequencies."""

    def __init__(self, logs: Array, probability: Array) -> None:
        weights = probability / probability.sum()
        #: (M, P) probability below each curve.
        self.below = np.empty_like(logs)
        self._in_order = []
        # What belongs to one frequency stays in the processor's cache.
        for row, here in enumerate(logs):
            order = here.argsort()
            ordered = weights[order]
            below = ordered.cumsum() - 0.5 * ordered
            self.below[row, order] = below
            self._in_order.append((below, here[order]))

    def limits(self, score: float) -> Array:
        """Return the log limits (2, M) at a score."""
        ends = special.ndtr([-score, score])
        of_each = [np.interp(ends, below, logs) for below, logs in self._in_order]
        return np.array(of_each).T


class Magnitude:
    """Law of abs(Z_h) at frequencies, from a law of (k, b).

    Parameters
    ----------
    law : PairLaw
        Law of stiffness and damping.
    loop : Loop
        With the device that the user holds.
    omega : ndarray, shape (M,)
        Frequencies, rad/s.
    mass : float, optional
        Mass of the environment, kg.
    devices : Device, optional
        N devices of its posterior, stacked, over which limits are averaged.
    """

    def __init__(
        self,
        law: PairLaw,
        loop: Loop,
        omega: Array,
        *,
        mass: float = 0.0,
        devices: Device | None = None,
    ) -> None:
        self.law = law
        self.balls = Balls(law, loop, omega, mass=mass)
        self._loop = loop
        self._omega = omega[self.balls.finite]
        self._mass = mass
        self._devices = devices

    def limits(self, score: float, shifts: Array | None = None) -> MagnitudeLimits:
        """Return equal-tailed limits.

        Parameters
        ----------
        score : float
            Of the probability between them at each frequency.
        shifts : ndarray, shape (B,), optional
            By how many SDs each batch of draws moves the score itself: part of the errors.

        Raises
        ------
        RefusalError
            The law does not determine limits so far out.
        """
        self._check_score(score)
        at_point = self._solved(score)
        averaged = at_point
        device_share = None
        if self._devices is not None:
            averaged = at_point + self._device_shift(score, self._every_point)
            device_share = self._device_share(at_point, averaged)
        finite = self.balls.finite
        limits = np.full((2, finite.size), np.inf)
        limits[:, finite] = np.exp(averaged)
        if not self.law.batch_count:
            return MagnitudeLimits(limits[0], limits[1])
        moves = self._batch_shifts(score)
        if shifts is not None:
            moves = shifts + moves
        width = self._curves.limits(score + _NEAR) - self._curves.limits(score - _NEAR)
        error = np.abs(width) / (2.0 * _NEAR) * self.law.standard_error(moves)
        if self._devices is not None:
            # Points and devices are even in every run.
            runs = self._every_point.reshape(_RUNS, -1)
            by_run = [self._device_shift(score, run) for run in runs]
            scatter = np.std(by_run, axis=0, ddof=1)
            error = np.hypot(error, scatter / np.sqrt(_RUNS))
        errors = np.zeros(limits.shape)
        errors[:, finite] = error
        return MagnitudeLimits(limits[0], limits[1], errors, device_share)

    def simultaneous_score(self, level: float) -> tuple[float, Array]:
        """Return the score whose limits hold whole curves with a probability, `level`.

        And by how much each batch of draws would raise it, (B,).
        """
        points = self._points
        below = self._curves.below
        beyond = np.minimum(below, 1.0 - below)
        frequency = beyond.argmin(axis=0)
        least = np.maximum(beyond.min(axis=0), _LEAST_PROBABILITY)
        farthest = -special.ndtri(least)
        upper = np.take_along_axis(below, frequency[None], axis=0)[0] > 0.5
        order = farthest.argsort()
        held = np.cumsum(points.probability[order])
        # Whole curves leave at least as often as they leave at one frequency.
        of_curves = float(np.interp(level, held, farthest[order]))
        score = max(score_of(level), of_curves)
        near = (farthest > score - _NEAR) & (farthest <= score + _NEAR)
        per_score = points.probability[near].sum() / (2.0 * _NEAR)
        leaving = points.probability[farthest > score].sum()
        # A batch has its own limits at a score, and its own probabilities.
        moved = score + self._batch_shifts(score)[upper.astype(np.intp), frequency]
        leaves = farthest[:, None] > moved
        of_batch = np.sum(points.by_batch * leaves, axis=0)
        return score, (of_batch - leaving) / per_score

    def _check_score(self, score: float) -> None:
        """Refuse limits farther out than the law determines them, and say why."""
        infinite = self.law.infinite
        farthest = -float(special.ndtri(max(_LEAST_TAIL, infinite)))
        if score <= farthest:
            return
        if infinite > _LEAST_TAIL:
            raise RefusalError(f"a limit may lie beyond {BEYOND:.0e} N·s/m.")
        highest = 1.0 - 2.0 * special.ndtr(-farthest)
        raise RefusalError(f"the law determines limits up to the level {highest:g} only.")

    def _solved(self, score: float) -> Array:
        """Solve for the log limits (2, M) at a score with the device at its point."""
        target = np.repeat([-score, score], self.balls.count)

        def misfit(which: Indices, logs: Array) -> tuple[Array, Array]:
            """Return by how many SDs limits miss their score, and how fast that changes."""
            radius = np.exp(logs)
            content = self.balls.content(self._frequency[which], radius, self._inner[which])
            most = 1.0 - _LEAST_PROBABILITY
            scores = special.ndtri(np.clip(content.probability, _LEAST_PROBABILITY, most))
            missing = scores - target[which]
            missing[np.abs(missing) < _SCORE_ACCURACY] = 0.0
            return missing, content.slope / _density(scores)

        low, high = (np.tile(end, 2) for end in self.balls.log_range())
        start = np.clip(self._at_point.limits(score).ravel(), low, high)
        return rising_root(misfit, start, low, high).reshape(2, -1)

    @functools.cached_property
    def _frequency(self) -> Indices:
        """Frequency of each limit: of all lower ones, then of all upper ones, (2 M,)."""
        return np.tile(np.arange(self.balls.count), 2)

    @functools.cached_property
    def _inner(self) -> Indices:
        """Which of k and b is the inner variable in the ball of each limit, (2 M,)."""
        radius = np.exp(self._at_point.limits(_USUAL_SCORE).ravel())
        return self.balls.smoother_inner(self._frequency, radius)

    @functools.cached_property
    def _points(self) -> Points:
        """Points that stand for the law."""
        if not self.law.batch_count:
            return self.law.even(_FEW_POINTS)
        k_axis, _ = self.law.axes
        wide = k_axis.log and k_axis.unit > 1.0
        return self.law.even(_MANY_POINTS if wide else _POINTS)

    @functools.cached_property
    def _at_point(self) -> _Curves:
        """Curves of all points with the device at its point."""
        return self._curves_of(self._every_point, self._loop.device)

    @functools.cached_property
    def _curves(self) -> _Curves:
        """Curves of all points, each on another device of the posterior where there is one."""
        if self._devices is None:
            return self._at_point
        return self._curves_of(self._every_point, self._on_devices(self._every_point))

    @property
    def _every_point(self) -> Indices:
        return np.arange(self._points.k.size)

    def _on_devices(self, which: Indices) -> Device:
        """Return the device of the posterior that each point is put on."""
        assert self._devices is not None
        return self._devices.select(which % np.size(self._devices.mass))

    def _curves_of(self, which: Indices, device: AnyDevice) -> _Curves:
        """Return curves of some points with a device, or with as many devices."""
        points = self._points
        magnitude = perceived_magnitude(
            replace(self._loop, device=device),
            self._omega[:, None],
            points.k[which],
            points.b[which],
            mass=self._mass,
        )
        return _Curves(np.log(np.maximum(magnitude, _TINY)), points.probability[which])

    def _device_shift(self, score: float, which: Indices) -> Array:
        """Return by how much devices of the posterior move the log limits (2, M) of points."""
        on_devices = self._curves_of(which, self._on_devices(which))
        at_point = self._curves_of(which, self._loop.device)
        return on_devices.limits(score) - at_point.limits(score)

    def _device_share(self, at_point: Array, averaged: Array) -> float:
        """Return the share of the squared log width that the device makes, over log omega."""
        before = at_point[1] - at_point[0]
        after = averaged[1] - averaged[0]
        wide = after > 0.0
        share = 1.0 - (before[wide] / after[wide]) ** 2
        lengths = np.ones(share.size)
        if share.size > 1:
            lengths = np.gradient(np.log(self._omega[wide]))
        return float(np.clip(np.average(share, weights=lengths), 0.0, 1.0))

    def _batch_shifts(self, score: float) -> Array:
        """Return by how many SDs each batch of draws moves limits out, (2, M, B)."""
        points = self._points
        change = points.by_batch - points.probability[:, None]
        below = self._curves.below
        # A batch that holds more moves the lower limit down and so out, the upper one in.
        below_lower = below < special.ndtr(-score)
        above_upper = below > special.ndtr(score)
        more = [below_lower @ change, above_upper @ change]
        return np.array(more) / _density(score)


def relative_error(omega: Array, limits: MagnitudeLimits) -> float | None:
    """Return the typical error of limits over log omega, in half-widths of the band in logarithms.

    None without errors, and where no band has width.
    """
    wide = np.isfinite(limits.upper)
    wide &= limits.upper > limits.lower
    if limits.errors is None or not wide.any():
        return None
    ratio = limits.upper[wide] / limits.lower[wide]
    half_width = 0.5 * np.log(ratio)
    relative = limits.errors[:, wide] / half_width
    square = np.mean(relative**2, axis=0)
    x = np.log(omega[wide])
    mean = square[0]
    if x.size > 1:
        length = x[-1] - x[0]
        mean = np.trapezoid(square, x) / length
    return float(np.sqrt(mean))
