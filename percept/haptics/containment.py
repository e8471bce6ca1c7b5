"""Whether abs(Z_h) stays inside a region of (k, b) at every ω of a range: decided without a grid.

At one ω let F be the farthest and N the nearest point of the region, as abs(Z_h) measures. Wherever
abs(Z_h) of the display lies between N's and F's it lies inside the region's limits. On a piece of
the range this asks for the signs of two polynomials, which Bernstein coefficients of one sign
decide. Others are halved. Where a display leaves, a halving comes upon an ω that shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import BoolArray, FloatArray, IntArray, Scalars
from percept.haptics.forms import Display, Points, Squares
from percept.haptics.impedance import Warp, warp
from percept.haptics.perceived import distance_axes, rendered
from percept.haptics.records import TabulatedDevice

#: Nearer to a limit than this, as a logarithm, a display lies on it.
ON_LIMIT = 1e-10
# The largest departure is searched to this fraction of itself.
_FRACTION = 1e-4
_PIECES_PER_DECADE = 1.5
# After these halvings a piece is as narrow as the spacing of doubles allows; its bound is then
# widened.
_HALVINGS = 40
# A search that needs more pieces for a display widens its bound instead.
_MOST_PIECES = 2048
# What a departure counts as where a curve vanishes or has a pole; and deeper inside than a factor
# of 1,000, whose square would leave too few digits to compare.
_DEEP, _DEEPEST = 12.0 * float(np.log(10.0)), -3.0 * float(np.log(10.0))


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
        return np.asarray(
            (self.gain * b + self.across) ** 2 + (self.along - self.per_rate * k) ** 2
        )


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
        """Return the nearest and the farthest (k, b) of boxes (n,), each at its own ω."""
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

    def verdict(self, n: int = 0) -> Literal["inside", "marginal", "outside"]:
        """Judge one of them; within rounding, or where the bound decides nothing, it is marginal."""
        if self.largest[n] > ON_LIMIT:
            return "outside"
        return "inside" if self.bound[n] < -ON_LIMIT else "marginal"


def departures(
    display: Display, boxes: Boxes, lower: float, upper: float, *, throughout: bool = False
) -> Departures:
    """Search for the largest departure of abs(Z_h) over ω from `lower` to `upper`, one display or N.

    With `throughout` the search for a display ends as soon as one ω shows it outside, or none can.
    """
    count = boxes.size if display.size is None else display.size
    ends = _first_pieces(display, lower, upper)
    work = _Work.start(ends, count, shared=display.size is None)
    best, where, gap = np.full(count, -np.inf), np.full(count, ends[0]), np.full(count, ON_LIMIT)

    def see(omega: FloatArray) -> tuple[Points, Points]:
        plane, shown = _sampled(display if work.shared else display.at(work.owner), omega)
        plane, shown = plane.at(work.piece), shown[work.piece]
        near, far = boxes.extremes(plane, work.item)
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = 0.5 * np.log(np.fmax(shown / plane.square(*far), plane.square(*near) / shown))
        beyond = np.clip(np.where(np.isnan(beyond), _DEEPEST, beyond), _DEEPEST, _DEEP)
        # The largest of each item, the first of equals.
        order = np.lexsort((-beyond, work.item))
        first = order[np.diff(work.item[order], prepend=-1) > 0]
        first = first[beyond[first] > best[work.item[first]]]
        best[work.item[first]], where[work.item[first]] = beyond[first], omega[work.piece[first]]
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
        allowed = (
            np.full(count, ON_LIMIT)
            if throughout
            else best + np.maximum(gap, _FRACTION * np.abs(best))
        )
        squares = Squares.of(display if work.shared else display.at(work.owner), work.omega)
        by = np.expm1(2 * np.clip(allowed, _DEEPEST, _DEEP))[work.item]
        work = work.some(~squares.within(work.piece, far, near, by))
        if halve:
            work = work.halved()
        elif throughout:
            break
    bound = (
        np.maximum(best, ON_LIMIT)
        if throughout
        else best + np.maximum(gap, _FRACTION * np.abs(best))
    )
    bound[work.item] = np.inf
    return Departures(best, where, bound)


def _first_pieces(display: Display, lower: float, upper: float) -> FloatArray:
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


def _sampled(display: Display, omega: FloatArray) -> tuple[Plane, FloatArray]:
    """Return the plane of the limits and the square of abs(Z_h) as displayed, at ω (n,)."""
    grid = warp(omega, display.period)
    across, along, held = distance_axes(
        grid, display.device, display.hold, display.environment.mass
    )
    plane = Plane(*np.broadcast_arrays(held.gain, held.per_rate, across, along))
    return plane, plane.square(*_shown(display, grid))


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
            return cls(
                omega,
                np.zeros(pieces, dtype=np.intp),
                item,
                np.tile(np.arange(pieces), count),
                True,
            )
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


def _shown(display: Display, grid: Warp) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping shown, N/m and N·s/m; the environment's mass counts with the device."""
    felt = rendered(grid, display.environment, display.coupling)
    stiffness = np.asarray(felt.stiffness)
    if display.coupling is not None:
        stiffness = stiffness + np.multiply(display.environment.mass, grid.rate**2)
    return stiffness, np.asarray(felt.damping)


