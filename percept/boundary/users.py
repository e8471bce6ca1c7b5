"""Populations of users: the share of them below some abs(Z_h), and central ranges of abs(Z_h).

A population is a normal law of (k, b), or of their logarithms. abs(Z_h) is a distance in the plane
of (b, k/Omega), so the users with at most a given abs(Z_h) lie in a disc. The share is an integral
over one of k and b, by Gauss-Legendre nodes; the other has a normal law given the first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import elementwise

from percept.haptics.plane import Boxes, DistancePlane, Range

__all__ = [
    "ACCURACY",
    "PASS",
    "DiscIntegral",
    "MagnitudeRanges",
    "Users",
    "by_integral",
    "choose_integral",
    "magnitude_ranges",
    "share_within",
]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]

#: Beyond so many SDs lies less than 1e-12 of a population.
_FARTHEST = 7.2
#: Nodes tried, from the fewest on: two counts in a row that agree have settled. Narrow discs in
#: wide populations need the last.
_NODE_COUNTS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384)
#: Of an integral's accuracy, what may lie beyond each of its ends.
_BEYOND_EDGE = 0.05
#: Of the accuracy, by how much two counts in a row may differ: half as many nodes again gain little
#: where a disc ends at a slant.
_AGREEMENT = 0.25
#: Shares are as good as exact from here on: verdicts look at shares of 0.005 and their like.
ACCURACY = 1e-7
#: Logarithms of a stiffness or damping of zero, and below: no user is there.
_LEAST = np.finfo(np.float64).tiny
_SQRT_2PI = float(np.sqrt(2.0 * np.pi))
#: Accuracy of shares of users: next to all limits move by less than a hundredth of an SD.
_SHARE_ACCURACY = 3e-5
#: Accuracy of the logarithm of a limit, and of its normal score; a map shows no finer step.
_LIMIT_ACCURACY = 1e-4
_SCORE_ACCURACY = 1e-3
#: Shares nearer to 0 or 1 than this count as this much: a normal score stays finite.
_LEAST_SHARE = 1e-9
#: Of the largest abs(Z_h) of users: below it lie next to none, also where abs(Z_h) can vanish.
_LEAST_FRACTION = 1e-4
#: Values of (limits, nodes) computed at once. Temporaries of 128 KiB or more come from fresh pages
#: of memory, and take twice as long.
PASS = 15_000
#: Populations that show how the integral is best taken: it depends on the frequency far more.
_TRIED = 8
#: Rows of a population's mean and SD.
_STIFFNESS = 0
_DAMPING = 1


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
    def of(cls, mean: Array, covariance: Array, *, log: bool) -> Users:
        """Take means (D, 2) and covariances (D, 2, 2)."""
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        sd = np.sqrt(variance)
        correlation = covariance[:, 0, 1] / sd.prod(axis=1)
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

    def column(self) -> Users:
        """Return the same with a last axis of one, which frequencies broadcast against."""
        return self.select(None)

    def few(self) -> slice:
        """Return which populations show how the integral is best taken."""
        return slice(None, None, max(1, self.size // _TRIED))

    def score(self, value: float | Array, quantity: int) -> Array:
        """Return how many SDs a stiffness (0) or damping (1) lies above the mean, (D,)."""
        if self.log:
            value = np.log(np.maximum(value, _LEAST))
        return np.asarray((value - self.mean[quantity]) / self.sd[quantity])

    def native(self, score: float, quantity: int) -> Array:
        """Return the stiffness (0) or damping (1) that lies `score` SDs from the mean, (D,)."""
        distance = score * self.sd[quantity]
        value = self.mean[quantity] + distance
        return np.exp(value) if self.log else value

    def central_ranges(self, level: float) -> Boxes:
        """Return the limits between which the central `level` of stiffness and of damping lie."""
        tail = 0.5 * (1.0 - level)
        edge = float(-special.ndtri(tail))
        softest = self.native(-edge, _STIFFNESS)
        stiffest = self.native(edge, _STIFFNESS)
        least_damped = self.native(-edge, _DAMPING)
        most_damped = self.native(edge, _DAMPING)
        return Boxes.of((softest, stiffest), (least_damped, most_damped))


class DiscIntegral(NamedTuple):
    """How the integral over a disc is taken."""

    inner: int  # 0 where stiffness has its law given damping, 1 the other way round
    nodes: int  # Over the other quantity
    edge: float = _FARTHEST  # SDs of it from the mean at which the integral ends
    #: Even nodes from edge to edge, by far the best where the disc does not end between; else dense
    #: at the ends of the disc.
    even: bool = False


class _Axis(NamedTuple):
    """One quantity's part of the distance, gain·value + offset, and its law."""

    gain: Array
    offset: Array
    mean: Array
    sd: Array

    def beside_nodes(self) -> _Axis:
        """Return all fields with a last axis of one, which nodes broadcast against."""
        return _Axis(*(field[..., None] for field in self))

    def value_at(self, part: Array) -> Array:
        """Return the value whose part of the distance is `part`, N·s/m."""
        return (part - self.offset) / self.gain

    def score(self, value: Array, *, log: bool) -> Array:
        """Return how many SDs a value lies from the mean."""
        if log:
            value = np.log(np.maximum(value, _LEAST))
        return (value - self.mean) / self.sd

    def part_at(self, score: Array, *, log: bool) -> Array:
        """Return the part of the distance of a value `score` SDs from the mean, N·s/m."""
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
    users: Users, plane: DistancePlane, radius: Array, integral: DiscIntegral
) -> Array:
    """Return the share of each population with abs(Z_h) of at most `radius`, N·s/m.

    Fields of populations, plane and radius have shapes that broadcast; so has the result.
    """
    outer, inner = _axes(users, plane, integral.inner)
    if integral.even:
        low = np.array(-integral.edge)
        high = -low
    else:
        low, high = _ends(outer, radius, integral.edge, log=users.log)
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


