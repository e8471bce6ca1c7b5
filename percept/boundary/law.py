"""Laws of (k, b) as densities on a grid: of posterior draws, and behind the classical intervals.

Given the scales, (k, b) or their logarithms are normal: the posterior law mixes one normal per draw
of the scales. Its batches have densities of their own, from which Monte Carlo errors come.

Eq. 15 comes from a distribution: X̄ + t·SD/√n, t with ν = n − 1. With stiffness and damping of the
same subjects the matching distribution of both is the bivariate t_ν about the means with the sample
covariance: each margin is Eq. 15's (or the prediction interval's) exactly, and k and b go together
as the sample does. It is the posterior under the prior abs(Σ)^−2, by inverse Wishart Σ; between the
margins its coverage is close to its level, not exact.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import integrate, special
from scipy.interpolate import CubicSpline, RectBivariateSpline

from percept.errors import RefusalError
from percept.inference.classical.moments import sample
from percept.inference.regions import EllipseRegion
from percept.inference.sampling.endpoints import mixture_quantile

Array = NDArray[np.float64]
Family = Literal["normal", "lognormal"]

# An axis bends about its central 68 %; its grid leaves out the second probability at either end.
_TAILS = (0.16, 2e-6)
# Draws that say where the grid ends.
_ENOUGH = 1024
# Steps of the density's grid near the middle, in half-widths of the central 68 %, and into what
# each is cut.
_STEP, _CUT = 0.16, 4
# Correlations nearer one count as this: a law on a line has no density.
_NEAREST = 1e-6
#: N/m and N·s/m: what lies farther out counts as this.
BEYOND = 1e40
_ENDLESS = np.log(BEYOND)
# Points that stand for the law, at multiples of the powers of the plastic number: even in each
# coordinate and in both.
_POINTS, _EVEN = 4096, 1.32471795724474602596 ** np.array([-1.0, -2.0])


@dataclasses.dataclass(frozen=True)
class Axis:
    """One of k and b, N/m or N·s/m, by a coordinate that is even near the middle and logarithmic far out."""

    centre: float
    unit: float
    low: float
    high: float
    size: int  # of the density's grid
    log: bool

    @property
    def grid(self) -> Array:
        """Coordinates of the density's grid."""
        return np.linspace(self.low, self.high, self.size)

    def native(self, place: Array) -> Array:
        """Return k or b at places, from 0 to 1 along the grid."""
        values = self.centre + self.unit * np.sinh(self.low + (self.high - self.low) * place)
        return np.exp(np.clip(values, -_ENDLESS, _ENDLESS)) if self.log else values

    def place(self, native: Array) -> Array:
        """Return how far along the grid k or b lies, from 0 to 1."""
        least = np.exp(-_ENDLESS)
        values = np.log(np.maximum(native, least)) if self.log else native
        u = np.arcsinh((values - self.centre) / self.unit)
        place = np.clip((u - self.low) / (self.high - self.low), 0.0, 1.0)
        # All that is smaller counts as this small, and lies beyond no limit.
        return np.where(native > least, place, 0.0) if self.log else place

    def rate(self, place: Array, native: Array) -> Array:
        """Return how fast a place moves with k or b; zero at the ends of the grid."""
        width, least = self.high - self.low, np.exp(-_ENDLESS)
        scale = width * self.unit * np.cosh(self.low + width * place)
        scale *= np.maximum(native, least) if self.log else 1.0
        # A grid over so many decades reaches below the least value, where the place stands still.
        inside = (place > 0.0) & (place < 1.0) & ((native > least) | (not self.log))
        return np.where(inside, 1.0 / scale, 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class PairLaw:
    """Law of stiffness and damping of one environment."""

    family: Family
    mean: Array  # (2,) of (log) k and b
    covariance: Array  # (2, 2)
    axes: tuple[Axis, Axis]  # of k and b
    density: Array  # (K, L) on the grid of k and b
    batches: Array  # (B, K, L) densities of the batches of draws
    shares: Array  # (B,) of the draws in each batch; none where nothing was drawn

    @functools.cached_property
    def cumulated(self) -> tuple[Array, Array]:
        """Probability of k up to a point (inner) per b (outer), and of b per k, (outer, inner) each."""
        fine = [np.linspace(0.0, 1.0, _CUT * (axis.size - 1) + 1) for axis in self.axes]
        unit = [part[::_CUT] for part in fine]
        over_k = CubicSpline(unit[0], self.density, axis=0).antiderivative()(fine[0])
        over_b = CubicSpline(unit[1], self.density, axis=1).antiderivative()(fine[1])
        of_k = CubicSpline(unit[1], over_k, axis=1)(fine[1]).T
        return np.ascontiguousarray(of_k), CubicSpline(unit[0], over_b, axis=0)(fine[0])

    @functools.cached_property
    def by_batch(self) -> tuple[Array, Array]:
        """The same of all draws and of each batch, (outer, inner, 1 + B), on the density's grid.

        That is enough for differences.
        """
        every = np.concatenate([self.density[None], self.batches])
        found = []
        for inner in (0, 1):
            dx = 1.0 / (self.axes[inner].size - 1)
            held = integrate.cumulative_trapezoid(every, dx=dx, axis=1 + inner, initial=0)
            found.append(np.ascontiguousarray(held.transpose(2 - inner, 1 + inner, 0)))
        return found[0], found[1]

    @functools.cached_property
    def endless(self) -> float:
        """Probability that k or b lies so far out that no limit is found there."""
        beyond = 0.0
        for axis, table in zip(self.axes, self.cumulated, strict=True):
            row, over = steps(axis.place(np.array([-BEYOND, BEYOND])), table.shape[1])
            held = table[:, row] + over * (table[:, row + 1] - table[:, row])
            inside = np.trapezoid(
                held[:, 1] - held[:, 0] * (not axis.log), dx=1.0 / (len(table) - 1)
            )
            beyond += max(0.0, 1.0 - float(inside))
        return beyond

    def even(self, count: int) -> tuple[Array, Array, Array]:
        """Return points that fill the plane evenly, k and b each (count,), and their probability."""
        places = np.outer(_EVEN, np.arange(0.5, count)) % 1.0
        first, second = (np.linspace(0.0, 1.0, axis.size) for axis in self.axes)
        density = RectBivariateSpline(first, second, self.density).ev(*places)
        k, b = (axis.native(place) for axis, place in zip(self.axes, places, strict=True))
        return k, b, density / density.sum()

    def ellipse(self, *, kind: Literal["mean", "user"], level: float, n: int) -> EllipseRegion:
        """Put an ellipse around the law, out to a quantile of the Mahalanobis distance."""
        unit = EllipseRegion(
            kind=kind, method="bayesian", family=self.family, level=level,
            centre=self.mean, shape=self.covariance, radius=1.0, n=n,
        )  # fmt: skip
        k, b, held = self.even(_POINTS)
        distance = unit.distance(k, b)
        order = np.argsort(distance)
        inside = np.cumsum(held[order])
        radius = float(np.interp(level * inside[-1], inside, distance[order]))
        return dataclasses.replace(unit, radius=radius)


def mixture_law(mean: Array, covariance: Array, batch: NDArray[np.intp], family: Family) -> PairLaw:
    """Return the law of normals of (log) k and b, means (S, 2) and covariances (S, 2, 2), in batches (S,)."""
    centre, about = mean.mean(axis=0), np.cov(mean.T, bias=True) + covariance.mean(axis=0)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    # Few draws say where an axis bends. Where it ends a few wide draws decide, and all must be
    # asked: what lies beyond the grid is lost.
    every = 1 + len(mean) // _ENOUGH
    asked = zip(_TAILS, (every, 1), strict=True)
    ends = [
        [
            mixture_quantile(mean[::step], sd[::step], tail, upper=upper)[0]
            for upper in (False, True)
        ]
        for tail, step in asked
    ]
    axes = _axes(about, np.array(ends), family)
    order = np.argsort(batch, kind="stable")
    sizes = np.bincount(batch)
    x, y = (np.sinh(axis.grid) for axis in axes)
    own, spread, slope, left = _by_regression(mean[order], covariance[order], axes)
    precision, height = 1.0 / np.sqrt(left), -0.5 * np.log(spread * left)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    density = np.empty((sizes.size, x.size, y.size))
    # In single precision exponentials take a fifth of the time, and keep seven digits.
    with np.errstate(over="ignore"):
        scaled = np.multiply.outer(x, precision).astype(np.float32)
    terms = np.empty_like(scaled)
    for column, at in enumerate(y):
        off = at - own[1]
        # Far out a square may pass what single precision holds: its exponential is zero.
        with np.errstate(over="ignore"):
            np.subtract(scaled, ((own[0] + slope * off) * precision).astype(np.float32), out=terms)
            terms *= terms
            terms *= np.float32(-0.5)
            terms += (height - 0.5 * off * off / spread).astype(np.float32)
        # Below the smallest normal numbers arithmetic is a hundred times as slow.
        np.maximum(terms, np.float32(-80.0), out=terms)
        np.exp(terms, out=terms)
        density[:, :, column] = np.add.reduceat(terms, starts, axis=1).T
    return _law(density, sizes / sizes.sum(), axes, centre, about, family)


def _by_regression(
    mean: Array, covariance: Array, axes: tuple[Axis, Axis]
) -> tuple[Array, Array, Array, Array]:
    """Means (2, S) in the axes' units, variance of b, slope of k on it, and the variance that leaves of k."""
    unit = np.array([axis.unit for axis in axes])
    own = ((mean - [axis.centre for axis in axes]) / unit).T
    c = covariance / np.multiply.outer(unit, unit)
    slope = c[:, 0, 1] / c[:, 1, 1]
    left = np.maximum(c[:, 0, 0] - slope * c[:, 0, 1], _NEAREST * c[:, 0, 0])
    return own, c[:, 1, 1], slope, left


def _axes(covariance: Array, quantiles: Array, family: Family) -> tuple[Axis, Axis]:
    """Lay both axes over a law by its quantiles (tails, sides, 2); finer where k and b go together."""
    rho = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    step = _STEP * min(1.0, max(0.2, 2.5 * np.sqrt(max(0.0, 1.0 - rho * rho))))
    axes = []
    for (left, right), ends in np.moveaxis(quantiles, -1, 0):
        centre, unit = 0.5 * (left + right), 0.5 * (right - left)
        low, high = np.arcsinh((ends - centre) / unit).tolist()
        # In eights, so that studies alike share the splines.
        size = 8 * int(np.ceil((high - low) / step / 8.0)) + 1
        axes.append(Axis(float(centre), float(unit), low, high, size, log=family == "lognormal"))
    return axes[0], axes[1]


def _law(
    batches: Array,
    shares: Array,
    axes: tuple[Axis, Axis],
    mean: Array,
    covariance: Array,
    family: Family,
) -> PairLaw:
    """Put densities of the standard coordinates on the axes' own, each summing to one."""
    batches = batches * np.multiply.outer(*(np.cosh(axis.grid) for axis in axes))
    du, dv = (1.0 / (axis.size - 1) for axis in axes)
    density = batches.sum(axis=0)
    over_k = CubicSpline(np.linspace(0.0, 1.0, axes[0].size), density).integrate(0.0, 1.0)
    density /= CubicSpline(np.linspace(0.0, 1.0, axes[1].size), over_k).integrate(0.0, 1.0)
    sums = np.asarray(np.trapezoid(np.trapezoid(batches, dx=du, axis=1), dx=dv, axis=1))
    batches /= sums[:, None, None]
    return PairLaw(family, mean, covariance, axes, density, batches[: shares.size], shares)


def confidence_law(
    stiffness: ArrayLike, damping: ArrayLike, *, kind: str, family: Family
) -> PairLaw:
    """Return the law of (k, b) of the average or the next user behind the classical intervals."""
    k, b = (sample(x, positive=family == "lognormal", least=3) for x in (stiffness, damping))
    values = np.log([k, b]) if family == "lognormal" else np.stack([k, b])
    n = k.size
    mean, covariance = values.mean(axis=1), np.cov(values)
    if not (np.diagonal(covariance) > 0).all():
        raise RefusalError("all subjects adjusted alike: there is no scatter to draw from.")
    covariance *= 1.0 / n if kind == "mean" else 1.0 + 1.0 / n
    out = -special.stdtrit(n - 1, np.array(_TAILS))[:, None] * np.sqrt(np.diagonal(covariance))
    axes = _axes(covariance, np.stack([mean - out, mean + out], axis=1), family)
    own, spread, slope, left = _by_regression(mean[None], covariance[None], axes)
    x, y = np.meshgrid(*(np.sinh(axis.grid) for axis in axes), indexing="ij")
    off = y - own[1]
    square = (x - own[0] - slope * off) ** 2 / left + off**2 / spread
    density = (1.0 + square / (n - 1.0)) ** (-0.5 * (n + 1.0))
    return _law(density[None], np.empty(0), axes, mean, covariance, family)


def steps(place: Array, count: int) -> tuple[NDArray[np.intp], Array]:
    """Return the step of a table of `count` that places in [0, 1] lie in, and how far in it."""
    place = place * (count - 1)
    index = np.minimum(place.astype(np.intp), count - 2)
    return index, place - index
