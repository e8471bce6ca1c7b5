"""Laws of (k, b) as densities on a grid: of posterior draws, and behind the classical intervals.

Given the scales, (k, b) or their logarithms are normal: the posterior law mixes one normal per draw
of the scales. Its batches have densities of their own, from which Monte Carlo errors come.

Eq. 15 comes from a distribution: X̄ + t·SD/√n, t with ν = n − 1. For two quantities of the same
subjects it is the bivariate t_ν about the means with the sample covariance, each margin Eq. 15's
exactly. It is the posterior under the prior abs(Σ)^−2; jointly its coverage is close to its level.

The grid is even in a coordinate c of each axis: k = centre + unit·sinh(c), or log k. A sinh is
straight near the middle and exponential far out, so that few steps reach 1 - 2·10⁻⁶.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import sample
from percept.inference.record import Family
from percept.inference.regions import EllipseRegion
from percept.inference.sampling.endpoints import mixture_limits

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: N/m and N·s/m: what lies farther out counts as this, and what is below one over it as zero.
BEYOND = 1e40
_LARGEST_LOG = np.log(BEYOND)
_SMALLEST = np.exp(-_LARGEST_LOG)

# An axis bends about the central 68 % of the law.
_BEND_TAIL = 0.16
# Probability that the grid leaves out at either end of an axis.
_END_TAIL = 2e-6
# About so many draws say where an axis bends: its unit need not be exact.
_BEND_DRAWS = 1024
# Steps of the density's grid near the middle, in half-widths of the central 68 %.
_STEP = 0.16
# Where k and b correlate a step is finer, down to this fraction: a ridge is narrow.
_FINEST = 0.2
# That fraction is this many times sqrt(1 - rho²), the width of such a ridge.
_RIDGE = 2.5
# Grids grow by so many steps, so that similar studies share the splines' factors.
_BLOCK = 8
# Steps of the tables in one step of the density's grid.
_CUT = 4
# Smallest variance of k given b, as a fraction of k's own: a law on a line has no density.
_LEAST_REMAINDER = 1e-6
# Logarithm of the smallest density: below normal numbers arithmetic is a hundred times as slow.
_LEAST_LOG_DENSITY = np.float32(-80.0)
# Points that stand for a law where its ellipse is sized.
_ELLIPSE_POINTS = 4096
# Whole multiples of two powers of the plastic number, taken modulo one, fill a square evenly.
_EVEN = 1.32471795724474602596 ** np.array([-1.0, -2.0])


@dataclass(frozen=True)
class Axis:
    """One of k and b, N/m or N·s/m, by a coordinate even near the middle and logarithmic far out.

    A place on the axis runs from 0 to 1 along its grid.
    """

    centre: float
    unit: float  # Half-width of the central 68 %
    low: float  # First coordinate
    high: float  # Last coordinate
    size: int  # Points of the density's grid
    log: bool  # Whether centre and unit are of the logarithm

    @property
    def grid(self) -> Array:
        """Coordinates of the density's grid."""
        return np.linspace(self.low, self.high, self.size)

    @property
    def width(self) -> float:
        """From the first coordinate to the last."""
        return self.high - self.low

    @property
    def step(self) -> float:
        """Step of the density's grid, in places."""
        return 1.0 / (self.size - 1)

    def places(self, cut: int = 1) -> Array:
        """Places of the density's grid, each of its steps cut into so many."""
        return np.linspace(0.0, 1.0, cut * (self.size - 1) + 1)

    def native(self, place: Array) -> Array:
        """Return k or b at places."""
        coordinate = self.low + self.width * place
        values = self.centre + self.unit * np.sinh(coordinate)
        if not self.log:
            return values
        logs = np.clip(values, -_LARGEST_LOG, _LARGEST_LOG)
        return np.exp(logs)

    def place(self, native: Array) -> Array:
        """Return the places of values of k or b."""
        values = native
        if self.log:
            values = np.log(np.maximum(native, _SMALLEST))
        units_off = (values - self.centre) / self.unit
        coordinate = np.arcsinh(units_off)
        place = np.clip((coordinate - self.low) / self.width, 0.0, 1.0)
        if not self.log:
            return place
        # All that is smaller counts as zero: nothing of the law lies below it.
        return np.where(native > _SMALLEST, place, 0.0)

    def rate(self, place: Array, native: Array) -> Array:
        """Return how fast a place moves with k or b; zero at the ends of the grid."""
        coordinate = self.low + self.width * place
        scale = self.width * self.unit * np.cosh(coordinate)
        inside = (place > 0.0) & (place < 1.0)
        if self.log:
            scale *= np.maximum(native, _SMALLEST)
            inside &= native > _SMALLEST
        return np.where(inside, 1.0 / scale, 0.0)


