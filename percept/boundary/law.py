"""Laws of (k, b), and the limits of abs(Z_h) that follow: at each omega for itself, and over all omega.

A law is a mixture of normals of (k, b), or of their logarithms: one component per posterior draw of the scales,
or the bivariate t behind the classical intervals. Its density stands on a grid. abs(Z_h) is a distance in the
plane of (b, k/Omega): given one of the two, abs(Z_h) <= r is an interval of the other, whose probability is a
difference of two cumulated densities, and one smooth integral is left. No curve is drawn at random.

Eq. 15 comes from a distribution: X̄ + t·SD/√n, t with ν = n − 1. With stiffness and damping of the same
subjects the matching distribution of both is the bivariate t_ν about the means with the sample covariance:
each margin is Eq. 15's (or the prediction interval's) exactly, and k and b go together as the sample does. It
is the posterior under the prior abs(Σ)^−2, by inverse Wishart Σ; between the margins its coverage is close
to its level, not exact.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special
from scipy.interpolate import CubicSpline

from percept.errors import RefusalError, UsageError
from percept.haptics import AnyDevice
from percept.haptics.impedance import warp
from percept.haptics.perceived import distance_axes
from percept.inference.classical.moments import sample
from percept.inference.regions import EllipseRegion
from percept.inference.sampling.endpoints import mixture_quantile, root

Array = NDArray[np.float64]
Family = Literal["normal", "lognormal"]

# The grid leaves out this probability at either end of either axis.
_BEYOND = 2e-6
# Steps of the density's grid near the middle, in half-widths of the central 68 %, and what a step is cut into.
_STEP, _CUT = 0.16, 4
# Correlations nearer one count as this: a law on a line has no density.
_NEAREST = 1e-6
# Logarithms beyond this are as good as endless: 1e40 N/m.
_ENDLESS = 40.0 * np.log(10.0)
# Points that say over which omega a level holds.
_POINTS, _EVEN = 4096, 1.32471795724474602596 ** np.array([-1.0, -2.0])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
# Ends of an interval are square roots: nodes even in the angle take these out.
_PLACES, _PARTS = np.sin(0.5 * np.pi * _NODES), 0.5 * np.pi * _WEIGHTS * np.cos(0.5 * np.pi * _NODES)
_LEAST = 1e-14
_EXACT = 1e-5
# A limit is looked for this many bands, in logarithms, from where it should lie.
_WIDER = 3.0
# One point in so many says where to look for limits; odd, so that all rows take part.
_SOME = 5
_BLOCK_VALUES, _TINY = 1 << 20, np.finfo(np.float64).tiny
# A level is calibrated once the share outside is within this fraction of what is asked.
_CLOSE, _MOST_STEPS = 0.01, 12


@dataclasses.dataclass(frozen=True)
class _Axis:
    """One of k and b, N/m or N·s/m, by a coordinate that is even near the middle and logarithmic far out."""

    centre: float
    unit: float
    low: float
    high: float
    size: int  # of the density's grid
    log: bool

    @classmethod
    def of(cls, quantile: Callable[[float], tuple[float, float]], step: float, *, log: bool) -> _Axis:
        """Lay an axis over a law by its quantiles."""
        (left, right), ends = quantile(0.16), np.array(quantile(_BEYOND))
        centre, unit = 0.5 * (left + right), 0.5 * (right - left)
        low, high = np.arcsinh((ends - centre) / unit).tolist()
        # In eights, so that studies alike share the splines.
        size = 8 * int(np.ceil((high - low) / step / 8.0)) + 1
        return cls(centre, unit, low, high, size, log)

    @property
    def grid(self) -> Array:
        """Coordinates of the density's grid."""
        return np.linspace(self.low, self.high, self.size)

    def fraction(self, u: Array) -> Array:
        """Return how far along the axis a coordinate lies."""
        return (u - self.low) / (self.high - self.low)

    def native(self, u: Array) -> Array:
        """Return k or b."""
        values = self.centre + self.unit * np.sinh(u)
        return np.exp(np.clip(values, -_ENDLESS, _ENDLESS)) if self.log else values

    def step(self, native: Array) -> Array:
        """Return how k or b moves with its coordinate."""
        values = np.log(native) if self.log else native
        rate = np.hypot(values - self.centre, self.unit)
        return rate * native if self.log else rate

    def place(self, native: Array) -> tuple[Array, Array]:
        """Return the coordinate of k or b, inside the grid, and how it moves with them; zero outside."""
        values = np.log(np.maximum(native, np.exp(-_ENDLESS))) if self.log else native
        away = (values - self.centre) / self.unit
        u = np.arcsinh(away)
        rate = 1.0 / (self.unit * np.sqrt(1.0 + away * away))
        if self.log:
            rate /= np.maximum(native, np.exp(-_ENDLESS))
        return np.clip(u, self.low, self.high), np.where((u > self.low) & (u < self.high), rate, 0.0)


