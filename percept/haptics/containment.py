"""Whether abs(Z_h) stays inside a region of (k, b) at every ω of a range: decided without a grid.

At one ω let F be the farthest and N the nearest point of the region, as abs(Z_h) measures. Wherever abs(Z_h)
of the display lies between N's and F's it lies inside the region's limits. On a piece of the range this asks
for the signs of two polynomials, which Bernstein coefficients of one sign decide. Others are halved.
Where a display leaves, a halving comes upon an ω that shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import BoolArray, FloatArray, IntArray, Scalars
from percept.haptics.forms import Display, Squares, environment_parts
from percept.haptics.impedance import Element, series, warp
from percept.haptics.perceived import distance_axes
from percept.haptics.records import TabulatedDevice

#: Nearer to a limit than this, as a logarithm, a display lies on it.
ON_LIMIT = 1e-10
# The largest departure is searched to this fraction of itself.
_FRACTION = 1e-4
_PIECES_PER_DECADE = 1.5
# After these halvings a piece is as narrow as the spacing of doubles allows; its bound is then widened.
_HALVINGS = 40
# A search that needs more pieces for a display widens its bound instead.
_MOST_PIECES = 2048
# What a departure counts as where a curve vanishes or has a pole; and deeper inside than a factor of 1,000,
# whose square would leave too few digits to compare.
_DEEP, _DEEPEST = 12.0 * float(np.log(10.0)), -3.0 * float(np.log(10.0))

Points: TypeAlias = tuple[FloatArray, FloatArray]
Verdict = Literal["inside", "marginal", "outside"]


@dataclass(frozen=True)
class Plane:
    """Where abs(Z_h) is hypot(gain·b + across, along − per_rate·k), at ω (n,)."""

    gain: FloatArray
    per_rate: FloatArray  # s/rad
    across: FloatArray  # N·s/m
    along: FloatArray  # N·s/m

    def at(self, which: Any) -> Plane:
        """Return some of the elements."""
        return Plane(*(part[which] for part in (self.gain, self.per_rate, self.across, self.along)))

    def square(self, k: Scalars, b: Scalars) -> FloatArray:
        """Return abs(Z_h)²."""
        return np.asarray((self.gain * b + self.across) ** 2 + (self.along - self.per_rate * k) ** 2)


class Region(Protocol):
    """N regions of (k, b)."""

    @property
    def size(self) -> int:
        """N."""

    def extremes(self, plane: Plane, which: IntArray) -> tuple[Points, Points]:
        """Return the nearest and the farthest (k, b) of regions (n,), each at its own ω."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Limits of k, N/m, and of b, N·s/m; `corners` counts both lower or both upper limits together only."""

    stiffness: tuple[FloatArray, FloatArray]  # (N,) each
    damping: tuple[FloatArray, FloatArray]
    corners: bool = False

    @property
    def size(self) -> int:
        """N."""
        return int(self.stiffness[0].size)

    def some(self, which: IntArray) -> Boxes:
        """Return some of the boxes."""
        k, b = ((low[which], high[which]) for low, high in (self.stiffness, self.damping))
        return Boxes(k, b, self.corners)

    def extremes(self, plane: Plane, which: IntArray) -> tuple[Points, Points]:
        """See `Region`."""
        (k_low, k_high), (b_low, b_high) = (
            (low[which], high[which]) for low, high in (self.stiffness, self.damping)
        )
        if self.corners:
            return (k_low, b_low), (k_high, b_high)
        k, b = plane.along / plane.per_rate, -plane.across / plane.gain
        near = np.clip(k, k_low, k_high), np.clip(b, b_low, b_high)
        return near, (
            np.where(2 * k > k_low + k_high, k_low, k_high),
            np.where(2 * b > b_low + b_high, b_low, b_high),
        )


@dataclass(frozen=True, eq=False)
class Departures:
    """How far N displays leave their regions at most, as log ratios; negative inside. Shape (N,)."""

    largest: FloatArray  # Largest seen
    omega: FloatArray  # Where, rad/s
    bound: FloatArray  # No ω departs by more; inf where the search ended undecided

    def verdict(self, n: int = 0) -> Verdict:
        """Judge one of them; within rounding, or where the bound decides nothing, it is marginal."""
        if self.largest[n] > ON_LIMIT:
            return "outside"
        return "inside" if self.bound[n] < -ON_LIMIT else "marginal"


