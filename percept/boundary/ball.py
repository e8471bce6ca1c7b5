"""Probability that abs(Z_h) is at most a radius, from the joint law of k and b.

At one frequency abs(Z_h)² = u² + v², with u = g·k + o of stiffness and v = g'·b + o' of damping. So
abs(Z_h) <= r is a ball in the plane of u and v. Either of k and b may be the outer variable; say b.
Given b the ball leaves k an interval, whose ends lie where u is a leg of either sign:

    leg(b) = sqrt(r² - v²)
    P(abs(Z_h) <= r) = integral over b of  F(k at u = leg, b) - F(k at u = -leg, b)

The law's tables hold F(k, b), the probability density of b times that of a smaller k given b, over
places: a place runs from 0 to 1 along the grid of k or b. What is left is one smooth integral, by
Gauss-Legendre. Its slope in log r comes with it: the leg grows by r²/leg.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from percept.boundary.law import BEYOND, Axis, PairLaw, between, cell_and_fraction
from percept.haptics.loop import Loop
from percept.haptics.perceived import DistancePlane

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Nodes of the integral. Laws of three subjects have tails that 24 nodes miss by a fifth.
_NODE_COUNT = 48
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_NODE_COUNT)
# An interval ends like a square root where its ball ends. Nodes even in the angle take that out.
_ANGLES = 0.5 * np.pi * _NODES
_SINE_NODES = np.sin(_ANGLES)
_SINE_WEIGHTS = 0.5 * np.pi * _WEIGHTS * np.cos(_ANGLES)
# An integrand that holds much of so many highest Legendre polynomials is rough: an eighth of all.
_ROUGHNESS_ORDERS = 6
_POLYNOMIALS = np.polynomial.legendre.legvander(_NODES, _NODE_COUNT - 1)
_HIGHEST_POLYNOMIALS = _POLYNOMIALS[:, -_ROUGHNESS_ORDERS:]
# Balls that hold more are worked out by what they leave out, which alone has digits in the tail.
# The jump at this content moves no limit: upper limits hold more than half, lower ones less, and a
# search needs only the side right.
_LARGE_BALL = 0.5
# Squares of magnitudes, (N·s/m)², below this count as zero: it still has a logarithm.
_LEAST_SQUARE = BEYOND**-2


@dataclass(frozen=True, eq=False)
class AxisTerm:
    """One of the two terms of abs(Z_h)² at frequencies: gain·value + offset, of k or of b."""

    axis: Axis
    gain: Array  # (M,) above zero
    offset: Array  # (M,) N·s/m

    def rows(self, frequency: Indices) -> AxisTerm:
        """Return the term at some of its frequencies, a row for each, (Q, 1)."""
        gain = self.gain[frequency, None]
        return AxisTerm(self.axis, gain, self.offset[frequency, None])

    def of_place(self, place: Array) -> Array:
        """Return the term at places on the axis, N·s/m."""
        return self.gain * self.axis.native(place) + self.offset

    def sizes(self) -> tuple[Array, Array]:
        """Return the smallest and the largest size of the term on the axis's grid, N·s/m."""
        lowest = self.of_place(np.zeros(1))
        highest = self.of_place(np.ones(1))
        # Where the term changes its sign it is zero in between.
        smallest = np.maximum(0.0, np.maximum(lowest, -highest))
        largest = np.maximum(-lowest, highest)
        return smallest, largest

    def native(self, term: Array) -> Array:
        """Return the k or b that makes a term so large."""
        return (term - self.offset) / self.gain

    def place(self, term: Array) -> Array:
        """Return where on the axis a term is so large."""
        return self.axis.place(self.native(term))

    def rate(self, place: Array, term: Array) -> Array:
        """Return how fast the place moves with the term."""
        per_value = self.axis.rate(place, self.native(term))
        return per_value / self.gain


class Content(NamedTuple):
    """What Q balls hold."""

    probability: Array  # (Q,)
    slope: Array  # (Q,) in the log radius
    roughness: Array  # (Q,) of the slope's integrand, as a fraction of the slope


