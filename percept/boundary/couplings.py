"""How probably many couplings of one environment feel real, for maps."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.shares import Users, chosen_integrals, score_of, shares_of_cells
from percept.haptics.perceived import Boxes, Display, DistancePlane, Point, Range, shown_element
from percept.haptics.records import Coupling
from percept.searches import secant_root

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]

#: Accuracy of the normal score of a limit; a map shows no finer step.
_SCORE_ACCURACY = 1e-3
#: Shares nearer to 0 or 1 than this count as this much: a normal score stays finite.
_LEAST_SHARE = 1e-9
#: Of how far the largest abs(Z_h) of users lies above the least, the fraction below which next to
#: no user lies.
_LEAST_FRACTION = 1e-6


class CouplingJudge:
    """Judges many couplings of one environment under the same draws of its users.

    Central ranges of abs(Z_h) are worked out once; then each coupling is a matter of comparisons.
    Dips between the frequencies are not searched: `feels_real` does so for single couplings.

    Parameters
    ----------
    display : Display
        The environment and the device; a coupling of its own is passed over.
    users : Users
        D populations.
    omega : ndarray, shape (M,)
        rad/s, increasing, from `percept.boundary.feels_real.search_grid`.
    central : float
        Share of all users that a central range holds.
    """

    def __init__(
        self,
        display: Display,
        users: Users,
        omega: Array,
        *,
        central: float,
    ) -> None:
        self._display = display
        self._users = users
        self._omega = omega
        self._central = central
        self._boxes = users.central_ranges(central)
        grid = display.loop.at(omega)
        self._plane = DistancePlane.of(grid, display.environment.mass).flat()
        # Ranges of abs(Z_h), the most work, are for draws that k and b do not rule out.
        self._ranged = np.zeros(users.size, dtype=bool)
        unknown = np.empty((users.size, omega.size))
        self._ranges = Range(unknown, unknown.copy())
        # Where abs(Z_h) is looked at, and which of these ruled out a coupling under some draw.
        self._looked_at = np.arange(omega.size)
        self._decides = np.zeros(omega.size, dtype=bool)

    def probabilities(self, couplings: Coupling, draws: int) -> Array:
        """Return the share of the first draws under which each coupling feels real.

        Parameters
        ----------
        couplings : Coupling
            Of C stiffnesses, N/m, and dampings, N·s/m.
        draws : int
            Number of draws, at most D.

        Returns
        -------
        ndarray, shape (C,)
        """
        display = dataclasses.replace(self._display, coupling=couplings)
        grid = display.loop.at(self._omega[:, None])
        shown = shown_element(grid, display)
        stiffness, damping = np.broadcast_arrays(shown.stiffness, shown.damping)
        inside = _stays_in(stiffness, self._boxes.stiffness, draws)
        inside &= _stays_in(damping, self._boxes.damping, draws)
        (rows,) = np.nonzero(inside.any(axis=1))
        (columns,) = np.nonzero(inside.any(axis=0))
        new = columns[~self._ranged[columns]]
        if new.size:
            found = magnitude_ranges(self._users.select(new), self._plane, self._central)
            self._ranges.low[new] = found.low
            self._ranges.high[new] = found.high
            self._ranged[new] = True
        kept = inside[np.ix_(rows, columns)]
        looked_at = np.ix_(self._looked_at, rows)
        shown_points = Point(stiffness[looked_at], damping[looked_at])
        displayed = self._plane.column().distance(shown_points)
        for index, radius in enumerate(displayed):
            column = radius[:, None]
            within = column >= self._ranges.low[columns, index]
            within &= column <= self._ranges.high[columns, index]
            self._decides[index] |= bool(np.any(kept & ~within))
            kept &= within
        probabilities = np.zeros(len(inside))
        probabilities[rows] = kept.sum(axis=1) / draws
        return probabilities

    def only_deciding(self) -> None:
        """Look at abs(Z_h) only at the frequencies that ruled out a coupling so far."""
        decides = self._decides
        self._looked_at = self._looked_at[decides]
        self._plane = self._plane.select(decides)
        self._ranges = Range(self._ranges.low[:, decides], self._ranges.high[:, decides])
        self._decides = decides[decides]


def _stays_in(shown: Array, limits: Range, draws: int) -> Flags:
    """Say which columns of (M, C) stay in the ranges of the first draws, (C, draws)."""
    least = shown.min(axis=0)[:, None]
    most = shown.max(axis=0)[:, None]
    return (least >= limits.low[:draws]) & (most <= limits.high[:draws])


def magnitude_ranges(users: Users, plane: DistancePlane, level: float) -> Range:
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
    Range
        N·s/m, (D, M), to about a ten-thousandth.
    """
    tail = 0.5 * (1.0 - level)
    # Outside one of four such limits lie fewer users than in one tail of abs(Z_h).
    box_level = 1.0 - 0.5 * tail
    boxes = users.central_ranges(box_level)
    least = np.zeros(plane.gain.shape)
    if users.log:
        # Nobody takes less than zero. Over what is above this distance scores are next to straight.
        stiffness, damping = plane.origin()
        nearest = Point(np.maximum(stiffness, 0.0), np.maximum(damping, 0.0))
        least = plane.distance(nearest)
    logs = _log_range(boxes, plane, least)
    middle = 0.5 * (logs.low + logs.high)
    one_device = DistancePlane(*(field[None] for field in plane))
    median = least + np.exp(np.median(middle, axis=0))
    integrals = chosen_integrals(users, one_device, median[None])
    edge = score_of(level)
    draw, column = np.indices(middle.shape).reshape(2, -1)
    of_cells = users.select(draw), plane.select(column), least[column], integrals[column]
    limits = []
    for score in (-edge, edge):
        start = middle + score / score_of(box_level) * (logs.high - middle)
        # Scores are zero in the middle, and next to straight: the first slope leads close. Where
        # next to no user lies below the low end it is the limit.
        log_above = secant_root(
            functools.partial(_missing, *of_cells, score),
            start.ravel(),
            logs.low.ravel(),
            logs.high.ravel(),
            known=(middle.ravel(), np.full(draw.size, -score)),
        )
        limits.append(least + np.exp(log_above).reshape(middle.shape))
    return Range(*limits)


def _log_range(boxes: Boxes, plane: DistancePlane, least: Array) -> Range:
    """Return the ends of abs(Z_h) over the box of each population, (D, M): logs of what is above.

    `least` are the smallest abs(Z_h), (M,).
    """
    k, b = ((limits.low[:, None], limits.high[:, None]) for limits in boxes)
    nearest, farthest = plane.over(k, b)
    above = farthest - least
    low = np.log(np.maximum(nearest - least, _LEAST_FRACTION * above))
    return Range(low, np.log(above))


def _missing(
    users: Users,
    plane: DistancePlane,
    least: Array,
    integrals: Indices,
    wanted: float,
    which: Indices,
    log_above: Array,
) -> Array:
    """Return normal scores of the shares within discs, less the score sought.

    Some of n populations are asked for, each at a frequency of its own. A disc reaches as far above
    the least abs(Z_h) as its logarithm says.
    """
    radius = least[which] + np.exp(log_above)
    shares = shares_of_cells(users.select(which), plane.select(which), radius, integrals[which])
    scores = special.ndtri(np.clip(shares, _LEAST_SHARE, 1.0 - _LEAST_SHARE))
    missing = np.asarray(scores - wanted)
    missing[np.abs(missing) < _SCORE_ACCURACY] = 0.0
    return missing
