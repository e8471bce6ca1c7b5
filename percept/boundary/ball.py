"""Probability that abs(Z_h) is at most a radius, from the joint law of k and b.

abs(Z_h)² is (gain·k + offset)² + (gain·b + offset)². So abs(Z_h) <= radius is a ball in the plane
of the two terms. Given one of k and b, called the outer one, the ball leaves an interval of the
other, the inner one. The probability of that interval is a difference of two cumulated densities
from the law's tables. What is left is one smooth integral over the outer one, by Gauss-Legendre.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, sparse

from percept.boundary.law import BEYOND, PairLaw, steps
from percept.haptics.impedance import warp
from percept.haptics.perceived import DistancePlane
from percept.haptics.records import AnyDevice

__all__ = ["Balls", "Content"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Laws of three subjects have tails that 24 nodes miss by a fifth.
_NODE_COUNT = 48
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_NODE_COUNT)
# An interval ends like a square root where its ball ends. Nodes even in the angle take that out.
_SINE_NODES = np.sin(0.5 * np.pi * _NODES)
_SINE_WEIGHTS = 0.5 * np.pi * _WEIGHTS * np.cos(0.5 * np.pi * _NODES)
# Legendre polynomials of the six highest orders: an integrand that holds much of them is rough.
_HIGHEST_ORDERS = np.polynomial.legendre.legvander(_NODES, _NODE_COUNT - 1)[:, -6:]
# Both ends of an interval, each between two rows and two columns of a table.
_TERMS_PER_NODE = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Content:
    """What Q balls hold."""

    probability: Array  # (Q,)
    slope: Array  # (Q,) in the log radius
    roughness: Array  # (Q,) of the slope's integrand, as a fraction of the slope


@dataclasses.dataclass(frozen=True, eq=False)
class _Slices:
    """Intervals of the inner value that Q balls leave at J nodes of the outer one.

    All are places on the axes of the law, from 0 to 1.
    """

    span: Array  # (Q, 2) first and last outer place in the ball
    outer: Array  # (Q, J) the nodes
    weights: Array  # (Q, J) of the nodes
    left: Array  # (Q, J) where the interval begins
    right: Array  # (Q, J) where it ends
    left_rate: Array  # (Q, J) how fast `left` falls with the log radius
    right_rate: Array  # (Q, J) how fast `right` grows with it


class Balls:
    """Balls of abs(Z_h) at frequencies (M,), rad/s, and what a law of (k, b) puts into them."""

    def __init__(
        self,
        law: PairLaw,
        device: AnyDevice,
        period: float,
        omega: Array,
        *,
        mass: float,
        hold: str,
    ) -> None:
        plane = DistancePlane.of(warp(omega, period), device, hold, mass)
        gains = [np.broadcast_to(gain, omega.shape) for gain in (plane.per_rate, plane.gain)]
        offsets = [np.broadcast_to(part, omega.shape) for part in (-plane.imaginary, plane.real)]
        # At Nyquist a mass is infinite, whatever k and b are.
        finite = np.isfinite(offsets).all(axis=0) & (np.array(gains) > 0).all(axis=0)
        self.law = law
        self.finite = finite  # (M,) frequencies that have balls; all that follows is about them
        self.gains = np.stack(gains)[:, finite]  # of k and of b
        self.offsets = np.stack(offsets)[:, finite]
        self.count = int(finite.sum())

    def range(self) -> tuple[Array, Array]:
        """Return the smallest and the largest log abs(Z_h) on the law's grid, (M,) each."""
        smallest = np.zeros(self.count)
        largest = np.zeros(self.count)
        for axis, gain, offset in zip(self.law.axes, self.gains, self.offsets, strict=True):
            ends = np.multiply.outer(axis.native(np.array([0.0, 1.0])), gain) + offset
            reaches_zero = ends[0] * ends[1] <= 0.0
            distances = np.abs(ends)
            smallest += np.where(reaches_zero, 0.0, distances.min(axis=0)) ** 2
            largest += distances.max(axis=0) ** 2
        least = BEYOND**-2
        low = 0.5 * np.log(np.maximum(smallest, least))
        high = 0.5 * np.log(np.maximum(largest, least))
        return low, high

    def squares(self, k: Array, b: Array) -> Array:
        """Return abs(Z_h)² (M, N) of N points."""
        squares = (self.gains[0, :, None] * k + self.offsets[0, :, None]) ** 2
        squares += (self.gains[1, :, None] * b + self.offsets[1, :, None]) ** 2
        return squares

    def smoother_inner(self, frequency: Indices, radius: Array) -> Indices:
        """Return which of k (0) and b (1) makes the smoother integral as the inner one, (Q,)."""
        roughness = [self.content_by(inner, frequency, radius).roughness for inner in (0, 1)]
        return np.argmin(roughness, axis=0)

    def content(self, frequency: Indices, radius: Array, inner_of: Indices) -> Content:
        """Return what balls (Q,) hold, the inner one being k where `inner_of` is 0, b where it is 1."""
        probability, slope, roughness = np.zeros((3, frequency.size))
        for inner in (0, 1):
            (rows,) = np.nonzero(inner_of == inner)
            if rows.size:
                content = self.content_by(inner, frequency[rows], radius[rows])
                probability[rows] = content.probability
                slope[rows] = content.slope
                roughness[rows] = content.roughness
        return Content(probability, slope, roughness)

    def content_by(self, inner: int, frequency: Indices, radius: Array) -> Content:
        """Return what balls (Q,) hold, integrated over the other one than `inner`."""
        slices = self._slices(inner, frequency, radius)
        table = self.law.cumulated[inner]
        row, over = steps(slices.outer, len(table))
        before_left, rise_left = _between_rows(table, row, over, slices.left)
        before_right, rise_right = _between_rows(table, row, over, slices.right)
        probability = np.einsum("qj,qj->q", slices.weights, before_right)
        probability -= np.einsum("qj,qj->q", slices.weights, before_left)
        rates = slices.left_rate * rise_left + slices.right_rate * rise_right
        slopes = slices.weights * rates * (table.shape[1] - 1)
        probability += np.where(probability > 0.5, self._missed(inner, slices), 0.0)
        slope = slopes.sum(axis=1)
        highest = np.abs(slopes @ _HIGHEST_ORDERS).sum(axis=1)
        # Without a slope at any node all of it lies between them.
        infinite = np.full(slope.shape, np.inf)
        roughness = np.divide(highest, slope, out=infinite, where=slope > 0.0)
        return Content(probability, slope, roughness)

    def content_by_batch(self, frequency: Indices, radius: Array, inner_of: Indices) -> Array:
        """Return what balls (Q,) hold of all draws and of each batch, (Q, 1 + B).

        The tables of batches are coarser, which is enough for differences between them.
        """
        content = np.empty((frequency.size, 1 + self.law.shares.size))
        for inner in (0, 1):
            (rows,) = np.nonzero(inner_of == inner)
            content[rows] = self._by_batch(inner, frequency[rows], radius[rows])
        return content

    def _missed(self, inner: int, slices: _Slices) -> Array:
        """Return how much of the outer one's probability the nodes miss, (Q,).

        In a large ball what it leaves out is what counts. All digits of the outer one's own
        distribution are known.
        """
        margin = self.law.cumulated[inner][:, -1]
        step = 1.0 / (margin.size - 1)
        cumulated = integrate.cumulative_trapezoid(margin, dx=step, initial=0)
        row, over = steps(slices.outer, margin.size)
        density = margin[row] + over * (margin[row + 1] - margin[row])
        by_nodes = np.einsum("qj,qj->q", slices.weights, density)
        # The margin is straight between the table's rows, as it is for the nodes.
        row, over = steps(slices.span, margin.size)
        rest = over * (margin[row] + 0.5 * over * (margin[row + 1] - margin[row]))
        exact = cumulated[row] + rest * step
        return np.asarray(exact[:, 1] - exact[:, 0] - by_nodes)

    def _slices(self, inner: int, frequency: Indices, radius: Array) -> _Slices:
        """Lay nodes over the outer one's span in each ball, and find the inner one's intervals."""
        inner_axis = self.law.axes[inner]
        outer_axis = self.law.axes[1 - inner]
        inner_gain = self.gains[inner, frequency, None]
        inner_offset = self.offsets[inner, frequency, None]
        outer_gain = self.gains[1 - inner, frequency, None]
        outer_offset = self.offsets[1 - inner, frequency, None]
        radius = radius[:, None]
        # The inner term's least size leaves less to the outer one. Nodes beyond would be wasted.
        inner_ends = inner_gain * inner_axis.native(np.array([0.0, 1.0])) + inner_offset
        least = np.maximum(0.0, np.maximum(inner_ends[:, :1], -inner_ends[:, 1:]))
        reach = _leg(radius, least)
        first = outer_axis.place((-reach - outer_offset) / outer_gain)
        last = outer_axis.place((reach - outer_offset) / outer_gain)
        half = 0.5 * (last - first)
        outer = 0.5 * (last + first) + half * _SINE_NODES
        outer_term = outer_gain * outer_axis.native(outer) + outer_offset
        leg = _leg(radius, np.abs(outer_term))
        left_native = (-leg - inner_offset) / inner_gain
        right_native = (leg - inner_offset) / inner_gain
        left = inner_axis.place(left_native)
        right = inner_axis.place(right_native)
        with np.errstate(divide="ignore", invalid="ignore"):
            native_rate = (radius / leg) * (radius / inner_gain)
            left_rate = inner_axis.rate(left, left_native) * native_rate
            right_rate = inner_axis.rate(right, right_native) * native_rate
        return _Slices(
            span=np.concatenate([first, last], axis=1),
            outer=outer,
            weights=half * _SINE_WEIGHTS,
            left=left,
            right=right,
            left_rate=np.where(leg > 0.0, left_rate, 0.0),
            right_rate=np.where(leg > 0.0, right_rate, 0.0),
        )

    def _by_batch(self, inner: int, frequency: Indices, radius: Array) -> Array:
        """Do the sums of all batches as one product with a sparse matrix of interpolation weights."""
        slices = self._slices(inner, frequency, radius)
        table = self.law.by_batch[inner]
        row, over = steps(slices.outer, len(table))
        weights = []
        cells = []
        for sign, end in ((-1.0, slices.left), (1.0, slices.right)):
            column, part = steps(end, table.shape[1])
            for down, along in ((0, 1.0 - over), (1, over)):
                for right, across in ((0, 1.0 - part), (1, part)):
                    weights.append(sign * slices.weights * along * across)
                    cells.append((row + down) * table.shape[1] + column + right)
        flat = table.reshape(-1, table.shape[2])
        starts = _TERMS_PER_NODE * _NODE_COUNT * np.arange(frequency.size + 1)
        entries = np.concatenate(weights, axis=1).ravel()
        columns = np.concatenate(cells, axis=1).ravel()
        matrix = sparse.csr_array((entries, columns, starts), (frequency.size, len(flat)))
        return np.asarray(matrix @ flat)


def _leg(radius: Array, other: Array) -> Array:
    """Return sqrt(radius² - other²), or zero; by factors, since squares of extreme radii overflow."""
    return np.asarray(np.sqrt(np.maximum(radius - other, 0.0)) * np.sqrt(radius + other))


def _between_rows(table: Array, row: Indices, over: Array, place: Array) -> tuple[Array, Array]:
    """Interpolate a table at places: the values, and how much they rise over one column."""
    column, part = steps(place, table.shape[1])
    index = row * table.shape[1] + column
    flat = table.ravel()

    def at_column(offset: int) -> Array:
        upper = flat.take(index + offset)
        lower = flat.take(index + offset + table.shape[1])
        return (1.0 - over) * upper + over * lower

    before = at_column(0)
    rise = at_column(1) - before
    return before + part * rise, rise