def departures(
    display: Display, region: Region, lower: float, upper: float, *, throughout: bool = False
) -> Departures:
    """Search for the largest departure of abs(Z_h) over ω from `lower` to `upper`, one display or N.

    With `throughout` the search for a display ends as soon as one ω shows it outside, or none can.
    """
    count = region.size if display.size is None else display.size
    ends = first_pieces(display, lower, upper)
    work = _Work.start(ends, count, shared=display.size is None)
    best, where, gap = np.full(count, -np.inf), np.full(count, ends[0]), np.full(count, ON_LIMIT)

    def see(omega: FloatArray) -> tuple[Points, Points]:
        plane, shown = sampled(display if work.shared else display.at(work.owner), omega)
        plane, shown = plane.at(work.piece), shown[work.piece]
        near, far = region.extremes(plane, work.item)
        _keep_largest(departure(plane, shown, near, far), omega[work.piece], work.item, best, where)
        return near, far

    for end in work.omega:
        see(end)
    for halving in range(10 * _HALVINGS):
        if throughout:
            work = work.some(best[work.item] <= ON_LIMIT)
        if not work.item.size:
            break
        near, far = see(work.middle)
        halve = halving < _HALVINGS and work.item.size <= _MOST_PIECES * count
        if not halve:
            unsettled = np.unique(work.item)
            if gap[unsettled].min() >= _DEEP:
                break  # no bound can be given
            gap[unsettled] = np.minimum(10 * gap[unsettled], _DEEP)
        allowed = np.full(count, ON_LIMIT) if throughout else best + np.maximum(gap, _FRACTION * np.abs(best))
        squares = Squares.of(display if work.shared else display.at(work.owner), work.omega)
        by = np.expm1(2 * np.clip(allowed, _DEEPEST, _DEEP))[work.item]
        work = work.some(~squares.within(work.piece, far, near, by))
        if halve:
            work = work.halved()
        elif throughout:
            break
    bound = np.maximum(best, ON_LIMIT) if throughout else best + np.maximum(gap, _FRACTION * np.abs(best))
    bound[work.item] = np.inf
    return Departures(best, where, bound)


def first_pieces(display: Display, lower: float, upper: float) -> FloatArray:
    """Return where the range is cut before any halving: the rows of a table, resonances of modes."""
    count = int(np.ceil(_PIECES_PER_DECADE * np.log10(upper / lower))) + 1
    device, cuts = display.device, np.geomspace(lower, upper, max(2, count))
    if isinstance(device, TabulatedDevice):
        cuts = np.union1d(cuts, device.omega)
    else:
        half = display.period / 2
        rates = [float(np.sqrt(mode.stiffness / mode.mass)) for mode in device.modes if mode.mass]
        cuts = np.union1d(cuts, [np.arctan(rate * half) / half for rate in rates])
    inner = cuts[(cuts > lower) & (cuts < upper)]
    return np.array([lower, *inner, upper])


def sampled(display: Display, omega: FloatArray) -> tuple[Plane, FloatArray]:
    """Return the plane of the limits and the square of abs(Z_h) as displayed, at ω (n,)."""
    grid = warp(omega, display.period)
    k, b, mass = (float(v) for v in environment_parts(display.environment))
    across, along, held = distance_axes(grid, display.device, display.hold, mass)
    plane = Plane(*np.broadcast_arrays(held.gain, held.per_rate, across, along))
    if display.coupling is None:
        return plane, plane.square(k, b)
    beyond = Element(display.coupling.stiffness, display.coupling.damping)
    felt = series(grid, Element(k, b, mass), beyond)
    # The mass counts with the device here.
    return plane, plane.square(felt.stiffness + mass * grid.rate**2, felt.damping)


def departure(plane: Plane, shown: FloatArray, near: Points, far: Points) -> FloatArray:
    """Return how far displays lie beyond the limits, as logarithms of ratios; negative inside."""
    with np.errstate(divide="ignore", invalid="ignore"):
        beyond = np.fmax(shown / plane.square(*far), plane.square(*near) / shown)
        found = 0.5 * np.log(beyond)
    return np.clip(np.where(np.isnan(found), _DEEPEST, found), _DEEPEST, _DEEP)


def _keep_largest(
    values: FloatArray, omega: FloatArray, item: IntArray, best: FloatArray, where: FloatArray
) -> None:
    """Take up the largest of the values of each item, which stand together, and its ω."""
    if not item.size:
        return
    starts = np.flatnonzero(np.diff(item, prepend=-1))
    top = np.maximum.reduceat(values, starts)
    owners = item[starts]
    first = np.flatnonzero(values == np.repeat(top, np.diff(starts, append=item.size)))[::-1]
    at = np.empty(best.size)
    at[item[first]] = omega[first]
    better = owners[top > best[owners]]
    where[better] = at[better]
    best[owners] = np.maximum(best[owners], top)