class Points(NamedTuple):
    """P points of stiffness and damping that stand for a law."""

    k: Array  # (P,) N/m
    b: Array  # (P,) N·s/m
    probability: Array  # (P,)
    by_batch: Array  # (P, B) the same of each batch of draws


@dataclass(frozen=True, eq=False)
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
        """Probability of k up to a place (inner) on lines of b (outer), and of b on lines of k.

        Tables of shape (outer, inner), finer than the density's grid.
        """
        from scipy.interpolate import CubicSpline  # slow to import, and no fit needs it

        k_axis, b_axis = self.axes
        fine_k = k_axis.places(_CUT)
        fine_b = b_axis.places(_CUT)
        over_k = CubicSpline(k_axis.places(), self.density, axis=0)
        over_b = CubicSpline(b_axis.places(), self.density, axis=1)
        up_to_k = over_k.antiderivative()(fine_k)
        up_to_b = over_b.antiderivative()(fine_b)
        of_k = CubicSpline(b_axis.places(), up_to_k, axis=1)(fine_b)
        of_b = CubicSpline(k_axis.places(), up_to_b, axis=0)(fine_k)
        return np.ascontiguousarray(of_k.T), of_b

    @property
    def batch_count(self) -> int:
        """Number of batches, B; none where nothing was drawn."""
        return self.shares.size

    @functools.cached_property
    def infinite(self) -> float:
        """Probability that k or b is so large that it counts as infinite."""
        outside = 0.0
        for axis, table in zip(self.axes, self.cumulated, strict=True):
            lowest = 0.0 if axis.log else -BEYOND
            ends = axis.place(np.array([lowest, BEYOND]))
            cell, fraction = cell_and_fraction(ends, table.shape[1])
            up_to = between(table, cell, fraction)
            on_lines = up_to[:, 1] - up_to[:, 0]
            spacing = 1.0 / (len(table) - 1)
            inside = np.trapezoid(on_lines, dx=spacing)
            outside += max(0.0, 1.0 - float(inside))
        return outside

    def standard_error(self, by_batch: Array) -> Array:
        """Return the standard error of a mean over all draws, from batches on the last axis."""
        mean = by_batch @ self.shares
        weighted = (by_batch - mean[..., None]) * self.shares
        squares = np.sum(weighted**2, axis=-1)
        variance = squares * self.batch_count / (self.batch_count - 1.0)
        return np.asarray(np.sqrt(variance))

    def even(self, count: int) -> Points:
        """Return points that fill the plane evenly."""
        from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator

        places = np.outer(_EVEN, np.arange(0.5, count)) % 1.0
        k_axis, b_axis = self.axes
        grid = k_axis.places(), b_axis.places()
        # A spline of a narrow ridge falls below zero beside it.
        density = np.maximum(RectBivariateSpline(*grid, self.density).ev(*places), 0.0)
        by_batch = np.empty((count, 0))
        if self.batch_count:
            batches = np.moveaxis(self.batches, 0, -1)
            by_batch = RegularGridInterpolator(grid, batches)(places.T)
        return Points(
            k=k_axis.native(places[0]),
            b=b_axis.native(places[1]),
            probability=density / density.sum(),
            by_batch=by_batch / by_batch.sum(axis=0),
        )

    def ellipse(self, *, kind: Literal["mean", "user"], level: float, n: int) -> EllipseRegion:
        """Return the ellipse that holds a level of the law, out to a Mahalanobis distance."""
        unit = EllipseRegion(
            kind=kind,
            method="bayesian",
            family=self.family,
            level=level,
            centre=self.mean,
            shape=self.covariance,
            radius=1.0,
            n=n,
        )
        points = self.even(_ELLIPSE_POINTS)
        distance = unit.distance(points.k, points.b)
        order = np.argsort(distance)
        inside = np.cumsum(points.probability[order])
        requested = level * inside[-1]
        radius = np.interp(requested, inside, distance[order])
        return replace(unit, radius=float(radius))