@dataclass(frozen=True, eq=False)
class _Slices:
    """Intervals of the inner value that Q balls leave at J nodes of the outer one."""

    span: Array  # (Q, 2) first and last outer place in the ball
    outer: Array  # (Q, J) places of the nodes on the outer axis
    weights: Array  # (Q, J) of the nodes
    #: Where the inner intervals end on the inner axis, and how fast that moves out with the log
    #: radius, (Q, J) each.
    left: tuple[Array, Array]
    right: tuple[Array, Array]

    def integral(self, values: Array) -> Array:
        """Integrate values (Q, J) at the nodes over the outer axis, (Q,)."""
        sums = np.einsum("qj,qj->q", self.weights, values)
        return np.asarray(sums)


class Balls:
    """Balls of abs(Z_h) at frequencies (M,), rad/s, and what a law of (k, b) puts into them."""

    def __init__(
        self,
        law: PairLaw,
        loop: Loop,
        omega: Array,
        *,
        mass: float,
    ) -> None:
        plane = DistancePlane.of(loop.at(omega), mass).flat()
        # At Nyquist a mass is infinite, whatever k and b are.
        finite = np.isfinite(plane.real) & np.isfinite(plane.imaginary)
        finite &= plane.gain > 0
        finite &= plane.per_rate > 0
        k_axis, b_axis = law.axes
        self.law = law
        self.finite = finite  # (M,) frequencies that have balls; all that follows is about them
        self.plane = plane.select(finite)
        of_k, of_b = self.plane.terms()
        self.k = AxisTerm(k_axis, *of_k)
        self.b = AxisTerm(b_axis, *of_b)
        self.count = int(finite.sum())

    def log_range(self) -> tuple[Array, Array]:
        """Return the smallest and the largest log abs(Z_h) on the law's grid, (M,) each."""
        k_smallest, k_largest = self.k.sizes()
        b_smallest, b_largest = self.b.sizes()
        smallest = k_smallest**2 + b_smallest**2
        largest = k_largest**2 + b_largest**2
        squares = np.maximum([smallest, largest], _LEAST_SQUARE)
        low, high = 0.5 * np.log(squares)
        return low, high

    def smoother_inner(self, frequency: Indices, radius: Array) -> Indices:
        """Return which of k (0) and b (1) makes the smoother integral as inner variable, (Q,)."""
        k_inner = self.content_by(0, frequency, radius)
        b_inner = self.content_by(1, frequency, radius)
        roughness = [k_inner.roughness, b_inner.roughness]
        return np.argmin(roughness, axis=0)

    def content(
        self,
        frequency: Indices,
        radius: Array,
        inner_of: Indices,
    ) -> Content:
        """Return what balls (Q,) hold; the inner variable is k where `inner_of` is 0, b where 1."""
        content = np.zeros((len(Content._fields), frequency.size))
        for inner in (0, 1):
            (rows,) = np.nonzero(inner_of == inner)
            if rows.size:
                found = self.content_by(inner, frequency[rows], radius[rows])
                content[:, rows] = found
        return Content(*content)

    def content_by(
        self,
        inner: int,
        frequency: Indices,
        radius: Array,
    ) -> Content:
        """Return what balls (Q,) hold, integrating over the variable that is not `inner`."""
        slices = self._slices(inner, frequency, radius)
        table = self.law.cumulated[inner]
        row, fraction = cell_and_fraction(slices.outer, len(table))
        left, left_rate = slices.left
        right, right_rate = slices.right
        up_to_left, left_rise = _interpolate(table, row, fraction, left)
        up_to_right, right_rise = _interpolate(table, row, fraction, right)
        probability = slices.integral(up_to_right) - slices.integral(up_to_left)
        missed = self._missed(inner, slices)
        probability += np.where(probability > _LARGE_BALL, missed, 0.0)
        growth = left_rate * left_rise + right_rate * right_rise
        cells = table.shape[1] - 1  # A rise is over one cell, a rate over the whole axis
        slopes = slices.weights * growth * cells
        slope = slopes.sum(axis=1)
        components = np.abs(slopes @ _HIGHEST_POLYNOMIALS)
        highest = components.sum(axis=1)
        # Without a slope at any node all of it lies between them.
        infinite = np.full(slope.shape, np.inf)
        is_known = slope > 0.0
        roughness = np.divide(highest, slope, out=infinite, where=is_known)
        return Content(probability, slope, roughness)

    def _missed(self, inner: int, slices: _Slices) -> Array:
        """Return how much of the outer variable's probability the nodes miss, (Q,).

        In a large ball what it leaves out is what counts. The outer variable's own distribution is
        known exactly.
        """
        from scipy import integrate  # slow to import, and no fit needs it

        marginal = self.law.cumulated[inner][:, -1]
        step = 1.0 / (marginal.size - 1)
        up_to_row = integrate.cumulative_trapezoid(marginal, dx=step, initial=0)
        row, fraction = cell_and_fraction(slices.outer, marginal.size)
        by_nodes = slices.integral(between(marginal, row, fraction))
        # The marginal density is straight between the table's rows, as it is for the nodes.
        row, fraction = cell_and_fraction(slices.span, marginal.size)
        mean_density = between(marginal, row, 0.5 * fraction)
        up_to_end = up_to_row[row] + fraction * mean_density * step
        exact = up_to_end[:, 1] - up_to_end[:, 0]
        return np.asarray(exact - by_nodes)

    def _slices(
        self,
        inner: int,
        frequency: Indices,
        radius: Array,
    ) -> _Slices:
        """Lay nodes over the outer variable's span in each ball, and find the inner intervals."""
        terms = (self.k, self.b)
        inner_term = terms[inner].rows(frequency)
        outer_term = terms[1 - inner].rows(frequency)
        radius = radius[:, None]
        # Where the inner term cannot be zero, the outer one does not reach the radius: nodes that
        # far out would be wasted.
        smallest, _ = inner_term.sizes()
        reach = _leg(radius, smallest)
        first = outer_term.place(-reach)
        last = outer_term.place(reach)
        half = 0.5 * (last - first)
        middle = 0.5 * (last + first)
        outer = middle + half * _SINE_NODES
        outer_size = np.abs(outer_term.of_place(outer))
        leg = _leg(radius, outer_size)
        return _Slices(
            span=np.concatenate([first, last], axis=1),
            outer=outer,
            weights=half * _SINE_WEIGHTS,
            left=_edge(inner_term, -leg, radius),
            right=_edge(inner_term, leg, radius),
        )


