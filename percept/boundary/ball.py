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

from percept.boundary.law import BEYOND, Axis, PairLaw, steps
from percept.haptics.impedance import warp
from percept.haptics.perceived import DistancePlane
from percept.haptics.records import AnyDevice

__all__ = ["Balls", "Content", "Term"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
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
class Term:
    """One of the two terms of abs(Z_h)² at frequencies: gain·value + offset, of k or of b."""

    axis: Axis
    gain: Array  # (M,) above zero
    offset: Array  # (M,) N·s/m

    def at(self, chosen: Indices | Flags | slice) -> Term:
        """Return the term at some of its frequencies."""
        return Term(self.axis, self.gain[chosen], self.offset[chosen])

    def by_row(self) -> Term:
        """Return the term with a row for each frequency, (M, 1)."""
        return Term(self.axis, self.gain[:, None], self.offset[:, None])

    def of_place(self, place: Array) -> Array:
        """Return the term at places on the axis, N·s/m."""
        return self.gain * self.axis.native(place) + self.offset

    def native(self, term: Array) -> Array:
        """Return the k or b that makes a term so large."""
        return (term - self.offset) / self.gain

    def place(self, term: Array) -> Array:
        """Return where on the axis a term is so large."""
        return self.axis.place(self.native(term))

    def rate(self, place: Array, term: Array) -> Array:
        """Return how fast the place moves with the term."""
        return self.axis.rate(place, self.native(term)) / self.gain


@dataclasses.dataclass(frozen=True, eq=False)
class Content:
    """What Q balls hold."""

    probability: Array  # (Q,)
    slope: Array  # (Q,) in the log radius
    roughness: Array  # (Q,) of the slope's integrand, as a fraction of the slope


@dataclasses.dataclass(frozen=True, eq=False)
class _Edge:
    """Where the inner intervals of Q balls end on one side, at J nodes."""

    place: Array  # (Q, J) on the inner axis
    rate: Array  # (Q, J) how fast it moves out with the log radius


@dataclasses.dataclass(frozen=True, eq=False)
class _Slices:
    """Intervals of the inner value that Q balls leave at J nodes of the outer one."""

    span: Array  # (Q, 2) first and last outer place in the ball
    outer: Array  # (Q, J) places of the nodes on the outer axis
    weights: Array  # (Q, J) of the nodes
    left: _Edge
    right: _Edge

    def integral(self, values: Array) -> Array:
        """Integrate values (Q, J) at the nodes over the outer axis, (Q,)."""
        return np.asarray(np.einsum("qj,qj->q", self.weights, values))


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
        k_gain = np.broadcast_to(plane.per_rate, omega.shape)
        b_gain = np.broadcast_to(plane.gain, omega.shape)
        k_offset = np.broadcast_to(-plane.imaginary, omega.shape)
        b_offset = np.broadcast_to(plane.real, omega.shape)
        # At Nyquist a mass is infinite, whatever k and b are.
        finite = np.isfinite(k_offset) & np.isfinite(b_offset)
        finite &= (k_gain > 0) & (b_gain > 0)
        k_axis, b_axis = law.axes
        self.law = law
        self.finite = finite  # (M,) frequencies that have balls; all that follows is about them
        self.k = Term(k_axis, k_gain[finite], k_offset[finite])
        self.b = Term(b_axis, b_gain[finite], b_offset[finite])
        self.count = int(finite.sum())

    def range(self) -> tuple[Array, Array]:
        """Return the smallest and the largest log abs(Z_h) on the law's grid, (M,) each."""
        smallest = np.zeros(self.count)
        largest = np.zeros(self.count)
        for term in (self.k, self.b):
            first = term.of_place(np.zeros(1))
            last = term.of_place(np.ones(1))
            nearest = np.minimum(np.abs(first), np.abs(last))
            smallest += np.where(first * last > 0.0, nearest, 0.0) ** 2
            largest += np.maximum(np.abs(first), np.abs(last)) ** 2
        least = BEYOND**-2
        low = 0.5 * np.log(np.maximum(smallest, least))
        high = 0.5 * np.log(np.maximum(largest, least))
        return low, high

    def squares(self, k: Array, b: Array) -> Array:
        """Return abs(Z_h)² (M, N) of N points."""
        k_term = self.k.gain[:, None] * k + self.k.offset[:, None]
        b_term = self.b.gain[:, None] * b + self.b.offset[:, None]
        return k_term**2 + b_term**2

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
        left = _interpolate(table, row, over, slices.left.place)
        right = _interpolate(table, row, over, slices.right.place)
        probability = slices.integral(right.value)
        probability -= slices.integral(left.value)
        probability += np.where(probability > 0.5, self._missed(inner, slices), 0.0)
        rates = slices.left.rate * left.rise + slices.right.rate * right.rise
        slopes = slices.weights * rates * (table.shape[1] - 1)
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
        by_nodes = slices.integral(density)
        # The margin is straight between the table's rows, as it is for the nodes.
        row, over = steps(slices.span, margin.size)
        rest = over * (margin[row] + 0.5 * over * (margin[row + 1] - margin[row]))
        exact = cumulated[row] + rest * step
        return np.asarray(exact[:, 1] - exact[:, 0] - by_nodes)

    def _slices(self, inner: int, frequency: Indices, radius: Array) -> _Slices:
        """Lay nodes over the outer one's span in each ball, and find the inner one's intervals."""
        terms = (self.k.at(frequency).by_row(), self.b.at(frequency).by_row())
        inner_term = terms[inner]
        outer_term = terms[1 - inner]
        radius = radius[:, None]
        # The inner term's least size leaves less to the outer one. Nodes beyond would be wasted.
        lowest = inner_term.of_place(np.zeros(1))
        highest = inner_term.of_place(np.ones(1))
        least = np.maximum(0.0, np.maximum(lowest, -highest))
        reach = _leg(radius, least)
        first = outer_term.place(-reach)
        last = outer_term.place(reach)
        half = 0.5 * (last - first)
        outer = 0.5 * (last + first) + half * _SINE_NODES
        leg = _leg(radius, np.abs(outer_term.of_place(outer)))
        return _Slices(
            span=np.concatenate([first, last], axis=1),
            outer=outer,
            weights=half * _SINE_WEIGHTS,
            left=_edge(inner_term, -leg, radius),
            right=_edge(inner_term, leg, radius),
        )

    def _by_batch(self, inner: int, frequency: Indices, radius: Array) -> Array:
        """Do the sums of all batches as one product with a sparse matrix of interpolation weights."""
        slices = self._slices(inner, frequency, radius)
        table = self.law.by_batch[inner]
        row, over = steps(slices.outer, len(table))
        weights = []
        cells = []
        for sign, edge in ((-1.0, slices.left), (1.0, slices.right)):
            column, part = steps(edge.place, table.shape[1])
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


def _edge(term: Term, leg: Array, radius: Array) -> _Edge:
    """Return where the inner term is as large as a leg of either sign."""
    place = term.place(leg)
    with np.errstate(divide="ignore", invalid="ignore"):
        leg_rate = (radius / np.abs(leg)) * radius
        rate = term.rate(place, leg) * leg_rate
    # A leg of no length has no rate.
    return _Edge(place, np.where(leg != 0.0, rate, 0.0))


@dataclasses.dataclass(frozen=True, eq=False)
class _Interpolated:
    """A table between its points."""

    value: Array
    rise: Array  # Over the column that the place lies in


def _interpolate(table: Array, row: Indices, over: Array, place: Array) -> _Interpolated:
    """Interpolate a table (rows, columns) so far over rows, and at places along its columns."""
    column, part = steps(place, table.shape[1])
    index = row * table.shape[1] + column
    before = _between_rows(table, index, over)
    rise = _between_rows(table, index + 1, over) - before
    return _Interpolated(before + part * rise, rise)


def _between_rows(table: Array, index: Indices, over: Array) -> Array:
    """Interpolate between points of a table, by number, and those one row on."""
    flat = table.ravel()
    return np.asarray((1.0 - over) * flat.take(index) + over * flat.take(index + table.shape[1]))
