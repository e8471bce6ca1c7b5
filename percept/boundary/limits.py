"""Limits of abs(Z_h) that follow from a law of (k, b): at each omega for itself, and over all omega together.

abs(Z_h) is a distance in the plane of (b, k/Omega): given one of the two, abs(Z_h) <= r is an
interval of the other. Its probability is a difference of two cumulated densities, and one smooth
integral is left. No curve is drawn at random: the error of a limit is that of the posterior draws
behind the law.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, optimize, sparse, special

from percept.boundary.law import BEYOND, PairLaw, steps
from percept.errors import RefusalError
from percept.haptics.impedance import warp
from percept.haptics.perceived import distance_axes
from percept.haptics.records import AnyDevice
from percept.inference.sampling.roots import root

Array = NDArray[np.float64]

# Three subjects have tails that 24 nodes miss by a fifth.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)
# An interval ends like a square root: nodes even in the angle take that out.
_PLACES, _PARTS = (
    np.sin(0.5 * np.pi * _NODES),
    0.5 * np.pi * _WEIGHTS * np.cos(0.5 * np.pi * _NODES),
)
# Legendre polynomials of the highest orders at the nodes: an integrand that they hold much of is
# rough.
_LAST = np.polynomial.legendre.legvander(_NODES, _NODES.size - 1)[:, -6:]
_LEAST = 1e-14
# Limits are found to this many SDs of a normal.
_EXACT = 1e-4
# SDs of a normal by which a limit must not miss; one that does is looked for again, to this
# fraction of the usual step.
_FAR_OFF, _SHARPEST = 0.01, 1e-3
# Where they are first looked for; and within how many bands from there, in logarithms.
_TAIL, _WIDER = 0.005, 3.0
# Narrowest band, in logarithms, that steps of the search are measured in.
_NARROWEST = 1e-9
# SDs of a normal over which the slope of a limit is taken: in the tail of a heavy law the
# quadrature gives a limit to all its digits, and its slope to none.
_APART = 0.05
# Smallest probability beyond a limit: the grid of a law leaves out a fifth of this.
_LEAST_TAIL = 1e-5
# Points that say where to look.
_SOME = 600
_TINY = np.finfo(np.float64).tiny
# A level is calibrated to this many SDs of a normal.
_CLOSE = 0.003


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Limits of abs(Z_h) at M frequencies."""

    lower: Array  # (M,) N·s/m
    upper: Array  # (M,) N·s/m
    errors: (
        Array | None
    )  # (2, M) Monte Carlo errors of their logarithms; None of a law that is not drawn


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """The level at each omega for itself at which limits hold over all omega together."""

    level: float
    error: float  # Monte Carlo standard error
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
        self._law, self._gains, self._offsets = (
            law,
            gains[:, self._finite],
            offsets[:, self._finite],
        )
        self._solved: dict[float, Array] = {}
        self._moved: dict[float, Array] = {}

    def limits(self, level: float, shifts: Array | None = None) -> Limits:
        """Equal-tailed limits; `shifts` of their score by batch are part of the error.

        RefusalError where the law does not determine them.
        """
        score = _score(level)
        if not score <= self._farthest:
            raise RefusalError(f"a limit may lie beyond {BEYOND:.0e} N·s/m.")
        logs = self._known(score)
        found = np.full((2, self._finite.size), np.inf)
        found[:, self._finite] = np.exp(logs)
        if not self._law.shares.size:
            return Limits(found[0], found[1], None)
        errors = np.zeros(found.shape)
        own = (0.0 if shifts is None else shifts) + self._changes(score)
        errors[:, self._finite] = self._slopes(score) * self._spread(own)
        return Limits(found[0], found[1], errors)

    def calibrate(self, level: float) -> Calibration:
        """Choose the level at each omega that keeps curves inside at all of them with probability `level`.

        RefusalError where there is none that the law determines.
        """
        first = _score(level)

        @functools.cache
        def leaving(score: float) -> tuple[float, NDArray[np.bool_]]:
            held, binds = self._leaving(self._known(score)[None], self._law.cumulated[0][None])
            return float(np.log(np.maximum(held[0], _TINY) / (1.0 - level))), binds

        def excess(score: float) -> float:
            return leaving(score)[0]

        farthest = self._farthest
        if first > farthest or excess(farthest) > 0.0:
            raise RefusalError(f"no limits at single frequencies hold whole curves at {level:g}.")
        # A normal's tail falls about as fast as its score.
        score, fall = first, first
        if (beyond := excess(first)) > 0.0:
            step = min(beyond / fall, farthest - first)
            while excess(first + step) > 0.0:
                step = min(1.5 * step, farthest - first)
            score = max(
                first + _CLOSE, float(optimize.brentq(excess, first, first + step, xtol=_CLOSE))
            )
            fall = (beyond - excess(score)) / (score - first)
        m = leaving(score)[1]
        # As `limits` will ask for it, which then finds everything known.
        score = _score(_level(score))
        # A batch moves limits and probabilities alike.
        moved = self._between(score + np.moveaxis(self._changes(score), -1, 0))
        batches = np.moveaxis(self._law.by_batch[0], -1, 0)
        every = np.concatenate([self._known(score)[None], moved])
        left, _ = self._leaving(every[..., m], batches, m)
        own = left[1:] - left[0]
        shifts = own / (fall * (1.0 - level))
        rate = 2.0 * float(_density(np.array(score)))
        return Calibration(_level(score), rate * float(self._spread(shifts)), shifts)

    def _leaving(
        self, logs: Array, table: Array, m: NDArray[np.bool_] | slice = slice(None)
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the probability (C,) that curves leave log limits (C, 2, M), and where limits bind.

        Of tables (C, outer, inner), and at the frequencies `m` only. On a line of one value of b,
        limits leave an interval of k without the union of as many others.
        """
        inner, outer = self._law.axes
        (gain, gain_out), (offset, offset_out) = self._gains[:, m], self._offsets[:, m]
        b = outer.native(np.linspace(0.0, 1.0, table.shape[1]))
        square = (np.multiply.outer(b, gain_out) + offset_out) ** 2
        # Where a ball does not reach the line both its ends are the same.
        side = np.sqrt(np.maximum(np.exp(2.0 * logs[:, :, None]) - square, 0.0))
        ends = [inner.place((sign * side - offset) / gain) for sign in (-1.0, 1.0)]
        left, right = (np.moveaxis(_along(table, end), 1, 0) for end in ends)
        order = left[0].argsort(axis=-1)
        holes, ends_of = (np.take_along_axis(part[0], order, -1) for part in (left, right))
        low, high = left[1].max(axis=-1, keepdims=True), right[1].min(axis=-1, keepdims=True)
        filled = np.maximum.accumulate(ends_of, axis=-1)
        before = np.maximum(np.concatenate([low, filled], axis=-1), low)
        gaps = np.maximum(np.minimum(np.concatenate([holes, high], axis=-1), high) - before, 0.0)
        binds = np.zeros(logs.shape[-1], dtype=bool)
        binds[left[1].argmax(axis=-1)] = binds[right[1].argmin(axis=-1)] = True
        farthest = np.maximum.accumulate(
            np.where(ends_of == filled, np.arange(order.shape[-1]), 0), axis=-1
        )
        binds[order[gaps[..., :-1] > 0.0]] = True
        binds[np.take_along_axis(order, farthest, -1)[gaps[..., 1:] > 0.0]] = True
        held = np.trapezoid(gaps.sum(axis=-1), dx=1.0 / (b.size - 1), axis=-1)
        return np.asarray(1.0 - held), binds

    def _spread(self, values: Array) -> Array:
        """Return the standard error of a mean over draws from its batches, on the last axis."""
        batches = self._law.shares.size
        mean = values @ self._law.shares
        square = ((values - mean[..., None]) * self._law.shares) ** 2
        return np.asarray(np.sqrt(square.sum(axis=-1) * batches / (batches - 1.0)))

    @functools.cached_property
    def _outlook(self) -> tuple[Array, NDArray[np.intp]]:
        """About where log limits lie, and of which of k and b the interval is best taken there, (2, M)."""
        k, b, held = self._law.even(_SOME)
        squares = (self._gains[0, :, None] * k + self._offsets[0, :, None]) ** 2
        squares += (self._gains[1, :, None] * b + self._offsets[1, :, None]) ** 2
        order = np.argsort(squares, axis=1)
        logs = 0.5 * np.log(np.maximum(np.take_along_axis(squares, order, 1), _TINY))
        below = np.cumsum(held[order], axis=1)
        nearest = [
            np.abs(np.log(np.maximum(beyond, _LEAST) / _TAIL)).argmin(axis=1)
            for beyond in (below, 1.0 - below)
        ]
        first = np.take_along_axis(logs, np.stack(nearest, axis=1), 1).T
        at, radius = np.tile(np.arange(first.shape[1]), 2), np.exp(first.ravel())
        rough = [self._content(inner, at, radius)[2] for inner in (0, 1)]
        return first, np.argmin(rough, axis=0).reshape(first.shape)

    def _changes(self, score: float) -> Array:
        """Return by what each batch moves the limits out, in SDs, (2, M, B)."""
        if score not in self._moved:
            radius, inner = np.exp(self._known(score)), self._outlook[1]
            held = np.empty((*radius.shape, 1 + self._law.shares.size))
            for p in (0, 1):
                side, at = np.nonzero(inner == p)
                held[side, at] = self._by_batch(p, at, radius[side, at])
            # A batch with draws far narrower than the tables' steps may seem to hold less than
            # nothing.
            held = np.clip(held, 0.0, 1.0)
            out = np.array([1.0, -1.0])[:, None, None] / _density(np.array(score))
            self._moved[score] = (held[..., 1:] - held[..., :1]) * out
        return self._moved[score]

    @functools.cached_property
    def _farthest(self) -> float:
        """The largest score of limits: farther out a law says too little, or lies beyond all impedances."""
        return float(-special.ndtri(max(_LEAST_TAIL, self._law.endless)))

    @functools.cached_property
    def _range(self) -> tuple[Array, Array]:
        """Logarithms between which limits lie, (M,) each: magnitudes over the grid of k and b."""
        squares = np.zeros((2, self._gains.shape[1]))
        for axis, gain, offset in zip(self._law.axes, self._gains, self._offsets, strict=True):
            ends = np.multiply.outer(axis.native(np.array([0.0, 1.0])), gain) + offset
            nearest = np.where(ends[0] * ends[1] > 0.0, np.abs(ends).min(axis=0), 0.0)
            squares += np.square([nearest, np.abs(ends).max(axis=0)])
        low, high = 0.5 * np.log(np.maximum(squares, BEYOND**-2))
        return low, high

    def _slopes(self, score: float) -> Array:
        """Return how fast log limits (2, M) move out with their score."""
        return np.abs(self._known(score + _APART) - self._known(score)) / _APART

    def _known(self, score: float) -> Array:
        """Return log limits (2, M) at a score."""
        if score in self._solved:
            return self._solved[score]
        first, inner = self._outlook
        start = self._from_others(score) if self._solved else first
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
        scale = np.tile(np.maximum(first[1] - first[0], _NARROWEST), 2)
        low, high = (np.tile(end, 2) for end in self._range)
        begin = np.clip(start.ravel(), low, high)
        near = np.maximum(low, begin - _WIDER * scale), np.minimum(high, begin + _WIDER * scale)
        x = root(short, begin, *near, scale, _EXACT)
        if np.abs(short(x)[0]).max(initial=0.0) > _FAR_OFF:
            # It lies farther off; or, near an edge of the law, is far sharper than its band is wide.
            x = root(short, x, low, high, scale, _EXACT * _SHARPEST)
        self._solved[score] = x.reshape(2, -1)
        return self._solved[score]

    def _between(self, scores: Array) -> Array:
        """Return about where log limits lie at scores (B, 2, M), from those at scores that are known."""
        known = np.array(sorted(self._solved))
        logs = np.stack([self._solved[score] for score in known])
        step = np.clip(np.searchsorted(known, scores) - 1, 0, known.size - 2)
        part = np.minimum((scores - known[step]) / (known[step + 1] - known[step]), 1.0)
        side, m = np.indices(scores.shape[1:])
        left, right = logs[step, side, m], logs[step + 1, side, m]
        return np.clip(left + part * (right - left), *self._range)

    def _from_others(self, score: float) -> Array:
        """Guess log limits from those at the nearest scores, along a straight line."""
        nearest, *others = sorted(self._solved, key=lambda other: abs(other - score))
        logs = self._solved[nearest]
        if not others:
            return logs
        slope = (self._solved[others[0]] - logs) / (others[0] - nearest)
        return logs + (score - nearest) * slope

    def content(
        self, at: NDArray[np.intp], radius: Array, inner_of: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """Return P(abs(Z_h) <= radius), (Q,), at frequencies number `at`, and its slope in log radius.

        The interval is of k where `inner_of` is zero, of b where it is one.
        """
        held, slope = np.zeros((2, at.size))
        for inner in (0, 1):
            (rows,) = np.nonzero(inner_of == inner)
            if rows.size:
                held[rows], slope[rows], _ = self._content(inner, at[rows], radius[rows])
        return held, slope

    def _nodes(self, inner: int, at: NDArray[np.intp], radius: Array) -> tuple[Array, ...]:
        """Lay nodes over the outer one of k and b, and find both ends of the interval of the inner one.

        Return the outer one's range (Q, 2), nodes and weights (Q, J); ends (2, Q, J) of the inner
        one, and how fast they move with the radius' logarithm. All are places on the axes.
        """
        axis, outer = self._law.axes[inner], self._law.axes[1 - inner]
        (gain, offset), (gain_out, offset_out) = (
            (self._gains[p, at, None], self._offsets[p, at, None]) for p in (inner, 1 - inner)
        )
        radius = radius[:, None]
        # What the inner one adds at least leaves less to the outer one: few nodes must not fall
        # beyond.
        ends = gain * axis.native(np.array([0.0, 1.0])) + offset
        least = np.maximum(0.0, np.maximum(ends[:, :1], -ends[:, 1:]))
        reach = _leg(radius, least)
        left, right = (outer.place((sign * reach - offset_out) / gain_out) for sign in (-1.0, 1.0))
        half = 0.5 * (right - left)
        places = 0.5 * (right + left) + half * _PLACES
        far = gain_out * outer.native(places) + offset_out
        side = _leg(radius, np.abs(far))
        native = (np.stack([-side, side]) - offset) / gain
        ends = axis.place(native)
        with np.errstate(divide="ignore", invalid="ignore"):
            moves = np.where(
                side > 0.0, axis.rate(ends, native) * (radius / side) * (radius / gain), 0.0
            )
        return np.concatenate([left, right], axis=1), places, half * _PARTS, ends, moves

    def _content(
        self, inner: int, at: NDArray[np.intp], radius: Array
    ) -> tuple[Array, Array, Array]:
        """Integrate over one of k and b the probability of the interval of the other.

        Also return how rough the slope's integrand is: what its last Legendre coefficients amount
        to.
        """
        span, places, weight, ends, moves = self._nodes(inner, at, radius)
        table = self._law.cumulated[inner]
        row, over = steps(places, len(table))
        held, slopes = np.zeros(at.size), np.zeros(row.shape)
        flat = table.ravel()
        for sign, end, move in zip((-1.0, 1.0), ends, moves, strict=True):
            column, part = steps(end, table.shape[1])
            index = row * table.shape[1] + column
            # Both ends of the step, between the row and the next.
            before, after = (
                (1.0 - over) * flat.take(index + i) + over * flat.take(index + i + table.shape[1])
                for i in (0, 1)
            )
            rise = after - before
            held += sign * np.einsum("qj,qj->q", weight, before + part * rise)
            slopes += weight * move * rise * (table.shape[1] - 1)
        # Far out the rest is what counts: of the margin all digits are known.
        margin = table[:, -1]
        beyond = integrate.cumulative_trapezoid(margin, dx=1.0 / (len(table) - 1), initial=0)
        whole = margin[row] + over * (margin[row + 1] - margin[row])
        row, over = steps(span, len(table))
        # Of lines between the table's points, as the nodes are.
        rest = over * (margin[row] + 0.5 * over * (margin[row + 1] - margin[row]))
        known = beyond[row] + rest / (len(table) - 1)
        missed = known[:, 1] - known[:, 0] - np.einsum("qj,qj->q", weight, whole)
        held += np.where(held > 0.5, missed, 0.0)
        slope = slopes.sum(axis=1)
        last = np.abs(slopes @ _LAST).sum(axis=1)
        # No slope at any node: all of it lies between them.
        rough = np.divide(last, slope, out=np.full(slope.shape, np.inf), where=slope > 0.0)
        return held, slope, rough

    def _by_batch(self, inner: int, at: NDArray[np.intp], radius: Array) -> Array:
        """Return the content (Q, 1 + B) of all draws and of each batch, on the coarser tables."""
        _, places, weight, ends, _ = self._nodes(inner, at, radius)
        table = self._law.by_batch[inner]
        row, over = steps(places, len(table))
        weights, columns = [], []
        for sign, end in zip((-1.0, 1.0), ends, strict=True):
            column, part = steps(end, table.shape[1])
            for i, along in enumerate((1.0 - over, over)):
                for j, across in enumerate((1.0 - part, part)):
                    weights.append(sign * weight * along * across)
                    columns.append((row + i) * table.shape[1] + column + j)
        every = np.concatenate(columns, axis=1).ravel(), 8 * _NODES.size * np.arange(at.size + 1)
        flat = table.reshape(-1, table.shape[2])
        matrix = sparse.csr_array(
            (np.concatenate(weights, axis=1).ravel(), *every), (at.size, len(flat))
        )
        return np.asarray(matrix @ flat)


def _leg(radius: Array, other: Array) -> Array:
    """Return sqrt(radius² - other²), or zero: by factors, since squares of extreme radii overflow."""
    return np.asarray(np.sqrt(np.maximum(radius - other, 0.0)) * np.sqrt(radius + other))


def _along(table: Array, place: Array) -> Array:
    """Interpolate the rows of tables (C, N, inner) at places (C, ..., N, M)."""
    column, part = steps(place, table.shape[2])
    batch, row = np.arange(len(table))[:, None, None, None], np.arange(table.shape[1])[:, None]
    index, flat = (batch * table.shape[1] + row) * table.shape[2] + column, table.ravel()
    first = flat.take(index)
    return np.asarray(first + part * (flat.take(index + 1) - first))


def _score(level: float) -> float:
    """Return how many SDs out the limits of a normal lie."""
    return float(-special.ndtri(0.5 * (1.0 - level)))


def _level(score: float) -> float:
    return float(1.0 - 2.0 * special.ndtr(-score))


def _density(score: Array) -> Array:
    return np.exp(-0.5 * score * score) / np.sqrt(2.0 * np.pi)


def relative_error(omega: Array, limits: Limits) -> float | None:
    """Typical error of limits over log omega, as a fraction of the band's half-width in logarithms."""
    wide = np.isfinite(limits.upper) & (limits.upper > limits.lower)
    if limits.errors is None or not wide.any():
        return None
    half_width = 0.5 * np.log(limits.upper[wide] / limits.lower[wide])
    relative, x = limits.errors[:, wide] / half_width, np.log(omega[wide])
    square = np.mean(relative**2, axis=0)
    mean = np.trapezoid(square, x) / (x[-1] - x[0]) if x.size > 1 else square[0]
    return float(np.sqrt(mean))
