"""Populations of users, normal laws of (k, b) or of their logarithms, and shares within abs(Z_h).

abs(Z_h) is a distance in the plane of (b, k/Omega), so the users with at most a given abs(Z_h) lie
in a disc. The share is an integral over one of k and b, by Gauss-Legendre nodes; the other has a
normal law given the first. `chosen_integrals` finds the fewest nodes that settle its digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.haptics.perceived import Boxes, DistancePlane, Range

Array = NDArray[np.float64]
#: Rows of a population's mean and SD.
STIFFNESS = 0
DAMPING = 1
#: Stands for a stiffness or damping of zero or less, which has no logarithm: no user is there.
LEAST = np.finfo(np.float64).tiny
#: Largest size of a logarithm of N/m or N·s/m: beyond it no impedance of interest changes.
_LARGEST_LOG = 90.0
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
#: Nodes tried, from the fewest on: two counts in a row that agree have settled. Narrow discs in
#: wide populations need the last.
_NODE_COUNTS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384)
#: Accuracy of shares: at the edge of a 99 % range 1e-5 of the users are 7e-4 SDs. Errors are far
#: smaller, as half as many nodes again add a digit.
_ACCURACY = 1e-5
#: SDs from the mean at which an integral ends: beyond each end may lie a twentieth of the accuracy.
_EDGE = float(-special.ndtri(0.05 * _ACCURACY))
#: Of the accuracy, by how much two counts in a row may differ: half as many nodes again gain little
#: where a disc ends at a slant.
_AGREEMENT = 0.25
_SQRT_2PI = float(np.sqrt(2.0 * np.pi))
#: Values of (shares, nodes) computed at once. Temporaries of 128 KiB or more come from fresh pages
#: of memory, and take twice as long.
_PASS = 15_000
#: Populations that show how the integral is best taken: it depends on the frequency far more.
_TRIED = 8


def score_of(level: float) -> float:
    """Return how many SDs from the median the central share `level` of a normal ends."""
    tail = 0.5 * (1.0 - level)
    return float(-special.ndtri(tail))


@dataclass(frozen=True, eq=False)
class Users:
    """Populations of users, one per draw (D,); stiffness first, damping second.

    The mean and the SD are of the logarithms where `log` is true, else in N/m and N·s/m.
    """

    log: bool
    mean: Array  # (2, D)
    sd: Array  # (2, D)
    correlation: Array  # (D,)

    @classmethod
    def of(
        cls,
        mean: Array,
        covariance: Array,
        *,
        log: bool,
    ) -> Users:
        """Take means (D, 2) and covariances (D, 2, 2).

        Logarithms beyond the range of impedances move to its end.
        """
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        sd = np.sqrt(variance)
        correlation = covariance[:, 0, 1] / sd.prod(axis=1)
        if log:
            mean = np.clip(mean, -_LARGEST_LOG, _LARGEST_LOG)
            sd = np.minimum(sd, _LARGEST_LOG)
        return cls(log=log, mean=mean.T, sd=sd.T, correlation=correlation)

    @property
    def size(self) -> int:
        """Number of populations, D."""
        return self.correlation.size

    def select(self, which: NDArray[np.intp] | slice | None) -> Users:
        """Return some of the populations."""
        return Users(
            log=self.log,
            mean=self.mean[..., which],
            sd=self.sd[..., which],
            correlation=self.correlation[..., which],
        )

    def typical(self) -> Users:
        """Return one population, of the median mean, SD and correlation."""
        mean = np.median(self.mean, axis=1, keepdims=True)
        sd = np.median(self.sd, axis=1, keepdims=True)
        return Users(self.log, mean, sd, np.median(self.correlation, keepdims=True))

    def column(self) -> Users:
        """Return the same with a last axis of one, which frequencies broadcast against."""
        return self.select(None)

    def score(self, value: float | Array, quantity: int) -> Array:
        """Return how many SDs a stiffness (0) or damping (1) lies above the mean, (D,)."""
        if self.log:
            value = np.log(np.maximum(value, LEAST))
        return np.asarray((value - self.mean[quantity]) / self.sd[quantity])

    def native(self, score: float, quantity: int) -> Array:
        """Return the stiffness (0) or damping (1) that lies `score` SDs from the mean, (D,)."""
        distance = score * self.sd[quantity]
        value = self.mean[quantity] + distance
        return np.exp(value) if self.log else value

    def central_ranges(self, level: float) -> Boxes:
        """Return the limits between which the central `level` of stiffness and of damping lie."""
        edge = score_of(level)
        limits = [
            Range(self.native(-edge, quantity), self.native(edge, quantity))
            for quantity in (STIFFNESS, DAMPING)
        ]
        return Boxes(*limits)


class DiscIntegral(NamedTuple):
    """How the integral over a disc is taken."""

    inner: int  # 0 where stiffness has its law given damping, 1 the other way round
    nodes: int  # Over the other quantity
    #: Even nodes from edge to edge, by far the best where the disc does not end between; else dense
    #: at the ends of the disc.
    even: bool = False


#: Those that are tried, in this order; an integral is known by its number.
_INTEGRALS = [
    DiscIntegral(inner, nodes, even)
    for nodes in _NODE_COUNTS
    for even in (True, False)
    for inner in (STIFFNESS, DAMPING)
]


class _Quantity(NamedTuple):
    """One quantity's term of the distance, gain·value + offset, and its law."""

    gain: Array
    offset: Array
    mean: Array
    sd: Array

    def beside_nodes(self) -> _Quantity:
        """Return all fields with a last axis of one, which nodes broadcast against."""
        return _Quantity(*(field[..., None] for field in self))

    def score_at(self, term: Array, *, log: bool) -> Array:
        """Return how many SDs from the mean the value lies that makes a term, N·s/m."""
        value = (term - self.offset) / self.gain
        if log:
            value = np.log(np.maximum(value, LEAST))
        return (value - self.mean) / self.sd

    def term_at(self, score: Array, *, log: bool) -> Array:
        """Return the term of a value `score` SDs from the mean, N·s/m."""
        value = self.mean + self.sd * score
        if log:
            value = np.exp(value)
        return self.gain * value + self.offset