def _axes(users: Users, plane: DistancePlane, inner: int) -> tuple[_Axis, _Axis]:
    """Return the outer and the inner quantity of an integral."""
    stiffness = _Axis(
        gain=-plane.per_rate,
        offset=plane.imaginary,
        mean=users.mean[_STIFFNESS],
        sd=users.sd[_STIFFNESS],
    )
    damping = _Axis(
        gain=plane.gain,
        offset=plane.real,
        mean=users.mean[_DAMPING],
        sd=users.sd[_DAMPING],
    )
    return (stiffness, damping) if inner == _DAMPING else (damping, stiffness)


def _ends(outer: _Axis, radius: Array, edge: float, *, log: bool) -> tuple[Array, Array]:
    """Return the scores of the outer quantity between which the disc lies, within an edge."""
    first = outer.score(outer.value_at(-radius), log=log)
    second = outer.score(outer.value_at(radius), log=log)
    first = np.clip(first, -edge, edge)
    second = np.clip(second, -edge, edge)
    return np.minimum(first, second), np.maximum(first, second)


def _chord(users: Users, outer: _Axis, inner: _Axis, score: Array, radius: Array) -> Array:
    """Return the probability of the inner quantity's chord through the disc at each outer score."""
    across = outer.part_at(score, log=users.log)
    rest = radius - across
    square = rest * (radius + across)
    half_chord = np.sqrt(np.maximum(square, 0.0)) / inner.gain
    middle = -inner.offset / inner.gain
    correlation = users.correlation[..., None]
    remainder = (1.0 - correlation) * (1.0 + correlation)
    sd_given_outer = inner.sd * np.sqrt(remainder)
    mean_given_outer = inner.mean + (correlation * inner.sd) * score
    shares = []
    for value in (middle - half_chord, middle + half_chord):
        if users.log:
            positive = np.maximum(value, _LEAST)
            value = np.log(positive)
        off = value - mean_given_outer
        score_given_outer = off / sd_given_outer
        share = special.ndtr(score_given_outer)
        shares.append(share)
    below_first, below_second = shares
    return np.abs(below_second - below_first)


def choose_integral(
    users: Users, plane: DistancePlane, radius: Array, accuracy: float = ACCURACY
) -> list[DiscIntegral]:
    """Return for each frequency (M,) the integral whose digits settle with the fewest nodes.

    A few populations (D, 1) are tried: which order is smooth depends on the frequency more than on
    the draw.
    """
    shape = np.broadcast_shapes(users.correlation.shape, radius.shape)
    edge = float(-special.ndtri(_BEYOND_EDGE * accuracy))
    candidates = [
        DiscIntegral(inner, nodes, edge, even)
        for nodes in _NODE_COUNTS
        for even in (True, False)
        for inner in (_STIFFNESS, _DAMPING)
    ]
    chosen = np.full(shape[1], len(candidates) - 1)
    unsettled = np.arange(shape[1])
    # The last shares of each kind of integral.
    shares = np.full((2, 2, *shape), np.nan)
    for number, integral in enumerate(candidates):
        if not unsettled.size:
            break
        some = plane.select(unsettled)
        there = radius[..., unsettled]
        finer = share_within(users, some, there, integral)
        coarser = shares[int(integral.even), integral.inner]
        change = np.abs(finer - coarser[:, unsettled]).max(axis=0)
        coarser[:, unsettled] = finer
        settled = change < _AGREEMENT * accuracy
        if integral.even:
            settled &= _reaches_edges(users, some, there, integral)
        chosen[unsettled[settled]] = number
        unsettled = unsettled[~settled]
    return [candidates[number] for number in chosen]


