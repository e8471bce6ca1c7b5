"""Whether abs(Z_h) stays inside a region of (k, b) at every ω of a range: decided without a grid.

Let D(ω) be abs(Z_h) of the display, and Z(p, ω) that of a point p = (k, b) of the region. With the
nearest point n and the farthest f, both at that ω, the departure is

    max(ln D/Z(f), ln Z(n)/D)                          negative where the display lies inside

The largest departure over the range is searched for by branch and bound. A piece of the range is
sampled at its middle. Let a be slightly more than the largest departure seen so far: what is to be
shown of a piece is that no ω of it departs by more than a. As no point is farther than the
farthest, and none nearer than the nearest, f and n of the middle may stand for the whole piece:

    D² <= e^(2a) Z(f)²  and  Z(n)² <= e^(2a) D²        on all of the piece: it is decided

Times a common denominator these are polynomials in Ω² (`forms.Squares`), and Bernstein coefficients
of one sign decide. A piece that is not decided is halved. Where a display leaves its region, a
halving comes upon an ω that shows it.

Whether the stiffness and the damping that a display shows stay inside is exact, without a search:
both are ratios of polynomials in Ω², and turn at the roots of others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import BoolArray, FloatArray, IntArray, Scalars
from percept.haptics.axis import omega_of_rate, warp
from percept.haptics.forms import Squares
from percept.haptics.perceived import DistancePlane, Extremes, Point, shown_element
from percept.haptics.records import Display, TabulatedDevice
from percept.haptics.shown import turning_points, turns

__all__ = [
    "ON_LIMIT",
    "Boxes",
    "Departures",
    "PlaneDepartures",
    "Range",
    "departures",
    "plane_departures",
]

#: Nearer to a limit than this, as a logarithm, a display lies on it: rounding could decide. A
#: departure keeps some 13 digits, which leaves three to spare.
ON_LIMIT = 1e-10
# The largest departure is searched to this fraction of itself: more digits than a page prints.
_FRACTION = 1e-4
# Pieces per decade of ω before any halving: most are decided at once. It costs or saves time only.
_PIECES_PER_DECADE = 1.5
# Rounds that may halve. After 40 halvings a piece is 1.4e-12 wide in ln ω: a curve whose log slope
# is below 70 changes by less than ON_LIMIT there. Bounds are widened instead.
_HALVINGS = 40
# Pieces per display above which bounds are widened instead: a display that follows its limit for
# long would fill the memory.
_MOST_PIECES = 2048
# Guards against a search without end: 40 rounds may halve, and 12 more widen a bound tenfold each,
# from ON_LIMIT to _LARGEST. Some may do neither.
_MOST_ROUNDS = 60
# What a departure counts as, as a logarithm, where a curve vanishes or has a pole: twelve decades,
# beyond any ratio of two impedances that a limit could mean.
_LARGEST = 12.0 * float(np.log(10.0))
# Deeper inside than a factor of 1,000 its square would leave too few digits to compare.
_DEEPEST = -3.0 * float(np.log(10.0))


class Range(NamedTuple):
    """N limits of one quantity, shape (N,) each."""

    low: FloatArray
    high: FloatArray

    def select(self, which: IntArray) -> Range:
        """Return the limits of these indices, in this order."""
        return Range(self.low[which], self.high[which])

    def farther_end(self, value: Scalars) -> FloatArray:
        """Return the limit that lies farther from a value."""
        above_middle = np.multiply(2, value) > self.low + self.high
        return np.where(above_middle, self.low, self.high)

    def widths_off(self, value: Scalars) -> FloatArray:
        """Return how far a value lies beyond the nearer limit, in widths (in units if zero)."""
        width = self.high - self.low
        width = np.where(width > 0, width, 1.0)
        return np.maximum(self.low - value, value - self.high) / width


@dataclass(frozen=True)
class Boxes:
    """N limits of stiffness and damping.

    With `corners` only the corners (low, low) and (high, high) count.
    """

    stiffness: Range  # N/m
    damping: Range  # N·s/m
    corners: bool = False

    @classmethod
    def of(
        cls,
        stiffness: tuple[ArrayLike, ArrayLike],
        damping: tuple[ArrayLike, ArrayLike],
        *,
        count: int = 1,
        corners: bool = False,
    ) -> Boxes:
        """Take pairs (low, high) of N limits, or of one that holds `count` times."""
        limits = np.broadcast_arrays(*stiffness, *damping, np.zeros(count))
        k_low, k_high, b_low, b_high, _ = np.array(limits, dtype=float)
        return cls(Range(k_low, k_high), Range(b_low, b_high), corners)

    @property
    def size(self) -> int:
        """N."""
        return self.stiffness.low.size

    def select(self, which: IntArray) -> Boxes:
        """Return the boxes of these indices, in this order."""
        return Boxes(self.stiffness.select(which), self.damping.select(which), self.corners)

    def extremes(self, plane: DistancePlane) -> Extremes:
        """Return the nearest and the farthest (k, b) of each box at its own ω."""
        if self.corners:
            return Extremes(
                nearest=Point(self.stiffness.low, self.damping.low),
                farthest=Point(self.stiffness.high, self.damping.high),
            )
        k, b = plane.origin()
        return Extremes(
            nearest=Point(np.clip(k, *self.stiffness), np.clip(b, *self.damping)),
            farthest=Point(self.stiffness.farther_end(k), self.damping.farther_end(b)),
        )


@dataclass(frozen=True)
class Departures:
    """How far N displays leave their regions at most, as log ratios, (N,); negative inside."""

    largest: FloatArray  # Largest seen
    omega: FloatArray  # Where, rad/s
    bound: FloatArray  # No ω departs by more; inf where the search ended undecided

    def verdict(self, n: int = 0) -> Literal["inside", "marginal", "outside"]:
        """Judge one; within rounding, or where the bound decides nothing, it is marginal.

        A search `throughout` ends before any bound lies below zero: its displays are never said to
        be inside here. Its caller compares `largest` with `ON_LIMIT`.
        """
        if self.largest[n] > ON_LIMIT:
            return "outside"
        return "inside" if self.bound[n] < -ON_LIMIT else "marginal"


def departures(
    display: Display, boxes: Boxes, lower: float, upper: float, *, throughout: bool = False
) -> Departures:
    """Search for the largest departure of abs(Z_h) from boxes over a range of ω.

    Parameters
    ----------
    display : Display
        One display, or N.
    boxes : Boxes
        The limits of each; N boxes for one display judge it N times.
    lower, upper : float
        Ends of the range, rad/s, between 0 and π/T.
    throughout : bool
        Ask only whether a display is inside at every ω: its search ends as soon as one ω shows it
        outside, or none can.

    Returns
    -------
    Departures
        Of shape (N,). With `throughout` an outside display's `largest` is that of the ω met first.

    Raises
    ------
    UsageError
        The range passes Nyquist or leaves a device's table; T not positive.
    """
    return _DepartureSearch(display, boxes, lower, upper, throughout=throughout).run()


class _DepartureSearch:
    """The largest departure seen of each box with its display, and a bound on all others."""

    def __init__(
        self, display: Display, boxes: Boxes, lower: float, upper: float, *, throughout: bool
    ) -> None:
        self._display = display
        self._boxes = boxes
        self._throughout = throughout
        one_display = display.count is None
        self._count = boxes.size if display.count is None else display.count
        cuts = _first_cuts(display, lower, upper)
        self._pairs = _Pairs.start(cuts, self._count, shared=one_display)
        self._largest = np.full(self._count, -np.inf)
        self._omega = np.full(self._count, float(lower))
        # How much more than the largest seen a bound allows; widened where halving does not decide.
        self._gap = np.full(self._count, ON_LIMIT)

    def run(self) -> Departures:
        """Halve pieces until every pair of item and piece is decided or given up."""
        for end in self._pairs.omega:
            self._look(end)
        for round_number in range(_MOST_ROUNDS):
            if self._throughout:
                # One ω outside is the answer.
                maybe_inside = self._largest <= ON_LIMIT
                self._pairs = self._pairs.select(maybe_inside[self._pairs.item])
            if not self._pairs.item.size:
                break
            extremes = self._look(self._pairs.middle)
            few_pieces = self._pairs.item.size <= _MOST_PIECES * self._count
            halve = round_number < _HALVINGS and few_pieces
            if not halve:
                widened = self._widen()
                if not widened:
                    break
            self._pairs = self._pairs.select(~self._decided(extremes))
            if halve:
                self._pairs = self._pairs.halved()
            elif self._throughout:
                # Whether it is inside does not depend on the gap: a wider one decides nothing.
                break
        bound = np.maximum(self._largest, self._allowed())
        # Pairs are left where the search gave up.
        bound[self._pairs.item] = np.inf
        return Departures(self._largest, self._omega, bound)

    def _look(self, omega: FloatArray) -> Extremes:
        """Sample each piece at one ω, shape (pieces,), and return the extremes of each pair."""
        pairs = self._pairs
        display = self._display.select(pairs.owner)
        grid = warp(omega, display.period)
        mass = display.environment.mass
        of_piece = DistancePlane.of(grid, display.device, display.hold, mass).flat()
        element = shown_element(grid, display)
        displayed = of_piece.square(Point(element.stiffness, element.damping))[pairs.piece]
        plane = of_piece.select(pairs.piece)
        extremes = self._boxes.select(pairs.item).extremes(plane)
        with np.errstate(divide="ignore", invalid="ignore"):
            above = displayed / plane.square(extremes.farthest)
            below = plane.square(extremes.nearest) / displayed
            departure = 0.5 * np.log(np.fmax(above, below))
        # NaN is 0/0: the display vanishes with the region's own curve, and departs from nothing.
        departure = np.where(np.isnan(departure), _DEEPEST, departure)
        self._keep(np.clip(departure, _DEEPEST, _LARGEST), omega)
        return extremes

    def _keep(self, departure: FloatArray, omega: FloatArray) -> None:
        """Keep the largest departure of each item, the first of equals; departures of pairs."""
        item = self._pairs.item
        # Sorted by item, and within an item from the largest departure down.
        order = np.lexsort((-departure, item))
        top = order[np.diff(item[order], prepend=-1) > 0]
        top = top[departure[top] > self._largest[item[top]]]
        self._largest[item[top]] = departure[top]
        self._omega[item[top]] = omega[self._pairs.piece[top]]

    def _allowed(self) -> FloatArray:
        """Return the departure that a piece must stay below to need no further halving."""
        if self._throughout:
            return np.full(self._count, ON_LIMIT)
        fraction = _FRACTION * np.abs(self._largest)
        return self._largest + np.maximum(self._gap, fraction)

    def _widen(self) -> bool:
        """Widen the bounds of undecided items tenfold; False where no bound can be given."""
        undecided = np.unique(self._pairs.item)
        gap = self._gap[undecided]
        if gap.min() >= _LARGEST:
            return False
        self._gap[undecided] = np.minimum(10 * gap, _LARGEST)
        return True

    def _decided(self, extremes: Extremes) -> BoolArray:
        """Say for which pairs no ω of the piece departs by more than allowed."""
        pairs = self._pairs
        squares = Squares.of(self._display.select(pairs.owner), pairs.omega)
        allowed = np.clip(self._allowed(), _DEEPEST, _LARGEST)
        # Of squares, where departures are logarithms of ratios.
        allowance = np.expm1(2 * allowed)
        return squares.surely_between(pairs.piece, extremes, allowance[pairs.item])


def _first_cuts(display: Display, lower: float, upper: float) -> FloatArray:
    """Return where the range is cut before any halving: also at rows of a table and resonances."""
    pieces = np.ceil(_PIECES_PER_DECADE * np.log10(upper / lower))
    count = int(pieces) + 1
    device = display.device
    cuts = np.geomspace(lower, upper, max(2, count))
    if isinstance(device, TabulatedDevice):
        cuts = np.union1d(cuts, device.omega)
    else:
        rates = [mode.resonance for mode in device.modes]
        cuts = np.union1d(cuts, omega_of_rate(rates, display.period))
    inner = cuts[(cuts > lower) & (cuts < upper)]
    return np.array([lower, *inner, upper])


class _Pairs(NamedTuple):
    """Pairs of an item and a piece that are not decided yet, the pairs of an item together."""

    omega: FloatArray  # (2, pieces) Ends of the pieces, rad/s
    owner: IntArray  # (pieces,) Item of a piece; 0 where one display serves all items
    item: IntArray  # (pairs,)
    piece: IntArray  # (pairs,)

    @classmethod
    def start(cls, cuts: FloatArray, count: int, *, shared: bool) -> _Pairs:
        """Pair every item with every piece; with `shared` all items have the same pieces."""
        omega = np.stack([cuts[:-1], cuts[1:]])
        piece = np.arange(cuts.size - 1)
        item = np.repeat(np.arange(count), piece.size)
        if shared:
            return cls(omega, np.zeros_like(piece), item, np.tile(piece, count))
        return cls(np.tile(omega, count), item, item, np.arange(item.size))

    def select(self, which: BoolArray) -> _Pairs:
        """Keep some of the pairs, and the pieces in them."""
        piece = self.piece[which]
        used = np.zeros(self.owner.size, dtype=bool)
        used[piece] = True
        new_index = np.cumsum(used) - 1
        return _Pairs(self.omega[:, used], self.owner[used], self.item[which], new_index[piece])

    def halved(self) -> _Pairs:
        """Cut every piece in two, evenly in log ω."""
        low, high = self.omega
        starts = np.column_stack([low, self.middle])
        ends = np.column_stack([self.middle, high])
        omega = np.stack([starts.ravel(), ends.ravel()])
        first_half = 2 * self.piece
        piece = np.column_stack([first_half, first_half + 1]).ravel()
        owner = np.repeat(self.owner, 2)
        return _Pairs(omega, owner, np.repeat(self.item, 2), piece)

    @property
    def middle(self) -> FloatArray:
        """Geometric middle of each piece, (pieces,)."""
        low, high = self.omega
        return np.sqrt(low * high)


class PlaneDepartures(NamedTuple):
    """How far stiffness or damping leaves its limits at most, (N,); negative inside."""

    largest: FloatArray  # In widths of the limits
    omega: FloatArray  # Where, rad/s


def plane_departures(display: Display, boxes: Boxes, lower: float, upper: float) -> PlaneDepartures:
    """Return how far the stiffness and damping shown leave boxes at most over a range of ω.

    Parameters
    ----------
    display : Display
        One display, or N.
    boxes : Boxes
        One box, or N. A box without width counts as one unit wide.
    lower, upper : float
        Ends of the range, rad/s, between 0 and π/T.

    Returns
    -------
    PlaneDepartures
        Of shape (N,).

    Raises
    ------
    UsageError
        The range passes Nyquist; T not positive.
    """
    displays = [display]
    if display.count is not None and turns(display):
        displays = [display.select(np.array(n)) for n in range(display.count)]
    places = [turning_points(single, lower, upper) for single in displays]
    most = max(points.size for points in places)
    # Columns with fewer turning points are padded with the upper end.
    omega = np.full((most, len(places)), float(upper))
    for column, points in zip(omega.T, places, strict=True):
        column[: points.size] = points
    shown = shown_element(warp(omega, display.period), display)
    by_stiffness = boxes.stiffness.widths_off(shown.stiffness)
    by_damping = boxes.damping.widths_off(shown.damping)
    off, omega = np.broadcast_arrays(np.maximum(by_stiffness, by_damping), omega)
    top = off.argmax(axis=0)[None]
    largest = np.take_along_axis(off, top, axis=0)
    where = np.take_along_axis(omega, top, axis=0)
    return PlaneDepartures(largest[0], where[0])