@functools.cache
def _splines(size: int) -> tuple[Array, Array]:
    """Matrices from values on a grid to those of their cubic spline and its integral, cut finer; unit length."""
    spline = CubicSpline(np.linspace(0.0, 1.0, size), np.eye(size))
    fine = np.linspace(0.0, 1.0, _CUT * (size - 1) + 1)
    return spline(fine), spline.antiderivative()(fine)


@dataclasses.dataclass(frozen=True, eq=False)
class PairLaw:
    """Law of stiffness and damping of one environment."""

    family: Family
    mean: Array  # (2,) of (log) k and b
    covariance: Array  # (2, 2)
    axes: tuple[_Axis, _Axis]  # of k and b
    density: Array  # (1 + B, K, L) on the grid of k and b: of all draws, and of each batch
    shares: Array  # (B,) of the draws in each batch; none where nothing was drawn

    @functools.cached_property
    def cumulated(self) -> tuple[Array, Array]:
        """Probability of k up to a point per b, and of b up to a point per k: (outer, inner, 1 + B)."""
        (value_k, sum_k), (value_b, sum_b) = (_splines(axis.size) for axis in self.axes)
        over_k = np.moveaxis(sum_k @ self.density @ value_b.T, (0, 1, 2), (2, 1, 0))
        over_b = np.moveaxis(value_k @ self.density @ sum_b.T, (0, 1, 2), (2, 0, 1))
        return np.ascontiguousarray(over_k), np.ascontiguousarray(over_b)

    @functools.cached_property
    def points(self) -> tuple[Array, Array, Array]:
        """Points that fill the plane evenly, k and b each (C,), and the probability of every batch at them."""
        # Multiples of the powers of the plastic number: even in each coordinate and in both.
        place = np.outer(_EVEN, np.arange(0.5, _POINTS)) % 1.0
        k, b = (axis.native(axis.low + part * (axis.high - axis.low)) for axis, part in zip(self.axes, place, strict=True))
        values = [_splines(axis.size)[0] for axis in self.axes]
        table = np.moveaxis(values[0] @ self.density @ values[1].T, 0, -1)
        (row, over), (column, part) = (
            _steps(at, size) for at, size in zip(place, table.shape[:2], strict=True)
        )
        held = np.zeros((_POINTS, len(self.density)))
        for i, weight in enumerate((1.0 - over, over)):
            for j, other in enumerate((1.0 - part, part)):
                held += (weight * other)[:, None] * table[row + i, column + j]
        return k, b, (held / held.sum(axis=0)).T

    def ellipse(self, *, kind: Literal["mean", "user"], level: float, n: int) -> EllipseRegion:
        """Put an ellipse around the law: its mean and covariance, out to a quantile of Mahalanobis distance."""
        unit = EllipseRegion(
            kind=kind, method="bayesian", family=self.family, level=level,
            centre=self.mean, shape=self.covariance, radius=1.0, n=n,
        )  # fmt: skip
        k, b, held = self.points
        distance = unit.distance(k, b)
        order = np.argsort(distance)
        inside = np.cumsum(held[0][order])
        radius = float(np.interp(level * inside[-1], inside, distance[order]))
        return dataclasses.replace(unit, radius=radius)


def mixture_law(mean: Array, covariance: Array, batch: NDArray[np.intp], family: Family) -> PairLaw:
    """Return the law of normals of (log) k and b, means (S, 2) and covariances (S, 2, 2), in batches (S,)."""
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    centre, about = mean.mean(axis=0), np.cov(mean.T, bias=True) + covariance.mean(axis=0)

    def quantiles(tail: float) -> Array:
        return np.stack([mixture_quantile(mean, sd, tail, upper=upper)[0] for upper in (False, True)])

    found = {tail: quantiles(tail) for tail in (0.16, _BEYOND)}
    axes = _axes(about, lambda p, tail: tuple(found[tail][:, p].tolist()), family)
    order = np.argsort(batch, kind="stable")
    sizes = np.bincount(batch)
    x, y = (np.sinh(axis.grid) for axis in axes)
    own, spread, slope, left = _by_regression(mean[order], covariance[order], axes)
    precision, height = 1.0 / np.sqrt(left), -0.5 * np.log(spread * left)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    density = np.empty((1 + sizes.size, x.size, y.size))
    # In single precision exponentials take a fifth of the time, and keep seven digits.
    scaled, terms = np.multiply.outer(x, precision).astype(np.float32), np.empty((x.size, len(mean)), np.float32)
    for column, at in enumerate(y):
        off = at - own[1]
        np.subtract(scaled, ((own[0] + slope * off) * precision).astype(np.float32), out=terms)
        terms *= terms
        terms *= np.float32(-0.5)
        terms += (height - 0.5 * off * off / spread).astype(np.float32)
        # Below the smallest normal numbers arithmetic is a hundred times as slow.
        np.maximum(terms, np.float32(-80.0), out=terms)
        np.exp(terms, out=terms)
        density[1:, :, column] = np.add.reduceat(terms, starts, axis=1).T
    density[0] = density[1:].sum(axis=0)
    return _law(density, axes, centre, about, family, sizes / sizes.sum())


