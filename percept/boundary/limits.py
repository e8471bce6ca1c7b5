"""Limits of abs(Z_h) at single frequencies, from the joint law of k and b.

A score s stands for the level 2 Phi(s) - 1. The limits at a score are the radii r of two balls:

    P(abs(Z_h) <= r) = Phi(-s)  for the lower one,  Phi(s) for the upper one

Both sides are compared as normal scores, and r is searched for by its logarithm: one is nearly a
straight line over the other. `ball` gives the probability and its slope in log r.

No curve is drawn at random. The Monte Carlo error of a limit is that of the posterior draws behind
the law. Batch i of the draws puts dP_i more into the ball, which moves the limit by dP_i / phi(s)
scores; the slope of the limit over its score turns this into an error of log r.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.ball import Balls
from percept.boundary.law import BEYOND, PairLaw
from percept.boundary.shares import score_of
from percept.errors import RefusalError
from percept.haptics.loop import Loop
from percept.searches import root

__all__ = [
    "Magnitude",
    "MagnitudeLimits",
    "density",
    "level_of",
    "relative_error",
]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Probabilities this near 0 or 1 have a finite normal score.
_LEAST_PROBABILITY = 1e-14
# Probability beyond the first guess of a limit: that of the usual 99 % limits.
_GUESSED_TAIL = 0.005
# Points of the law that the first guess is made from.
_GUESS_POINTS = 600
# SDs of a normal below which a limit's score counts as met: far less than a Monte Carlo error.
_SCORE_ACCURACY = 1e-4
# Accuracy of the search, `root`'s: the product of its last two steps, in widths of the band.
_STEP_ACCURACY = 1e-4
# Widths of the band around the guess within which limits are looked for first.
_NEAR_GUESS = 3.0
# Narrowest band, in logarithms, that steps of the search are measured in.
_NARROWEST = 1e-9
# A limit that misses its score by more, in SDs of a normal, is looked for again.
_MISSED = 0.01
# Steps are finer by this factor then: near an edge of the law a limit is far sharper than its band
# is wide.
_RETRY_FACTOR = 1e-3
# SDs of a normal over which the slope of a limit is taken. In the tail of a heavy law the integral
# gives a limit to all its digits, and its slope to none.
_SLOPE_STEP = 0.05
# Smallest probability beyond a limit: the grid of a law leaves out a fifth of this.
_LEAST_TAIL = 1e-5
# The least square of a magnitude with a logarithm.
_TINY = np.finfo(np.float64).tiny
_SQRT_2PI = np.sqrt(2.0 * np.pi)


def level_of(score: float) -> float:
    """Return the level of the central limits of a normal so many SDs out."""
    return float(1.0 - 2.0 * special.ndtr(-score))


def density(score: Array | float) -> Array:
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
    """

    def __init__(
        self,
        law: PairLaw,
        loop: Loop,
        omega: Array,
        *,
        mass: float = 0.0,
    ) -> None:
        self.law = law
        self.balls = Balls(law, loop, omega, mass=mass)
        self._logs_at: dict[float, Array] = {}
        self._shifts_at: dict[float, Array] = {}

    def limits(self, level: float, shifts: Array | None = None) -> MagnitudeLimits:
        """Return equal-tailed limits.

        Parameters
        ----------
        level : float
            Probability between them at each frequency.
        shifts : ndarray, shape (B,), optional
            By how many SDs each batch of draws moves the level itself: part of the errors.

        Raises
        ------
        RefusalError
            The law does not determine limits so far out.
        """
        score = score_of(level)
        self._check_score(score)
        finite = self.balls.finite
        limits = np.full((2, finite.size), np.inf)
        limits[:, finite] = np.exp(self.log_limits(score))
        if not self.law.batch_count:
            return MagnitudeLimits(limits[0], limits[1])
        errors = np.zeros(limits.shape)
        moves = self.batch_shifts(score)
        if shifts is not None:
            moves = shifts + moves
        by_score = self.law.standard_error(moves)
        errors[:, finite] = self._slopes(score) * by_score
        return MagnitudeLimits(limits[0], limits[1], errors)

    @functools.cached_property
    def farthest_score(self) -> float:
        """Largest score of limits: farther out the law says too little, or k or b is infinite."""
        tail = max(_LEAST_TAIL, self.law.infinite)
        return float(-special.ndtri(tail))

    def _check_score(self, score: float) -> None:
        """Refuse limits farther out than the law determines them, and say why."""
        if score <= self.farthest_score:
            return
        if self.law.infinite > _LEAST_TAIL:
            raise RefusalError(f"a limit may lie beyond {BEYOND:.0e} N·s/m.")
        highest = level_of(self.farthest_score)
        raise RefusalError(f"the law determines limits up to the level {highest:g} only.")

    @functools.cached_property
    def log_range(self) -> tuple[Array, Array]:
        """Bounds of log abs(Z_h) on the law's grid, (M,) each: no limit lies outside."""
        return self.balls.log_range()

    def log_limits(self, score: float) -> Array:
        """Return log limits (2, M) at a score, at the frequencies that have balls."""
        if score not in self._logs_at:
            self._logs_at[score] = self._solve(score)
        return self._logs_at[score]

    def log_limits_between(self, scores: Array) -> Array:
        """Interpolate log limits at scores (B, 2, M), along straight lines between solved scores.

        Solved are those that `log_limits` has been called with: some near these scores, and some
        far off.
        """
        solved = np.array(sorted(self._logs_at))
        tables = np.stack([self._logs_at[score] for score in solved])
        following = np.searchsorted(solved, scores)
        before = np.clip(following - 1, 0, solved.size - 2)
        after = before + 1
        spacing = solved[after] - solved[before]
        fraction = (scores - solved[before]) / spacing
        # Below the first score limits run on straight. The last is the farthest that the law
        # determines: beyond it limits stay.
        fraction = np.minimum(fraction, 1.0)
        start = np.take_along_axis(tables, before, axis=0)
        end = np.take_along_axis(tables, after, axis=0)
        low, high = self.log_range
        logs = start + fraction * (end - start)
        return np.clip(logs, low, high)

    def batch_shifts(self, score: float) -> Array:
        """Return by how many SDs each batch of draws moves limits out, (2, M, B)."""
        if score not in self._shifts_at:
            log_radius = self.log_limits(score).ravel()
            radius = np.exp(log_radius)
            content = self.balls.content_by_batch(self._frequency, radius, self._inner)
            # A batch with draws far narrower than the tables' steps may seem to hold less than
            # nothing.
            content = np.clip(content, 0.0, 1.0)
            more = content[:, 1:] - content[:, :1]
            scores = more / density(score)
            shifts = scores.reshape(2, self.balls.count, -1)
            # A batch that holds more moves the lower limit down and so out, the upper one in.
            shifts[1] *= -1.0
            self._shifts_at[score] = shifts
        return self._shifts_at[score]

    def _slopes(self, score: float) -> Array:
        """Return how fast log limits (2, M) move out with their score."""
        here = self.log_limits(score)
        farther = self.log_limits(score + _SLOPE_STEP)
        return np.abs(farther - here) / _SLOPE_STEP

    @functools.cached_property
    def _frequency(self) -> Indices:
        """Frequency of each limit: of all lower ones, then of all upper ones, (2 M,)."""
        return np.tile(np.arange(self.balls.count), 2)

    @functools.cached_property
    def _guess(self) -> Array:
        """Log limits (2, M) of points that stand for the law, at the usual level."""
        k, b, probability = self.law.even(_GUESS_POINTS)
        squares = self.balls.squares(k, b)
        order = np.argsort(squares, axis=1)
        sorted_squares = np.take_along_axis(squares, order, axis=1)
        positive = np.maximum(sorted_squares, _TINY)
        logs = 0.5 * np.log(positive)
        below = np.cumsum(probability[order], axis=1)
        nearest = []
        for tail in (below, 1.0 - below):
            likely = np.maximum(tail, _LEAST_PROBABILITY)
            ratio = likely / _GUESSED_TAIL
            misfit = np.abs(np.log(ratio))
            nearest.append(misfit.argmin(axis=1))
        columns = np.stack(nearest, axis=1)
        guessed = np.take_along_axis(logs, columns, axis=1)
        return guessed.T

    @functools.cached_property
    def _inner(self) -> Indices:
        """Which of k and b is the inner variable in the ball of each limit, (2 M,)."""
        radius = np.exp(self._guess.ravel())
        return self.balls.smoother_inner(self._frequency, radius)

    def _solve(self, score: float) -> Array:
        """Solve for log limits (2, M) at a score."""
        search = _Search(self.balls, self._frequency, self._inner, score)
        guess = self._extrapolate(score) if self._logs_at else self._guess
        lower, upper = self._guess
        # A band far narrower than its magnitude may have no width among the guess's points.
        band = np.maximum(upper - lower, _NARROWEST)
        width = np.tile(band, 2)
        lowest, highest = self.log_range
        low = np.tile(lowest, 2)
        high = np.tile(highest, 2)
        start = np.clip(guess.ravel(), low, high)
        near = _NEAR_GUESS * width
        near_low = np.maximum(low, start - near)
        near_high = np.minimum(high, start + near)
        logs = root(
            search.misfit, start, near_low, near_high, width, most_step_product=_STEP_ACCURACY
        )
        misfits, _ = search.misfit(logs)
        missed = np.abs(misfits) > _MISSED
        if missed.any():
            finer = _STEP_ACCURACY * _RETRY_FACTOR
            logs = root(search.misfit, logs, low, high, width, most_step_product=finer)
        return logs.reshape(2, -1)

    def _extrapolate(self, score: float) -> Array:
        """Guess log limits from those at the nearest solved scores, along a straight line."""
        nearest, *others = sorted(self._logs_at, key=lambda solved: abs(solved - score))
        logs = self._logs_at[nearest]
        if not others:
            return logs
        second = others[0]
        slope = (self._logs_at[second] - logs) / (second - nearest)
        return logs + (score - nearest) * slope