@dataclass(frozen=True, eq=False)
class _Normals:
    """S normals of (k, b) in the units of the axes: b, and k by regression on it."""

    k_mean: Array  # (S,)
    b_mean: Array  # (S,)
    b_variance: Array  # (S,)
    slope: Array  # (S,) of k on b
    remainder: Array  # (S,) variance of k given b

    @classmethod
    def of(cls, mean: Array, covariance: Array, axes: tuple[Axis, Axis]) -> _Normals:
        """Take means (S, 2) and covariances (S, 2, 2)."""
        centre = np.array([axis.centre for axis in axes])
        unit = np.array([axis.unit for axis in axes])
        scaled = (mean - centre) / unit
        scaled_covariance = covariance / np.multiply.outer(unit, unit)
        k_variance = scaled_covariance[:, 0, 0]
        b_variance = scaled_covariance[:, 1, 1]
        both = scaled_covariance[:, 0, 1]
        slope = both / b_variance
        least = _LEAST_REMAINDER * k_variance
        remainder = np.maximum(k_variance - slope * both, least)
        return cls(scaled[:, 0], scaled[:, 1], b_variance, slope, remainder)


def mixture_law(mean: Array, covariance: Array, batch: Indices, family: Family) -> PairLaw:
    """Return the law of S normals of k and b, or of their logarithms, with equal weights.

    Parameters
    ----------
    mean : ndarray, shape (S, 2)
        Means of stiffness and damping, N/m and N·s/m; of the logarithms if `family` says so.
    covariance : ndarray, shape (S, 2, 2)
        Their covariances.
    batch : ndarray, shape (S,)
        Number of the batch that each draw belongs to, from 0.
    family : str
        "normal" or "lognormal".

    Returns
    -------
    PairLaw
    """
    centre = mean.mean(axis=0)
    between_draws = np.cov(mean.T, bias=True)
    total_covariance = between_draws + covariance.mean(axis=0)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    sd = np.sqrt(variance)
    step = 1 + len(mean) // _BEND_DRAWS
    *bends, _ = mixture_limits(mean[::step], sd[::step], _BEND_TAIL)
    # A few wide draws decide where an axis ends. What lies beyond the grid is lost: all are asked.
    *ends, _ = mixture_limits(mean, sd, _END_TAIL)
    axes = _axes(total_covariance, np.array(bends), np.array(ends), family)
    order = np.argsort(batch, kind="stable")
    sizes = np.bincount(batch)
    normals = _Normals.of(mean[order], covariance[order], axes)
    density = _mixture_density(normals, sizes, axes)
    shares = sizes / sizes.sum()
    return _normalised_law(density, shares, axes, centre, total_covariance, family)


def _mixture_density(normals: _Normals, sizes: Indices, axes: tuple[Axis, Axis]) -> Array:
    """Sum the densities of S normals batch by batch, (B, K, L), on the axes' grids."""
    k = np.sinh(axes[0].grid)
    b = np.sinh(axes[1].grid)
    precision = np.sqrt(0.5 / normals.remainder)
    log_height = -0.5 * np.log(normals.b_variance * normals.remainder)
    ends = np.cumsum(sizes)
    starts = ends - sizes
    density = np.empty((sizes.size, k.size, b.size))
    # In single precision exponentials take a fifth of the time, and keep seven digits. Far out a
    # square may pass what it holds: its exponential is zero.
    with np.errstate(over="ignore"):
        scaled = np.multiply.outer(k, precision).astype(np.float32)
        terms = np.empty_like(scaled)
        for column, b_value in enumerate(b):
            off = b_value - normals.b_mean
            k_given_b = (normals.k_mean + normals.slope * off) * precision
            log_of_b = log_height - 0.5 * off * off / normals.b_variance
            np.subtract(scaled, k_given_b.astype(np.float32), out=terms)
            terms *= terms
            np.subtract(log_of_b.astype(np.float32), terms, out=terms)
            np.maximum(terms, _LEAST_LOG_DENSITY, out=terms)
            np.exp(terms, out=terms)
            sums = np.add.reduceat(terms, starts, axis=1)
            density[:, :, column] = sums.T
    return density


