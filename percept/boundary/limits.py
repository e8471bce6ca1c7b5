"""Limits of abs(Z_h) that follow from a law of (k, b): at each omega for itself, and over all omega together.

abs(Z_h) is a distance in the plane of (b, k/Omega): given one of the two, abs(Z_h) <= r is an interval of
the other. Its probability is a difference of two cumulated densities, and one smooth integral is left. No
curve is drawn at random: the error of a limit is that of the posterior draws behind the law.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.law import PairLaw, steps
from percept.errors import UsageError
from percept.haptics import AnyDevice
from percept.haptics.impedance import warp
from percept.haptics.perceived import distance_axes
from percept.inference.sampling.endpoints import root

Array = NDArray[np.float64]

# Three subjects have tails that 24 nodes miss by a fifth.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)
# An interval ends like a square root: nodes even in the angle take that out.
_PLACES, _PARTS = np.sin(0.5 * np.pi * _NODES), 0.5 * np.pi * _WEIGHTS * np.cos(0.5 * np.pi * _NODES)
# Legendre polynomials of the highest orders at the nodes: an integrand that they hold much of is rough.
_LAST = np.polynomial.legendre.legvander(_NODES, _NODES.size - 1)[:, -6:]
_LEAST = 1e-14
# Limits are found to this many SDs of a normal.
_EXACT = 1e-4
# Where they are first looked for; and how many bands from there, in logarithms, they may lie.
_TAIL, _WIDER = 0.005, 3.0
# Bands, in logarithms, that a limit moves by at most per SD.
_STEEPEST, _NARROWEST = 2.0, 1e-9
# Points that say where to look.
_SOME = 600
_BLOCK_VALUES, _TINY = 1 << 20, np.finfo(np.float64).tiny
# A level is calibrated to this many SDs of a normal.
_CLOSE, _MOST_STEPS, _FARTHEST = 0.003, 12, 3.0
# Fewest points that a share is read from, and parts of the points whose scatter says how far off it is.
_FEWEST, _PARTED = 16, 4


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Limits of abs(Z_h) at M frequencies."""

    lower: Array  # (M,) N·s/m
    upper: Array  # (M,) N·s/m
    errors: Array | None  # (2, M) Monte Carlo errors of their logarithms; None of a law that is not drawn


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """The level at each omega for itself at which limits hold over all omega together."""

    level: float
    error: float  # Standard error: of the draws, and of the points that whole curves are counted at
    shifts: Array  # (B,) By how many SDs each batch of draws would move the limits out