def _leg(radius: Array, other: Array) -> Array:
    """Return sqrt(radius² - other²), or zero; factors, as squares of extreme radii overflow."""
    difference = np.maximum(radius - other, 0.0)
    total = radius + other
    return np.asarray(np.sqrt(difference) * np.sqrt(total))


def _edge(term: AxisTerm, leg: Array, radius: Array) -> tuple[Array, Array]:
    """Return where the inner term is as large as a leg of either sign, and how fast that moves."""
    place = term.place(leg)
    with np.errstate(divide="ignore", invalid="ignore"):
        leg_rate = (radius / np.abs(leg)) * radius
        rate = term.rate(place, leg) * leg_rate
    # A leg of no length has no rate.
    rate[leg == 0.0] = 0.0
    return place, rate


def _interpolate(
    table: Array,
    row: Indices,
    row_fraction: Array,
    place: Array,
) -> tuple[Array, Array]:
    """Interpolate a table (rows, columns) between rows by fractions, and at places along these.

    The second array is the rise over the column that the place lies in.
    """
    columns = table.shape[1]
    column, fraction = cell_and_fraction(place, columns)
    flat = table.ravel()
    point = row * columns + column
    below = point + columns
    rest = 1.0 - row_fraction
    before = rest * flat.take(point)
    before += row_fraction * flat.take(below)
    after = rest * flat.take(point + 1)
    after += row_fraction * flat.take(below + 1)
    rise = after - before
    return before + fraction * rise, rise