def _axes(covariance: Array, bends: Array, ends: Array, family: Family) -> tuple[Axis, Axis]:
    """Lay both axes over a law by its quantiles (side, axis); finer where k and b correlate."""
    variances = covariance[0, 0] * covariance[1, 1]
    rho = covariance[0, 1] / np.sqrt(variances)
    ridge = _RIDGE * np.sqrt(max(0.0, 1.0 - rho * rho))
    step = _STEP * min(1.0, max(_FINEST, ridge))
    log = family == "lognormal"
    axes = []
    for index in (0, 1):
        left, right = bends[:, index]
        centre = 0.5 * (left + right)
        unit = 0.5 * (right - left)
        units_off = (ends[:, index] - centre) / unit
        low, high = np.arcsinh(units_off).tolist()
        blocks = np.ceil((high - low) / step / _BLOCK)
        size = _BLOCK * int(blocks) + 1
        axis = Axis(float(centre), float(unit), low, high, size, log)
        axes.append(axis)
    return axes[0], axes[1]


def _normalised_law(
    batches: Array,
    shares: Array,
    axes: tuple[Axis, Axis],
    mean: Array,
    covariance: Array,
    family: Family,
) -> PairLaw:
    """Put densities over the bent coordinates on the axes' places, each with the integral one."""
    from scipy.interpolate import CubicSpline

    k_axis, b_axis = axes
    # k and b are hyperbolic sines of the coordinates, which run evenly with the places.
    k_rate = np.cosh(k_axis.grid)
    b_rate = np.cosh(b_axis.grid)
    batches = batches * np.multiply.outer(k_rate, b_rate)
    density = batches.sum(axis=0)
    over_k = CubicSpline(k_axis.places(), density).integrate(0.0, 1.0)
    over_both = CubicSpline(b_axis.places(), over_k).integrate(0.0, 1.0)
    density /= over_both
    lines = np.trapezoid(batches, dx=k_axis.step, axis=1)
    sums = np.trapezoid(lines, dx=b_axis.step)
    batches /= np.reshape(sums, (-1, 1, 1))
    drawn = batches[: shares.size]
    return PairLaw(family, mean, covariance, axes, density, drawn, shares)


def confidence_law(
    stiffness: ArrayLike, damping: ArrayLike, *, kind: str, family: Family
) -> PairLaw:
    """Return the law of (k, b) behind the classical intervals.

    Parameters
    ----------
    stiffness, damping : array_like, shape (N,)
        One value per subject, N/m and N·s/m.
    kind : str
        "mean" for the average user, else the next user.
    family : str
        "normal" or "lognormal".

    Returns
    -------
    PairLaw

    Raises
    ------
    RefusalError
        Fewer than three subjects, or no scatter between them.
    """
    positive = family == "lognormal"
    k = sample(stiffness, positive=positive, least=3)
    b = sample(damping, positive=positive, least=3)
    values = np.log([k, b]) if positive else np.stack([k, b])
    n = k.size
    mean = values.mean(axis=1)
    covariance = np.cov(values)
    if not np.all(np.diagonal(covariance) > 0.0):
        raise RefusalError("there is no scatter: all subjects made the same adjustments.")
    covariance *= 1.0 / n + (kind != "mean")
    sd = np.sqrt(np.diagonal(covariance))
    bend = -special.stdtrit(n - 1, _BEND_TAIL) * sd
    end = -special.stdtrit(n - 1, _END_TAIL) * sd
    bends = np.stack([mean - bend, mean + bend])
    ends = np.stack([mean - end, mean + end])
    axes = _axes(covariance, bends, ends, family)
    normal = _Normals.of(mean[None], covariance[None], axes)
    k = np.sinh(axes[0].grid)[:, None]
    b_off = np.sinh(axes[1].grid) - normal.b_mean
    k_off = k - normal.k_mean - normal.slope * b_off
    square = k_off**2 / normal.remainder + b_off**2 / normal.b_variance
    # The bivariate t of n - 1 degrees of freedom, but for its constant.
    degrees = n - 1.0
    density = (1.0 + square / degrees) ** (-0.5 * (degrees + 2.0))
    return _normalised_law(density[None], np.empty(0), axes, mean, covariance, family)


def cell_and_fraction(place: Array, points: int) -> tuple[Indices, Array]:
    """Return the point of a table before each place, and how far on to the next the place lies.

    A place is 0 at the first of the table's points and 1 at its last.
    """
    scaled = place * (points - 1)
    cell = np.minimum(scaled.astype(np.intp), points - 2)
    return cell, scaled - cell


def between(values: Array, cell: Indices, fraction: Array) -> Array:
    """Interpolate values in cells along their last axis, each so far in as its fraction says."""
    before = values.take(cell, axis=-1)
    after = values.take(cell + 1, axis=-1)
    return np.asarray(before + fraction * (after - before))
