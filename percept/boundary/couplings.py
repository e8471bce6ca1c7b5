"""How probably many couplings of one environment feel real, for maps."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.boundary.users import MagnitudeRanges, Users, magnitude_ranges
from percept.haptics.perceived import Display, shown_element
from percept.haptics.plane import DistancePlane, Point, Range
from percept.haptics.records import Coupling

__all__ = ["CouplingJudge"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]


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

    def __init__(self, display: Display, users: Users, omega: Array, *, central: float) -> None:
        self._display = display
        self._users = users
        self._omega = omega
        self._central = central
        self._boxes = users.central_ranges(central)
        grid = display.loop.at(omega)
        self._plane = DistancePlane.of(grid, display.environment.mass).flat()
        # Ranges of abs(Z_h), the most work, are for draws that k and b do not rule out.
        self._ranged = np.zeros(users.size, dtype=bool)
        lower = np.empty((users.size, omega.size))
        upper = np.empty_like(lower)
        self._ranges = MagnitudeRanges(lower, upper)

    def probabilities(self, couplings: Coupling) -> Array:
        """Return the share of draws under which each coupling feels real.

        Parameters
        ----------
        couplings : Coupling
            Of C stiffnesses, N/m, and dampings, N·s/m.

        Returns
        -------
        ndarray, shape (C,)
        """
        display = dataclasses.replace(self._display, coupling=couplings)
        grid = display.loop.at(self._omega[:, None])
        shown = shown_element(grid, display)
        stiffness, damping = np.broadcast_arrays(shown.stiffness, shown.damping)
        inside = self._inside_plane(stiffness, damping)
        (rows,) = np.nonzero(inside.any(axis=1))
        (draws,) = np.nonzero(inside.any(axis=0))
        known = self._ranged[draws]
        self._work_out(draws[~known])
        cells = np.ix_(rows, draws)
        kept = inside[cells]
        shown_points = Point(stiffness[:, rows], damping[:, rows])
        displayed = self._plane.column().distance(shown_points)
        for index, radius in enumerate(displayed):
            lower = self._ranges.lower[draws, index]
            upper = self._ranges.upper[draws, index]
            column = radius[:, None]
            kept &= column >= lower
            kept &= column <= upper
        counts = kept.sum(axis=1)
        probabilities = np.zeros(len(inside))
        probabilities[rows] = counts / self._users.size
        return probabilities

    def _inside_plane(self, stiffness: Array, damping: Array) -> Flags:
        """Say under which draws what is shown, (M, C), lies in the ranges of k and b, (C, D)."""
        by_stiffness = _stays_in(stiffness, self._boxes.stiffness)
        by_damping = _stays_in(damping, self._boxes.damping)
        return by_stiffness & by_damping

    def _work_out(self, draws: Indices) -> None:
        """Work out the ranges of abs(Z_h) of some draws."""
        if draws.size:
            some = self._users.select(draws)
            found = magnitude_ranges(some, self._plane, self._central)
            self._ranges.lower[draws] = found.lower
            self._ranges.upper[draws] = found.upper
            self._ranged[draws] = True


def _stays_in(shown: Array, limits: Range) -> Flags:
    """Say which columns of (M, C) stay in each of D ranges, (C, D)."""
    least = shown.min(axis=0)[:, None]
    most = shown.max(axis=0)[:, None]
    return (least >= limits.low) & (most <= limits.high)
