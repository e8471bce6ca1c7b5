"""Limits of abs(Z_h) at single frequencies, from the joint law of k and b.

A limit is the radius of the ball that holds a given probability. Limits are solved for in the log
radius, and the probability is compared as a normal score: in these two a limit is nearly straight.
No curve is drawn at random. The Monte Carlo error of a limit is that of the posterior draws behind
the law, from the differences between batches of draws.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.ball import Balls
from percept.boundary.law import BEYOND, PairLaw
from percept.errors import RefusalError
from percept.haptics.records import AnyDevice
from percept.inference.sampling.roots import root

__all__ = [
    "_OUTWARD",
    "Magnitude",
    "MagnitudeLimits",
    "density",
    "level_of",
    "relative_error",
    "score_of",
]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Lower limits move down and upper ones up as their score grows.
_OUTWARD = np.array([[-1.0], [1.0]])

# Probabilities this near 0 or 1 have a finite normal score.
_LEAST = 1e-14
# Probability beyond the first guess of a limit: that of the usual 99 % limits.
_GUESSED_TAIL = 0.005
# Points that the first guess is made from.
_GUESS_POINTS = 600
# Accuracy of limits: SDs of a normal, and steps of the search in widths of the band.
_ACCURACY = 1e-4
# Widths of the band around the guess within which limits are looked for first.
_NEAR_GUESS = 3.0
# Narrowest band, in logarithms, that steps of the search are measured in.
_NARROWEST = 1e-9
# A limit that misses its score by more, in SDs of a normal, is looked for again.
_MISSED = 0.01
# Finer steps then: near an edge of the law a limit is far sharper than its band is wide.
_SHARPER = 1e-3
# SDs of a normal over which the slope of a limit is taken. In the tail of a heavy law the integral
# gives a limit to all its digits, and its slope to none.
_SLOPE_STEP = 0.05
# Smallest probability beyond a limit: the grid of a law leaves out a fifth of this.
_LEAST_TAIL = 1e-5
_TINY = np.finfo(np.float64).tiny


def score_of(level: float) -> float:
    """Return how many SDs out the central limits of a normal lie at a level."""
    return float(-special.ndtri(0.5 * (1.0 - level)))


def level_of(score: float) -> float:
    """Return the level of the central limits of a normal so many SDs out."""
    return float(1.0 - 2.0 * special.ndtr(-score))


def density(score: Array | float) -> Array:
    """Return the density of a standard normal."""
    return np.asarray(np.exp(-0.5 * np.square(score)) / np.sqrt(2.0 * np.pi))


@dataclasses.dataclass(frozen=True, eq=False)
class MagnitudeLimits:
    """Limits of abs(Z_h) at M frequencies."""

    lower: Array  # (M,) N·s/m
    upper: Array  # (M,) N·s/m
    errors: Array | None = None  # (2, M) Monte Carlo errors of their logarithms; None if not drawn


class Magnitude:
    """Law of abs(Z_h) at frequencies, from a law of (k, b).

    Parameters
    ----------
    law : PairLaw
        Law of stiffness and damping.
    device : Device or TabulatedDevice
        What the user holds.
    period : float
        Sampling period, s.
    omega : ndarray, shape (M,)
        Frequencies, rad/s.
    mass : float, optional
        Mass of the environment, kg.
    hold : str, optional
        "average" (Eq. 8) or "true".
    """

    def __init__(
        self,
        law: PairLaw,
        device: AnyDevice,
        period: float,
        omega: Array,
        *,
        mass: float = 0.0,
        hold: str = "average",
    ) -> None:
        self.law = law
        self.balls = Balls(law, device, period, omega, mass=mass, hold=hold)
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
        if not score <= self.farthest_score:
            raise RefusalError(f"a limit may lie beyond {BEYOND:.0e} N·s/m.")
        finite = self.balls.finite
        limits = np.full((2, finite.size), np.inf)
        limits[:, finite] = np.exp(self.log_limits(score))
        if not self.law.batch_count:
            return MagnitudeLimits(limits[0], limits[1])
        errors = np.zeros(limits.shape)
        moves = self.batch_shifts(score)
        if shifts is not None:
            moves = shifts + moves
        errors[:, finite] = self._slopes(score) * self.law.standard_error(moves)
        return MagnitudeLimits(limits[0], limits[1], errors)

    @functools.cached_property
    def farthest_score(self) -> float:
        """Largest score of limits: farther out the law says too little, or k or b is infinite."""
        return float(-special.ndtri(max(_LEAST_TAIL, self.law.infinite)))

    @functools.cached_property
    def log_range(self) -> tuple[Array, Array]:
        """Smallest and largest log limits, (M,) each."""
        return self.balls.log_range()

    def log_limits(self, score: float) -> Array:
        """Return log limits (2, M) at a score, at the frequencies that have balls."""
        if score not in self._logs_at:
            self._logs_at[score] = self._solve(score)
        return self._logs_at[score]

    def log_limits_between(self, scores: Array) -> Array:
        """Interpolate log limits at scores (B, 2, M) between the scores that are solved."""
        solved = np.array(sorted(self._logs_at))
        logs = np.stack([self._logs_at[score] for score in solved])
        step = np.clip(np.searchsorted(solved, scores) - 1, 0, solved.size - 2)
        part = (scores - solved[step]) / (solved[step + 1] - solved[step])
        side, frequency = np.indices(scores.shape[1:])
        left = logs[step, side, frequency]
        right = logs[step + 1, side, frequency]
        return np.clip(left + np.minimum(part, 1.0) * (right - left), *self.log_range)

    def batch_shifts(self, score: float) -> Array:
        """Return by how many SDs each batch of draws moves limits out, (2, M, B)."""
        if score not in self._shifts_at:
            frequency = np.tile(np.arange(self.balls.count), 2)
            radius = np.exp(self.log_limits(score)).ravel()
            content = self.balls.content_by_batch(frequency, radius, self._inner.ravel())
            # A batch with draws far narrower than the tables' steps may seem to hold less than
            # nothing.
            content = np.clip(content, 0.0, 1.0).reshape(2, self.balls.count, -1)
            more = content[..., 1:] - content[..., :1]
            # A batch that holds more moves the lower limit down and so out, the upper one in.
            self._shifts_at[score] = more * -_OUTWARD[..., None] / density(score)
        return self._shifts_at[score]

    def _slopes(self, score: float) -> Array:
        """Return how fast log limits (2, M) move out with their score."""
        farther = self.log_limits(score + _SLOPE_STEP)
        return np.abs(farther - self.log_limits(score)) / _SLOPE_STEP

    @functools.cached_property
    def _guess(self) -> Array:
        """Log limits (2, M) of points that stand for the law, at the usual level."""
        k, b, probability = self.law.even(_GUESS_POINTS)
        squares = self.balls.squares(k, b)
        order = np.argsort(squares, axis=1)
        logs = 0.5 * np.log(np.maximum(np.take_along_axis(squares, order, 1), _TINY))
        below = np.cumsum(probability[order], axis=1)
        nearest = []
        for tail in (below, 1.0 - below):
            misfit = np.abs(np.log(np.maximum(tail, _LEAST) / _GUESSED_TAIL))
            nearest.append(misfit.argmin(axis=1))
        return np.take_along_axis(logs, np.stack(nearest, axis=1), 1).T

    @functools.cached_property
    def _inner(self) -> Indices:
        """Which of k and b is the inner one in the ball of each limit, (2, M)."""
        frequency = np.tile(np.arange(self.balls.count), 2)
        radius = np.exp(self._guess.ravel())
        return self.balls.smoother_inner(frequency, radius).reshape(self._guess.shape)

    def _solve(self, score: float) -> Array:
        """Solve for log limits (2, M) at a score."""
        count = self.balls.count
        frequency = np.tile(np.arange(count), 2)
        inner = self._inner.ravel()
        target = np.repeat([-score, score], count)
        last, value, rate = np.full((3, 2 * count), np.nan)

        def misfit(logs: Array) -> tuple[Array, Array]:
            """Return by how many SDs limits miss their score, and how fast that changes."""
            # Most limits are found in four steps: only the rest is worked out again.
            (new,) = np.nonzero(logs != last)
            content = self.balls.content(frequency[new], np.exp(logs[new]), inner[new])
            scores = special.ndtri(np.clip(content.probability, _LEAST, 1.0 - _LEAST))
            last[new] = logs[new]
            value[new] = scores - target[new]
            rate[new] = content.slope / density(scores)
            value[np.abs(value) < _ACCURACY] = 0.0
            return value.copy(), rate.copy()

        guess = self._guess if not self._logs_at else self._extrapolate(score)
        # A band far narrower than its magnitude may have no width among the guess's points.
        width = np.tile(np.maximum(self._guess[1] - self._guess[0], _NARROWEST), 2)
        low, high = (np.tile(end, 2) for end in self.log_range)
        start = np.clip(guess.ravel(), low, high)
        near_low = np.maximum(low, start - _NEAR_GUESS * width)
        near_high = np.minimum(high, start + _NEAR_GUESS * width)
        logs = root(misfit, start, near_low, near_high, width, most_step_product=_ACCURACY)
        missed = np.abs(misfit(logs)[0])
        if missed.max(initial=0.0) > _MISSED:
            logs = root(misfit, logs, low, high, width, most_step_product=_ACCURACY * _SHARPER)
        return logs.reshape(2, -1)

    def _extrapolate(self, score: float) -> Array:
        """Guess log limits from those at the nearest solved scores, along a straight line."""
        nearest, *others = sorted(self._logs_at, key=lambda solved: abs(solved - score))
        logs = self._logs_at[nearest]
        if not others:
            return logs
        slope = (self._logs_at[others[0]] - logs) / (others[0] - nearest)
        return logs + (score - nearest) * slope


def relative_error(omega: Array, limits: MagnitudeLimits) -> float | None:
    """Return the typical error of limits over log omega, in half-widths of the band in logarithms.

    None without errors, and where no band has width.
    """
    wide = np.isfinite(limits.upper) & (limits.upper > limits.lower)
    if limits.errors is None or not wide.any():
        return None
    half_width = 0.5 * np.log(limits.upper[wide] / limits.lower[wide])
    relative = limits.errors[:, wide] / half_width
    square = np.mean(relative**2, axis=0)
    x = np.log(omega[wide])
    mean = np.trapezoid(square, x) / (x[-1] - x[0]) if x.size > 1 else square[0]
    return float(np.sqrt(mean))