class Magnitude:
    """Law of abs(Z_h) at frequencies (M,), rad/s, that follows from a law of (k, b)."""

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
        across, along, held = distance_axes(warp(omega, period), device, hold, mass)
        # abs(Z_h)² is the sum over k and b of (gain·value + offset)².
        gains, offsets = (
            np.stack([np.broadcast_to(part, omega.shape) for part in parts])
            for parts in ((held.per_rate, held.gain), (-along, across))
        )
        # At Nyquist a mass is endless, whatever k and b are.
        self._finite = np.isfinite(offsets).all(axis=0) & (gains > 0).all(axis=0)
        self._law, self._gains, self._offsets = law, gains[:, self._finite], offsets[:, self._finite]
        self._solved: dict[float, tuple[Array, Array]] = {}

    def limits(self, level: float, shifts: Array | None = None) -> Limits:
        """Equal-tailed limits; `shifts` of their score by batch are part of the error."""
        score = _score(level)
        logs, slopes = self._known(score)
        found = np.full((2, self._finite.size), np.inf)
        found[:, self._finite] = np.exp(logs)
        if not self._law.shares.size:
            return Limits(found[0], found[1], None)
        errors = np.zeros(found.shape)
        own = (0.0 if shifts is None else shifts) - self._changes(score)
        errors[:, self._finite] = slopes * self._spread(own)
        return Limits(found[0], found[1], errors)

    def calibrate(self, level: float) -> Calibration:
        """Choose the level at each omega that keeps curves inside at all of them with probability `level`."""
        first = score = _score(level)
        k, b, held = self._law.points
        limits = self._known(score)[0][..., None]
        # Only what leaves the narrowest limits can leave wider ones.
        leave, parts = np.zeros(held.shape[1], dtype=bool), []
        for m, part in self._logs(k, b):
            leave |= ((part < limits[0, m]) | (part > limits[1, m])).any(axis=0)
            parts.append(part.astype(np.float32))
        held, logs = held[:, leave], np.concatenate([part[:, leave] for part in parts])
        for _ in range(_MOST_STEPS):
            # How far out each point lies at most, in SDs beyond the limits, and where.
            limits, slopes = self._known(score)
            out = np.concatenate([limits[0, :, None] - logs, logs - limits[1, :, None]])
            out /= slopes.reshape(-1, 1)
            where = out.argmax(axis=0)
            farthest = out[where, np.arange(where.size)]
            step, fall = _level_of(farthest, held[0], 1.0 - level)
            if abs(step) < _CLOSE or (score == first and step < 0.0):
                break
            score = min(max(first, score + step), first + _FARTHEST)
        turn = np.flatnonzero(leave) * _PARTED // leave.size
        steps = [
            _level_of(farthest[turn == i], _PARTED * held[0, turn == i], 1.0 - level)[0]
            for i in range(_PARTED)
        ]
        # Points that are even leave an error that falls about as their number to the power 3/4.
        error = float(np.std(steps, ddof=1) / _PARTED**0.75)
        rate = 2.0 * float(_density(np.array(score)))
        # A batch moves limits and weights alike.
        moved = farthest[:, None] + self._changes(score).reshape(-1, len(held) - 1)[where]
        own = np.einsum("bc,cb->b", held[1:], moved > 0.0)
        shifts = (own - own @ self._law.shares) / (fall * (1.0 - level))
        return Calibration(_level(score), rate * float(np.hypot(error, self._spread(shifts))), shifts)

    def _spread(self, values: Array) -> Array:
        """Return the standard error of a mean over draws from its batches, on the last axis."""
        batches = self._law.shares.size
        mean = values @ self._law.shares
        square = ((values - mean[..., None]) * self._law.shares) ** 2
        return np.asarray(np.sqrt(square.sum(axis=-1) * batches / (batches - 1.0)))

    def _logs(self, k: Array, b: Array) -> Iterator[tuple[slice, Array]]:
        """Yield log abs(Z_h) at points, some frequencies at a time."""
        step = max(1, _BLOCK_VALUES // k.size)
        for start in range(0, self._gains.shape[1], step):
            m = slice(start, start + step)
            squares = (self._gains[0, m, None] * k + self._offsets[0, m, None]) ** 2
            squares += (self._gains[1, m, None] * b + self._offsets[1, m, None]) ** 2
            yield m, 0.5 * np.log(np.maximum(squares, _TINY, out=squares))

    @functools.cached_property
    def _outlook(self) -> tuple[Array, NDArray[np.intp]]:
        """About where log limits lie, and of which of k and b the interval is best taken there, (2, M)."""
        k, b, held = self._law.even(_SOME)
        starts = []
        for _, logs in self._logs(k, b):
            order = np.argsort(logs, axis=1)
            below = np.cumsum(held[0][order], axis=1)
            starts.append(
                [
                    np.take_along_axis(logs, np.take_along_axis(order, at[:, None], 1), 1)[:, 0]
                    for beyond in (below, 1.0 - below)
                    for at in [np.abs(np.log(np.maximum(beyond, _LEAST) / _TAIL)).argmin(axis=1)]
                ]
            )
        first = np.concatenate(starts, axis=1)
        at, radius = np.tile(np.arange(first.shape[1]), 2), np.exp(first.ravel())
        rough = [self._content(inner, at, radius, 1)[2] for inner in (0, 1)]
        return first, np.argmin(rough, axis=0).reshape(first.shape)

    def _changes(self, score: float) -> Array:
        """Return by what each batch changes the score of the limits, (2, M, B)."""
        at, inner = np.tile(np.arange(self._gains.shape[1]), 2), self._outlook[1].ravel()
        held, _ = self.content(at, np.exp(self._known(score)[0].ravel()), inner, every=True)
        changes = (held[:, 1:] - held[:, :1]).reshape(2, self._gains.shape[1], -1)
        return changes * (np.array([-1.0, 1.0]) / _density(np.array(score)))[:, None, None]

    def _known(self, score: float) -> tuple[Array, Array]:
        """Return log limits (2, M) at a score, and their slopes in it."""
        if score in self._solved:
            return self._solved[score]
        start, inner = self._outlook
        if self._solved:
            known = min(self._solved, key=lambda other: abs(other - score))
            logs, slopes = self._solved[known]
            start = logs + np.array([[-1.0], [1.0]]) * (score - known) * slopes
        count = start.shape[1]
        at, inner = np.tile(np.arange(count), 2), inner.ravel()
        target = np.repeat([-score, score], count)

        last, value, rate = np.full((3, at.size), np.nan)

        def short(x: Array) -> tuple[Array, Array]:
            # Most limits are found in four steps: only the rest is worked out again.
            (new,) = np.nonzero(x != last)
            held, slope = self.content(at[new], np.exp(x[new]), inner[new])
            found = special.ndtri(np.clip(held, _LEAST, 1.0 - _LEAST))
            last[new], value[new], rate[new] = x[new], found - target[new], slope / _density(found)
            value[np.abs(value) < _EXACT] = 0.0
            return value.copy(), rate.copy()

        # A band far narrower than its magnitude may have no width among the points looked at.
        scale = np.tile(np.maximum(start[1] - start[0], _NARROWEST), 2)
        low, high = start.ravel() - _WIDER * scale, start.ravel() + _WIDER * scale
        x = root(short, start.ravel(), low, high, scale, _EXACT)
        short(x)
        # Where a law all but ends the slope has none of the digits: no limit moves that far.
        slopes = 1.0 / np.maximum(rate, 1.0 / (_STEEPEST * scale))
        self._solved[score] = x.reshape(2, -1), slopes.reshape(2, -1)
        return self._solved[score]

    def content(
        self, at: NDArray[np.intp], radius: Array, inner_of: NDArray[np.intp], *, every: bool = False
    ) -> tuple[Array, Array]:
        """Return P(abs(Z_h) <= radius), (Q,), at frequencies number `at`, and its slope in log radius.

        The interval is of k where `inner_of` is zero, of b where it is one. With `every`, the probability has
        a column for all draws and one for each batch.
        """
        columns = self._law.density.shape[0] if every else 1
        held, slope = np.zeros((at.size, columns)), np.zeros(at.size)
        for inner in (0, 1):
            (rows,) = np.nonzero(inner_of == inner)
            if rows.size:
                held[rows], slope[rows], _ = self._content(inner, at[rows], radius[rows], columns)
        return (held if every else held[:, 0]), slope

    def _content(
        self, inner: int, at: NDArray[np.intp], radius: Array, columns: int
    ) -> tuple[Array, Array, Array]:
        """Integrate over one of k and b the probability of the interval of the other.

        Also return how rough the slope's integrand is: what its last Legendre coefficients amount to.
        """
        axis, outer = self._law.axes[inner], self._law.axes[1 - inner]
        table = self._law.cumulated[inner]
        (gain, offset), (gain_out, offset_out) = (
            (self._gains[p, at, None], self._offsets[p, at, None]) for p in (inner, 1 - inner)
        )
        radius = radius[:, None]
        # What the inner one adds at least leaves less to the outer one: few nodes must not fall beyond.
        ends = gain * axis.native(np.array([axis.low, axis.high])) + offset
        least = np.maximum(0.0, np.maximum(ends[:, :1], -ends[:, 1:]))
        reach = np.sqrt(np.maximum((radius - least) * (radius + least), 0.0))
        left, right = (outer.place((sign * reach - offset_out) / gain_out)[0] for sign in (-1.0, 1.0))
        half = 0.5 * (right - left)
        u = 0.5 * (right + left) + half * _PLACES
        weight = half * _PARTS / (outer.high - outer.low)
        far = gain_out * outer.native(u) + offset_out
        side = np.sqrt(np.maximum((radius - far) * (radius + far), 0.0))
        row, over = steps(outer.fraction(u), len(table))
        held = np.zeros((at.size, columns))
        slopes, margin = np.zeros(u.shape), table[:, -1, :columns]
        flat = table.reshape(-1, table.shape[2]) if columns > 1 else self._law.whole[inner]
        for sign in (1.0, -1.0):
            place, rate = axis.place((sign * side - offset) / gain)
            column, part = steps(axis.fraction(place), table.shape[1])
            index = row * table.shape[1]
            index += column
            # Along the row and the next, a step and its rise.
            before, other = (flat.take(index + skip, axis=0) for skip in (0, table.shape[1]))
            rise = flat.take(index + 1, axis=0) - before
            other_rise = flat.take(index + table.shape[1] + 1, axis=0) - other
            shape = over.shape + (1,) * (before.ndim - 2)
            before += over.reshape(shape) * (other - before)
            rise += over.reshape(shape) * (other_rise - rise)
            before += part.reshape(shape) * rise
            held += sign * np.einsum("qj,qj...->q...", weight, before).reshape(at.size, -1)
            with np.errstate(divide="ignore", invalid="ignore"):
                moves = np.where(side > 0.0, rate * radius**2 / (side * gain), 0.0)
            moves *= (table.shape[1] - 1) / (axis.high - axis.low)
            slopes += weight * moves * rise.reshape(*u.shape, -1)[..., 0]
        # Far out the rest is what counts: of the margin all digits are known.
        whole = margin[row] + over[..., None] * (margin[row + 1] - margin[row])
        at_end, beyond = steps(outer.fraction(np.concatenate([left, right], axis=1)), len(table))
        summed = self._law.margins[inner][:, :columns]
        # Of lines between the table's points, as the nodes are.
        first, beyond = margin[at_end], beyond[..., None]
        rest = beyond * (first + 0.5 * beyond * (margin[at_end + 1] - first))
        known = summed[at_end] + rest / (len(table) - 1)
        most = held[:, 0] > 0.5
        missed = known[:, 1] - known[:, 0] - np.einsum("qj,qjc->qc", weight, whole)
        held[most] += missed[most]
        rough = np.abs(slopes @ _LAST).sum(axis=1) / np.maximum(slopes.sum(axis=1), _TINY)
        return held, slopes.sum(axis=1), rough


def _level_of(out: Array, weight: Array, share: float) -> tuple[float, float]:
    """Return how far out a share of the weights lies beyond, and how fast the share's logarithm falls there.

    A line through the logarithms about that share: weights are steps.
    """
    order = np.argsort(-out)
    beyond = np.cumsum(weight[order])
    low, high = np.searchsorted(beyond, [0.6 * share, 1.6 * share])
    if high - low < _FEWEST:
        low, high = max(0, low - _FEWEST), high + _FEWEST
    slope, at = np.polyfit(np.log(beyond[low:high] / share), out[order[low:high]], 1)
    return float(at), float(-1.0 / slope)


def _score(level: float) -> float:
    """Return how many SDs out the limits of a normal lie."""
    if not 0.0 < level < 1.0:
        raise UsageError("level must lie in (0, 1).", value=level)
    return float(-special.ndtri(0.5 * (1.0 - level)))


def _level(score: float) -> float:
    return float(1.0 - 2.0 * special.ndtr(-score))


def _density(score: Array) -> Array:
    return np.exp(-0.5 * score * score) / np.sqrt(2.0 * np.pi)


def relative_error(omega: Array, limits: Limits) -> tuple[float, float] | None:
    """Typical and largest error of limits, as fractions of the band's half-width in logarithms."""
    wide = np.isfinite(limits.upper) & (limits.upper > limits.lower)
    if limits.errors is None or not wide.any():
        return None
    half_width = 0.5 * np.log(limits.upper[wide] / limits.lower[wide])
    relative, x = limits.errors[:, wide] / half_width, np.log(omega[wide])
    square = np.mean(relative**2, axis=0)
    mean = np.trapezoid(square, x) / (x[-1] - x[0]) if x.size > 1 else square[0]
    return float(np.sqrt(mean)), float(relative.max())