def _by_regression(
    mean: Array, covariance: Array, axes: tuple[_Axis, _Axis]
) -> tuple[Array, Array, Array, Array]:
    """Means (2, S) in the axes' units, variance of b, slope of k on it, and the variance that leaves of k."""
    unit = np.array([axis.unit for axis in axes])
    own = ((mean - [axis.centre for axis in axes]) / unit).T
    c = covariance / np.multiply.outer(unit, unit)
    slope = c[:, 0, 1] / c[:, 1, 1]
    left = np.maximum(c[:, 0, 0] - slope * c[:, 0, 1], _NEAREST * c[:, 0, 0])
    return own, c[:, 1, 1], slope, left


def _axes(
    covariance: Array, quantile: Callable[[int, float], tuple[float, float]], family: Family
) -> tuple[_Axis, _Axis]:
    """Lay both axes over a law; finer where k and b go together."""
    rho = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    step = _STEP * min(1.0, max(0.2, 2.5 * np.sqrt(max(0.0, 1.0 - rho * rho))))
    first, second = (
        _Axis.of(functools.partial(quantile, p), step, log=family == "lognormal") for p in range(2)
    )
    return first, second


def _law(
    density: Array, axes: tuple[_Axis, _Axis], mean: Array, covariance: Array, family: Family, shares: Array
) -> PairLaw:
    """Put densities (1 + B, points) of the standard coordinates on the axes' own, each summing to one."""
    rates = np.multiply.outer(*(np.cosh(axis.grid) for axis in axes))
    table = density * rates
    sums = [_splines(axis.size)[1][-1] for axis in axes]
    table /= np.einsum("nkl,k,l->n", table, *sums)[:, None, None]
    return PairLaw(family, mean, covariance, axes, table, shares)


def confidence_law(stiffness: ArrayLike, damping: ArrayLike, *, kind: str, family: Family) -> PairLaw:
    """Return the law of (k, b) of the average or the next user behind the classical intervals."""
    k, b = (sample(x, positive=family == "lognormal", least=3) for x in (stiffness, damping))
    if k.ndim != 1 or k.shape != b.shape:
        raise UsageError(f"one stiffness and one damping per subject are needed: {k.shape}, {b.shape}.")
    values = np.log([k, b]) if family == "lognormal" else np.stack([k, b])
    n = k.size
    mean, covariance = values.mean(axis=1), np.cov(values)
    if not (np.diagonal(covariance) > 0).all():
        raise RefusalError("all subjects adjusted alike: there is no scatter to draw from.")
    covariance *= 1.0 / n if kind == "mean" else 1.0 + 1.0 / n
    sd = np.sqrt(np.diagonal(covariance))

    def quantile(p: int, tail: float) -> tuple[float, float]:
        out = -float(special.stdtrit(n - 1, tail)) * sd[p]
        return mean[p] - out, mean[p] + out

    axes = _axes(covariance, quantile, family)
    own, spread, slope, left = _by_regression(mean[None], covariance[None], axes)
    x, y = np.meshgrid(*(np.sinh(axis.grid) for axis in axes), indexing="ij")
    off = y - own[1]
    square = (x - own[0] - slope * off) ** 2 / left + off**2 / spread
    density = (1.0 + square / (n - 1.0)) ** (-0.5 * (n + 1.0))
    return _law(density[None], axes, mean, covariance, family, np.empty(0))


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
    error: float | None  # Monte Carlo error; None of a law that is not drawn
    shifts: Array  # (B,) By how many SDs each batch of draws would move the limits out