def _turning_points(display: Display, lower: float, upper: float) -> FloatArray:
    """Return both ends of a range of ω, rad/s, and where stiffness or damping of one display turns between.

    Without a mass both are monotone in Ω².
    """
    own, half = display.environment, display.period / 2
    if display.coupling is None or not own.mass:
        return np.array([lower, upper])
    # In units of the range's middle the coefficients are of one size.
    unit = np.tan(lower * half) * np.tan(upper * half) / half**2
    x = Polynomial([0.0, unit])
    spring, k_c, b_c = (
        own.stiffness - own.mass * x,
        display.coupling.stiffness,
        display.coupling.damping,
    )
    first, second = own.damping**2 * x + spring**2, b_c**2 * x + k_c**2
    under = (own.damping + b_c) ** 2 * x + (spring + k_c) ** 2
    shown = first * b_c + second * own.damping, first * k_c + second * spring + own.mass * x * under
    roots = [(over.deriv() * under - over * under.deriv()).roots() for over in shown]
    # A root that rounding made complex still splits the range; more points do no harm.
    rates = np.sqrt(np.maximum(np.concatenate(roots).real, 0.0) * unit)
    return np.array([lower, *np.clip(np.arctan(rates * half) / half, lower, upper), upper])


def plane_departures(
    display: Display, boxes: Boxes, lower: float, upper: float
) -> tuple[FloatArray, FloatArray]:
    """Return how far the stiffness and damping shown leave boxes at most, in widths, and at which ω; exact.

    Negative inside; shape (N,), of one display or N and one box or N.
    """
    one = display.size is None or not display.environment.mass
    each = [display] if one else [display.at(n) for n in range(display.size or 0)]
    turns = [_turning_points(part, lower, upper) for part in each]
    # Fewer turns leave room for an end of the range, again.
    omega = np.full((max(part.size for part in turns), len(turns)), upper)
    for column, part in zip(omega.T, turns, strict=True):
        column[: part.size] = part
    off: FloatArray = np.full(np.broadcast_shapes(omega.shape, (boxes.size,)), -np.inf)
    limits = boxes.stiffness, boxes.damping
    for value, (low, high) in zip(
        _shown(display, warp(omega, display.period)), limits, strict=True
    ):
        width = np.where(high > low, high - low, 1.0)
        off = np.maximum(off, np.maximum(low - value, value - high) / width)
    at = off.argmax(axis=0)[None]
    where = np.take_along_axis(np.broadcast_to(omega, off.shape), at, axis=0)
    return np.take_along_axis(off, at, axis=0)[0], where[0]