class _Search:
    """Misfit of log limits (2 M,), lower ones first, which remembers what it was called with."""

    def __init__(
        self,
        balls: Balls,
        frequency: Indices,
        inner: Indices,
        score: float,
    ) -> None:
        self.balls = balls
        self.frequency = frequency
        self.inner = inner
        self.target = np.repeat([-score, score], balls.count)
        self.logs = np.full(frequency.size, np.nan)
        self.value = np.full(frequency.size, np.nan)
        self.slope = np.full(frequency.size, np.nan)

    def misfit(self, logs: Array) -> tuple[Array, Array]:
        """Return by how many SDs limits miss their score, and how fast that changes."""
        # Most limits are found in four steps: only the rest is worked out again.
        (new,) = np.nonzero(logs != self.logs)
        radius = np.exp(logs[new])
        content = self.balls.content(self.frequency[new], radius, self.inner[new])
        most = 1.0 - _LEAST_PROBABILITY
        probability = np.clip(content.probability, _LEAST_PROBABILITY, most)
        scores = special.ndtri(probability)
        missing = scores - self.target[new]
        # A value of zero ends the search of this limit.
        missing[np.abs(missing) < _SCORE_ACCURACY] = 0.0
        self.logs[new] = logs[new]
        self.value[new] = missing
        self.slope[new] = content.slope / density(scores)
        return self.value.copy(), self.slope.copy()


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