@dataclass(frozen=True)
class _Work:
    """Pairs of an item and a piece that are not decided yet, the pairs of an item together."""

    omega: FloatArray  # (2, pieces)
    owner: IntArray  # (pieces,) Item of a piece; of no meaning where all share the pieces
    item: IntArray  # (pairs,)
    piece: IntArray  # (pairs,)
    shared: bool

    @classmethod
    def start(cls, ends: FloatArray, count: int, *, shared: bool) -> _Work:
        """Pair every item with every piece."""
        pieces, omega = ends.size - 1, np.stack([ends[:-1], ends[1:]])
        item: IntArray = np.repeat(np.arange(count), pieces)
        if shared:
            return cls(omega, np.zeros(pieces, dtype=np.intp), item, np.tile(np.arange(pieces), count), True)
        return cls(np.tile(omega, count), item, item, np.arange(item.size), False)

    def some(self, which: BoolArray) -> _Work:
        """Keep some of the pairs, and the pieces in them."""
        item, piece = self.item[which], self.piece[which]
        used = np.zeros(self.owner.size, dtype=bool)
        used[piece] = True
        rank = np.cumsum(used) - 1
        return _Work(self.omega[:, used], self.owner[used], item, rank[piece], self.shared)

    def halved(self) -> _Work:
        """Cut every piece in two, evenly in log ω."""
        (low, high), middle = self.omega, self.middle
        omega = np.stack([[low, middle], [middle, high]], axis=-1).reshape(2, -1)
        piece = np.stack([2 * self.piece, 2 * self.piece + 1], axis=1).ravel()
        return _Work(omega, np.repeat(self.owner, 2), np.repeat(self.item, 2), piece, self.shared)

    @property
    def middle(self) -> FloatArray:
        """Geometric middle of each piece, (pieces,)."""
        return np.sqrt(self.omega[0] * self.omega[1])


def shown_at(display: Display, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping shown at ω (n,), N/m and N·s/m; the environment's mass is not counted."""
    grid, own = warp(omega, display.period), display.environment
    felt = Element(own.stiffness, own.damping, own.mass)
    if display.coupling is not None:
        felt = series(grid, felt, Element(display.coupling.stiffness, display.coupling.damping))
        felt = Element(felt.stiffness + np.multiply(own.mass, grid.rate**2), felt.damping)
    stiffness, damping = (np.broadcast_to(part, grid.omega.shape) for part in (felt.stiffness, felt.damping))
    return stiffness, damping


def turning_points(display: Display, lower: float, upper: float) -> FloatArray:
    """Return both ends of a range of ω, and where stiffness or damping turns between them, rad/s."""
    own, half = display.environment, display.period / 2
    turns = np.empty(0)
    if display.coupling is not None and own.mass:
        # In units of the range's middle the coefficients are of one size.
        unit = np.tan(lower * half) * np.tan(upper * half) / half**2
        x = Polynomial([0.0, unit])
        spring, k_c, b_c = own.stiffness - own.mass * x, display.coupling.stiffness, display.coupling.damping
        first, second = own.damping**2 * x + spring**2, b_c**2 * x + k_c**2
        under = (own.damping + b_c) ** 2 * x + (spring + k_c) ** 2
        shown = first * b_c + second * own.damping, first * k_c + second * spring + own.mass * x * under
        roots = [(over.deriv() * under - over * under.deriv()).roots() for over in shown]
        # A root that rounding made complex still splits the range; more points do no harm.
        rates = np.sqrt(np.maximum(np.concatenate(roots).real, 0.0) * unit)
        turns = np.arctan(rates * half) / half
    return np.array([lower, *np.sort(turns[(turns > lower) & (turns < upper)]), upper])


def shown_range(
    display: Display, lower: float, upper: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the smallest and largest stiffness, then damping, shown over a range of ω; exact.

    Without mass both are monotone in Ω², with it they turn at the roots of a polynomial.
    """
    stiffness, damping = shown_at(display, turning_points(display, lower, upper))
    return (float(stiffness.min()), float(stiffness.max())), (float(damping.min()), float(damping.max()))


def plane_departures(
    display: Display, limits: tuple[tuple[float, float], tuple[float, float]], lower: float, upper: float
) -> tuple[FloatArray, FloatArray]:
    """Return how far the stiffness and damping shown leave limits at most, in widths, and at which ω; exact.

    Negative inside; of one display or of N, shape (n,).
    """
    count = display.size or 1
    if display.environment.mass:
        alone = display.size is None
        omega = [turning_points(display if alone else display.at(i), lower, upper) for i in range(count)]
    else:
        omega = [np.array([lower, upper])] * count
    item = np.repeat(np.arange(count), [part.size for part in omega])
    at = np.concatenate(omega)
    shown = shown_at(display if display.size is None else display.at(item), at)
    off: FloatArray = np.full(at.shape, -np.inf)
    for value, (low, high) in zip(shown, limits, strict=True):
        off = np.maximum(off, np.maximum(low - value, value - high) / (high - low or 1.0))
    best, where = np.full(count, -np.inf), np.empty(count)
    _keep_largest(off, at, item, best, where)
    return best, where