def _reaches_edges(
    users: Users, plane: DistancePlane, radius: Array, integral: DiscIntegral
) -> Flags:
    """Say at which frequencies (M,) no population's disc ends between the edges."""
    outer, _ = _axes(users, plane, integral.inner)
    low, high = _ends(outer, radius, integral.edge, log=users.log)
    below = low == -integral.edge
    above = high == integral.edge
    whole = below & above
    return np.asarray(whole.all(axis=0))


def by_integral(integrals: list[DiscIntegral]) -> dict[DiscIntegral, NDArray[np.bool_]]:
    """Say for each integral at which frequencies (M,) it is taken."""
    return {
        integral: np.array([other == integral for other in integrals])
        for integral in set(integrals)
    }


class MagnitudeRanges(NamedTuple):
    """Central ranges of abs(Z_h), N·s/m, of D populations at M frequencies."""

    lower: Array  # (D, M)
    upper: Array  # (D, M)


def magnitude_ranges(users: Users, plane: DistancePlane, level: float) -> MagnitudeRanges:
    """Return between which abs(Z_h) the central `level` of each population's users lie.

    Parameters
    ----------
    users : Users
        D populations.
    plane : DistancePlane
        Flat, of M frequencies.
    level : float
        Share of all users that a range holds.

    Returns
    -------
    MagnitudeRanges
        N·s/m, to about a ten-thousandth.
    """
    tail = 0.5 * (1.0 - level)
    # Outside one of four such limits lie fewer users than in one tail of abs(Z_h).
    boxes = users.central_ranges(1.0 - 0.5 * tail)
    brackets = _brackets(boxes, plane)
    edge = -float(special.ndtri(tail))
    return MagnitudeRanges(
        lower=_limit(users, plane, brackets, -edge),
        upper=_limit(users, plane, brackets, edge),
    )


class _Brackets(NamedTuple):
    """Logarithms of abs(Z_h) between which both limits lie, (D, M)."""

    low: Array
    high: Array


def _brackets(boxes: Boxes, plane: DistancePlane) -> _Brackets:
    """Return the smallest and the largest abs(Z_h) over the box of each population."""
    column = Boxes(_column(boxes.stiffness), _column(boxes.damping))
    extremes = column.extremes(plane)
    farthest = plane.distance(extremes.farthest)
    nearest = plane.distance(extremes.nearest)
    least = _LEAST_FRACTION * farthest
    low = np.log(np.maximum(nearest, least))
    high = np.log(farthest)
    return _Brackets(low, high)


def _column(limits: Range) -> Range:
    """Return limits with a last axis of one, which frequencies broadcast against."""
    return Range(limits.low[:, None], limits.high[:, None])


def _limit(users: Users, plane: DistancePlane, brackets: _Brackets, score: float) -> Array:
    """Return the abs(Z_h) below which lie as many users as below a normal score, (D, M)."""
    spans = brackets.low + brackets.high
    log_middle = 0.5 * np.median(spans, axis=0)
    middle = np.exp(log_middle)
    chosen = choose_integral(users.select(users.few()).column(), plane, middle, _SHARE_ACCURACY)
    limit = np.empty_like(brackets.low)
    for integral, frequencies in by_integral(chosen).items():
        (columns,) = np.nonzero(frequencies)
        draws = np.arange(users.size)
        draw, column = np.meshgrid(draws, columns, indexing="ij")
        cells = draw.ravel(), column.ravel()
        limit[cells] = _solve(users, plane, brackets, score, integral, cells)
    return limit


def _solve(
    users: Users,
    plane: DistancePlane,
    brackets: _Brackets,
    score: float,
    integral: DiscIntegral,
    cells: tuple[Indices, Indices],
) -> Array:
    """Return the limits (n,) of n cells, each a draw and a frequency."""
    step = PASS // integral.nodes

    def excess(log_radius: Array, draw: Array, column: Array) -> Array:
        radius = np.exp(log_radius)
        shares = np.empty(radius.shape)
        for start in range(0, radius.size, step):
            part = slice(start, start + step)
            some = users.select(draw[part].astype(np.intp))
            there = plane.select(column[part].astype(np.intp))
            shares[part] = share_within(some, there, radius[part], integral)
        most = 1.0 - _LEAST_SHARE
        bounded = np.clip(shares, _LEAST_SHARE, most)
        return np.asarray(special.ndtri(bounded) - score)

    low = brackets.low[cells]
    draw, column = cells
    root = elementwise.find_root(
        excess,
        (low, brackets.high[cells]),
        args=(draw.astype(float), column.astype(float)),
        tolerances={
            "xatol": _LIMIT_ACCURACY,
            "fatol": _SCORE_ACCURACY,
            "xrtol": 0.0,
            "frtol": 0.0,
        },
    )
    # Without a change of sign next to no user lies between the low end and the limit.
    found = np.where(root.success, root.x, low)
    return np.exp(found)