@cache
def _nodes(count: int, *, even: bool) -> tuple[Array, Array]:
    """Return places from -1 to 1 and weights; even, or in the angle, as a disc ends like a root."""
    if even:
        places = np.linspace(-1.0, 1.0, count)
        spacing = 2.0 / (count - 1)
        return places, np.full(count, spacing)
    places, weights = special.roots_legendre(count)
    quarter = 0.5 * np.pi
    angle = quarter * places
    return np.sin(angle), quarter * np.cos(angle) * weights


def share_within(
    users: Users,
    plane: DistancePlane,
    radius: Array,
    integral: DiscIntegral,
) -> Array:
    """Return the share of each population with abs(Z_h) of at most `radius`, N·s/m.

    Fields of populations, plane and radius have shapes that broadcast; so has the result.
    """
    outer, inner = _outer_and_inner(users, plane, integral.inner)
    if integral.even:
        low = np.array(-_EDGE)
        high = -low
    else:
        low, high = _ends(outer, radius, log=users.log)
    half = 0.5 * (high - low)
    middle = 0.5 * (high + low)
    places, weights = _nodes(integral.nodes, even=integral.even)
    score = middle[..., None] + half[..., None] * places
    density = np.exp(-0.5 * score**2) / _SQRT_2PI
    outer = outer.beside_nodes()
    inner = inner.beside_nodes()
    chord = _chord(users, outer, inner, score, radius[..., None])
    integral_over_half = (density * chord) @ weights
    return np.asarray(half * integral_over_half)


def _outer_and_inner(users: Users, plane: DistancePlane, inner: int) -> tuple[_Quantity, _Quantity]:
    """Return the outer and the inner quantity of an integral."""
    of_stiffness, of_damping = plane.terms()
    stiffness = _Quantity(*of_stiffness, users.mean[STIFFNESS], users.sd[STIFFNESS])
    damping = _Quantity(*of_damping, users.mean[DAMPING], users.sd[DAMPING])
    return (stiffness, damping) if inner == DAMPING else (damping, stiffness)


def _ends(outer: _Quantity, radius: Array, *, log: bool) -> tuple[Array, Array]:
    """Return the scores of the outer quantity between which the disc lies, within the edges."""
    first = np.clip(outer.score_at(-radius, log=log), -_EDGE, _EDGE)
    second = np.clip(outer.score_at(radius, log=log), -_EDGE, _EDGE)
    return np.minimum(first, second), np.maximum(first, second)