class Magnitude:
    """Law of abs(Z_h) at frequencies (M,), rad/s, that follows from a law of (k, b)."""

    def __init__(
        self, law: PairLaw, device: AnyDevice, period: float, omega: Array, *, hold: str = "average"
    ) -> None:
        across, along, held = distance_axes(warp(omega, period), device, hold)
        # abs(Z_h)² is the sum over k and b of (gain·value + offset)².
        gains, offsets = (
            np.stack([np.broadcast_to(part, omega.shape) for part in parts])
            for parts in ((held.per_rate, held.gain), (-along, across))
        )
        # At Nyquist a mass is endless, whatever k and b are.
        self._finite = np.isfinite(offsets).all(axis=0) & (gains > 0).all(axis=0)
        self._law, self._gains, self._offsets = law, gains[:, self._finite], offsets[:, self._finite]
        self._solved: dict[float, tuple[Array, Array, Array]] = {}

    def limits(self, level: float, shifts: Array | None = None) -> Limits:
        """Equal-tailed limits; `shifts` of their score by batch are part of the error."""
        score = _score(level)
        logs, slopes, changes = self._known(score)
        found = np.full((2, self._finite.size), np.inf)
        found[:, self._finite] = np.exp(logs)
        if not self._law.shares.size:
            return Limits(*found, None)
        errors = np.zeros(found.shape)
        errors[:, self._finite] = slopes * self._spread((0.0 if shifts is None else shifts) - changes)
        return Limits(*found, errors)

    def calibrate(self, level: float) -> Calibration:
        """Choose the level at each omega so that curves lie inside at all of them with probability `level`."""
        first = score = _score(level)
        held = self._law.points[2]
        logs = np.concatenate([part for _, part in self._logs()])
        # The share of curves outside falls about as the normal tail does.
        for _ in range(_MOST_STEPS):
            limits = self._known(score)[0][..., None]
            outside = (logs < limits[0]) | (logs > limits[1])
            beyond = held[0] @ outside.any(axis=0)
            step = np.log(max(beyond, _LEAST) / (1.0 - level)) / score
            if abs(step) * score < _CLOSE or (score == first and step < 0.0):
                break
            score += step
        shifts = np.zeros(self._law.shares.size)
        if not shifts.size:
            return Calibration(_level(score), None, shifts)
        # A batch moves limits and weights alike; each point counts where it lies farthest out.
        limits, slopes, changes = self._known(score)
        out = np.concatenate([limits[0, :, None] - logs, logs - limits[1, :, None]])
        out /= slopes.reshape(-1, 1)
        where = out.argmax(axis=0)
        farthest = out[where, np.arange(where.size)]
        own = np.einsum("bc,cb->b", held[1:], farthest[:, None] + changes.reshape(-1, shifts.size)[where] > 0.0)
        shifts = (own - own @ self._law.shares) / (score * (1.0 - level))
        return Calibration(_level(score), float(2.0 * _density(np.array(score)) * self._spread(shifts)), shifts)

    def _spread(self, values: Array) -> Array:
        """Return the standard error of a mean over draws from its batches, on the last axis."""
        batches = self._law.shares.size
        mean = values @ self._law.shares
        square = ((values - mean[..., None]) * self._law.shares) ** 2
        return np.asarray(np.sqrt(square.sum(axis=-1) * batches / (batches - 1.0)))

    def _logs(self, every: int = 1) -> Iterator[tuple[slice, Array]]:
        """Yield log abs(Z_h) at the points of the grid, some frequencies at a time."""
        k, b = (values[::every] for values in self._law.points[:2])
        step = max(1, _BLOCK_VALUES // k.size)
        for start in range(0, self._gains.shape[1], step):
            m = slice(start, start + step)
            squares = (self._gains[0, m, None] * k + self._offsets[0, m, None]) ** 2
            squares += (self._gains[1, m, None] * b + self._offsets[1, m, None]) ** 2
            yield m, 0.5 * np.log(np.maximum(squares, _TINY, out=squares))

    def _outlook(self, score: float) -> tuple[Array, NDArray[np.intp]]:
        """About where log limits at a score lie, and which of k and b moves abs(Z_h) most there, (2, M).

        Given the other one the probability changes slowly, so that few nodes integrate it.
        """
        k, b, held = (values[..., ::_SOME] for values in self._law.points)
        tail, weight = special.ndtr(-score), held[0] / held[0].sum()
        steps = [axis.step(values) for axis, values in zip(self._law.axes, (k, b), strict=True)]
        starts, inner = [], []
        for m, logs in self._logs(_SOME):
            order = np.argsort(logs, axis=1)
            below = np.cumsum(weight[order], axis=1)
            moves = [
                np.abs((gain[m, None] * values + offset[m, None]) * gain[m, None] * step) * np.exp(-2.0 * logs)
                for gain, offset, values, step in zip(self._gains, self._offsets, (k, b), steps, strict=True)
            ]
            for beyond in (below, 1.0 - below):
                at = np.abs(np.log(np.maximum(beyond, _LEAST) / tail))
                starts.append(np.take_along_axis(logs, np.take_along_axis(order, at.argmin(axis=1)[:, None], 1), 1)[:, 0])
                near = np.zeros(logs.shape)
                np.put_along_axis(near, order, (at < 1.5) * weight[order], axis=1)
                inner.append(np.argmax([np.einsum("mc,mc->m", near, part) for part in moves], axis=0))
        return tuple(np.stack([np.concatenate(part[side::2]) for side in (0, 1)]) for part in (starts, inner))

    def _known(self, score: float) -> tuple[Array, Array, Array]:
        if score not in self._solved:
            self._solved[score] = self._solve(score)
        return self._solved[score]

    def _solve(self, score: float) -> tuple[Array, Array, Array]:
        """Return log limits (2, M) at a score, their slopes in it, and what each batch changes it by."""
        start, inner = self._outlook(score)
        if self._solved:
            known = min(self._solved, key=lambda other: abs(other - score))
            logs, slopes, _ = self._solved[known]
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

        scale = np.tile(start[1] - start[0], 2)
        low, high = start.ravel() - _WIDER * scale, start.ravel() + _WIDER * scale
        x = root(short, start.ravel(), low, high, scale, _EXACT)
        held, slope = self.content(at, np.exp(x), inner, every=True)
        density = _density(np.array(score))
        changes = np.repeat([-1.0, 1.0], count)[:, None] * (held[:, 1:] - held[:, :1]) / density
        return x.reshape(2, -1), (density / slope).reshape(2, -1), changes.reshape(2, count, -1)

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
                held[rows], slope[rows] = self._content(inner, at[rows], radius[rows], columns)
        return (held if every else held[:, 0]), slope

    def _content(
        self, inner: int, at: NDArray[np.intp], radius: Array, columns: int
    ) -> tuple[Array, Array]:
        """Integrate over one of k and b the probability of the interval of the other."""
        axis, outer = self._law.axes[inner], self._law.axes[1 - inner]
        table = self._law.cumulated[inner]
        (gain, offset), (gain_out, offset_out) = (
            (self._gains[p, at, None], self._offsets[p, at, None]) for p in (inner, 1 - inner)
        )
        radius = radius[:, None]
        left, right = (outer.place((sign * radius - offset_out) / gain_out)[0] for sign in (-1.0, 1.0))
        half = 0.5 * (right - left)
        u = 0.5 * (right + left) + half * _PLACES
        weight = half * _PARTS / (outer.high - outer.low)
        far = gain_out * outer.native(u) + offset_out
        side = np.sqrt(np.maximum((radius - far) * (radius + far), 0.0))
        row, over = _steps(outer.fraction(u), len(table))
        held, slope = np.zeros((at.size, columns)), np.zeros(at.size)
        for sign in (1.0, -1.0):
            place, rate = axis.place((sign * side - offset) / gain)
            column, part = _steps(axis.fraction(place), table.shape[1])
            first, second = (
                table[row + i, column, :columns] * (1.0 - over if i == 0 else over)[..., None] for i in (0, 1)
            )
            before = first + second
            first, second = (
                table[row + i, column + 1, :columns] * (1.0 - over if i == 0 else over)[..., None]
                for i in (0, 1)
            )
            rise = first + second - before
            held += sign * np.einsum("qj,qjn->qn", weight, before + part[..., None] * rise)
            with np.errstate(divide="ignore", invalid="ignore"):
                moves = np.where(side > 0.0, rate * radius**2 / (side * gain), 0.0)
            moves *= (table.shape[1] - 1) / (axis.high - axis.low)
            slope += np.einsum("qj,qj,qj->q", weight, moves, rise[..., 0])
        return held, slope


def _steps(place: Array, count: int) -> tuple[NDArray[np.intp], Array]:
    """Return the step of a table of `count` that places in [0, 1] lie in, and how far in it."""
    place = place * (count - 1)
    index = np.minimum(place.astype(np.intp), count - 2)
    return index, place - index


def _score(level: float) -> float:
    """Return how many SDs out the limits of a normal lie."""
    if not 0.0 < level < 1.0:
        raise UsageError("level must lie in (0, 1).", value=level)
    return float(-special.ndtri(0.5 * (1.0 - level)))


def _level(score: float) -> float:
    return float(1.0 - 2.0 * special.ndtr(-score))


def _density(score: Array) -> Array:
    return np.exp(-0.5 * score * score) / np.sqrt(2.0 * np.pi)