def _chord(
    users: Users,
    outer: _Quantity,
    inner: _Quantity,
    score: Array,
    radius: Array,
) -> Array:
    """Return the probability of the inner quantity's chord through the disc at each outer score."""
    outer_leg = outer.term_at(score, log=users.log)
    rest = radius - outer_leg
    square = rest * (radius + outer_leg)
    leg = np.sqrt(np.maximum(square, 0.0))
    correlation = users.correlation[..., None]
    remainder = (1.0 - correlation) * (1.0 + correlation)
    given_outer = inner._replace(
        mean=inner.mean + (correlation * inner.sd) * score,
        sd=inner.sd * np.sqrt(remainder),
    )
    first = given_outer.score_at(-leg, log=users.log)
    second = given_outer.score_at(leg, log=users.log)
    return np.abs(special.ndtr(second) - special.ndtr(first))


def shares_of_cells(
    users: Users,
    plane: DistancePlane,
    radius: Array,
    integrals: Indices,
) -> Array:
    """Return the shares of n populations, each in a disc and by an integral of its own, (n,)."""
    shares = np.empty(radius.shape)
    for number in np.unique(integrals).tolist():
        (cells,) = np.nonzero(integrals == number)
        step = _PASS // _INTEGRALS[number].nodes
        for start in range(0, cells.size, step):
            part = cells[start : start + step]
            some = users.select(part)
            within = plane.select(part), radius[part]
            shares[part] = share_within(some, *within, _INTEGRALS[number])
    return shares


def shares_at_frequencies(
    users: Users,
    plane: DistancePlane,
    radius: Array,
    integrals: Indices,
) -> Array:
    """Return the share that each of D populations has in discs at M frequencies, (D, M).

    Parameters
    ----------
    users : Users
        D populations.
    plane : DistancePlane
        In which the discs lie; fields of shape (1, M), or (D, M) with a device for each population.
    radius : ndarray, of that shape
        abs(Z_h), N·s/m.
    integrals : ndarray, shape (M,)
        From `chosen_integrals`.
    """
    shares = np.empty((users.size, integrals.size))
    for number in np.unique(integrals).tolist():
        (columns,) = np.nonzero(integrals == number)
        step = max(1, _PASS // (columns.size * _INTEGRALS[number].nodes))
        for start in range(0, users.size, step):
            rows = slice(start, start + step)
            part = rows if len(radius) > 1 else slice(None), columns
            within = DistancePlane(*(field[part] for field in plane)), radius[part]
            some = users.select(rows).column()
            shares[rows, columns] = share_within(some, *within, _INTEGRALS[number])
    return shares


def chosen_integrals(
    users: Users,
    plane: DistancePlane,
    radius: Array,
) -> Indices:
    """Return for each frequency the integral that settles with the fewest nodes, (M,).

    Parameters as in `shares_at_frequencies`. A few populations are tried: which order is smooth
    depends on the frequency more than on the draw.
    """
    few = slice(None, None, max(1, users.size // _TRIED))
    users = users.select(few).column()
    if len(radius) > 1:
        plane = DistancePlane(*(field[few] for field in plane))
        radius = radius[few]
    shape = np.broadcast_shapes(users.correlation.shape, radius.shape)
    chosen = np.full(shape[1], len(_INTEGRALS) - 1)
    unsettled = np.ones(shape[1], dtype=bool)
    reaches_edges = [_reaches_edges(users, plane, radius, inner) for inner in (STIFFNESS, DAMPING)]
    # The last shares of each kind of integral.
    shares = np.full((2, *shape), np.nan)
    for number, integral in enumerate(_INTEGRALS):
        (tried,) = np.nonzero(unsettled & (reaches_edges[integral.inner] == integral.even))
        if not tried.size:
            continue
        finer = share_within(users, plane.select(tried), radius[:, tried], integral)
        coarser = shares[integral.inner]
        change = np.abs(finer - coarser[:, tried]).max(axis=0)
        coarser[:, tried] = finer
        settled = tried[change < _AGREEMENT * _ACCURACY]
        chosen[settled] = number
        unsettled[settled] = False
    return chosen


def _reaches_edges(
    users: Users,
    plane: DistancePlane,
    radius: Array,
    inner: int,
) -> Flags:
    """Say at which frequencies (M,) no population's disc ends between the edges."""
    outer, _ = _outer_and_inner(users, plane, inner)
    low, high = _ends(outer, radius, log=users.log)
    whole = (low == -_EDGE) & (high == _EDGE)
    return np.asarray(whole.all(axis=0))
