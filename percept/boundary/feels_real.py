"""Evidence that a display feels real: it lies in the central range of users at every omega.

Each posterior draw is a population of users. Under a draw a display feels real where at every omega
of the range abs(Z_h) lies in the central range of its users' abs(Z_h), and effective stiffness and
damping lie each in their own. Wide limits of few subjects are no evidence here: they make some
draws hold the display and others not.
"""

from __future__ import annotations

import dataclasses
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import elementwise

from percept.boundary.users import (
    PASS,
    DiscIntegral,
    MagnitudeRanges,
    Users,
    by_integral,
    choose_integral,
    magnitude_ranges,
    share_within,
)
from percept.haptics.axis import warp
from percept.haptics.containment import Range, plane_departures
from percept.haptics.perceived import DistancePlane, Point, shown_element
from percept.haptics.records import Coupling, Display
from percept.html import NotebookRecord

__all__ = [
    "CouplingJudge",
    "Evidence",
    "Feeling",
    "Margins",
    "MarginsAt",
    "feels_real",
    "judge",
    "rough_probability",
    "search_grid",
    "search_margins",
    "share_error",
]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Feeling: TypeAlias = Literal["feels real", "does not", "too little data"]

#: Frequencies per decade before the search between them: each a fifth above the one before. Only at
#: a resonance abs(Z_h) bends over less.
_PER_DECADE = 12
#: Half-widths of a resonance at which abs(Z_h) is looked at on either side.
_BESIDE = np.array([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0])
#: A margin of a draw, in SDs of a normal, below which rounding and the search decide.
_TOO_NEAR = 1e-6
#: A dip between frequencies is searched where the margin beside it is below this, in SDs: from far
#: inside none reaches zero between two frequencies.
_SEARCHED_BELOW = 1.0
#: Accuracy of the log omega of a dip; the margin is flat there.
_DIP_PLACE = 1e-5
#: Accuracy of the margin of a dip, in SDs.
_DIP_MARGIN = 1e-8
#: Draws judged first; they are doubled while the error straddles a threshold.
_FIRST_DRAWS = 512
#: Accuracy of shares that are looked at first; a margin near zero is then worked out again.
_FIRST_ACCURACY = 1e-4
#: Margins, in SDs, below which the first shares do not tell the sign: at the edge of a 99 % range
#: 1e-4 of the users are 0.007 SDs.
_UNSURE_BELOW = 0.1
#: Standard errors between a probability and a threshold that decide.
_CLEAR = 2.0


@dataclasses.dataclass(frozen=True)
class Evidence(NotebookRecord):
    """Posterior probability that a display feels real at every omega of a range."""

    probability: float  # By abs(Z_h) and by effective stiffness and damping
    magnitude: float  # By abs(Z_h) alone
    plane: float  # By effective stiffness and damping alone
    lowest: float  # By abs(Z_h) at the one omega where it is least probable
    lowest_omega: float  # rad/s
    error: float  # Monte Carlo standard error of `probability`, with the draws that are too near
    too_near: float  # Share of draws whose margin is below what the search resolves
    draws: int

    def clear_of(self, decision: float) -> bool:
        """Whether the probability is clear of both thresholds, `decision` and one minus it."""
        from_real = abs(self.probability - decision)
        from_not = abs(self.probability - (1.0 - decision))
        return min(from_real, from_not) > _CLEAR * self.error


def judge(probability: float, decision: float) -> Feeling:
    """Turn a probability into one of three outcomes."""
    if probability >= decision:
        return "feels real"
    return "does not" if probability <= 1.0 - decision else "too little data"


def feels_real(
    display: Display, users: Users, omega: Array, *, level: float, decision: float
) -> Evidence:
    """Judge a display under draws of the population, as many as the verdict needs.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    users : Users
        D populations, in random order.
    omega : ndarray, shape (M,)
        rad/s, from `search_grid`; dips between these frequencies are searched.
    level : float
        Share of all users that a central range holds.
    decision : float
        Probability from which a display is said to feel real.

    Returns
    -------
    Evidence
        From the first draws, doubled until the verdict is clear or all are used.
    """
    ranges = users.central_ranges(level)
    departures = plane_departures(display, ranges, omega[0], omega[-1])
    inside_plane = departures.largest <= 0.0
    judged: list[Margins] = []
    start = 0
    stop = min(_FIRST_DRAWS, users.size)
    while True:
        some = users.select(slice(start, stop))
        judged.append(search_margins(display, some, omega, level))
        evidence = _evidence(judged, inside_plane[:stop], omega)
        if stop == users.size or evidence.clear_of(decision):
            return evidence
        start = stop
        stop = min(2 * stop, users.size)


def rough_probability(display: Display, users: Users, omega: Array, *, level: float) -> float:
    """Return the share of draws under which a display feels real, without a search between omega.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    users : Users
        D populations.
    omega : ndarray, shape (M,)
        rad/s, dense where margins dip.
    level : float
        Share of all users that a central range holds.

    Returns
    -------
    float
        For maps: shares of users are known to some ten-thousandths.
    """
    ranges = users.central_ranges(level)
    departures = plane_departures(display, ranges, omega[0], omega[-1])
    (inside,) = np.nonzero(departures.largest <= 0.0)
    if not inside.size:
        return 0.0
    some = users.select(inside)
    margins = MarginsAt(display, some, omega, level, _FIRST_ACCURACY).of(some)
    least = margins.min(axis=1)
    return np.count_nonzero(least >= 0.0) / users.size


def share_error(share: float, count: int) -> float:
    """Return the standard error of a share of `count` independent draws.

    Where all draws agree it is one draw: by Wilson's interval of one standard error the truth may
    lie 1/(count + 1) away.
    """
    variance = share * (1.0 - share) / count
    return max(float(np.sqrt(variance)), 1.0 / count)


def _evidence(judged: list[Margins], inside_plane: Flags, omega: Array) -> Evidence:
    """Count the draws under which a display feels real."""
    least = np.concatenate([margins.least for margins in judged])
    draws = least.size
    inside = least >= 0.0
    inside_at = np.zeros(omega.size)
    for margins in judged:
        inside_at += np.count_nonzero(margins.at_omega >= 0.0, axis=0)
    near = np.abs(least) < _TOO_NEAR
    too_near = float(near.mean())
    probability = float((inside & inside_plane).mean())
    lowest = int(np.argmin(inside_at))
    return Evidence(
        probability=probability,
        magnitude=float(inside.mean()),
        plane=float(inside_plane.mean()),
        lowest=float(np.min(inside_at)) / draws,
        lowest_omega=float(omega[lowest]),
        error=share_error(probability, draws) + too_near,
        too_near=too_near,
        draws=draws,
    )


def search_grid(lower: float, upper: float, resonances: Array, half_widths: Array) -> Array:
    """Choose frequencies from `lower` to `upper`, rad/s, so close that no dip of a margin hides.

    `half_widths` are relative, one per resonance.
    """
    decades = np.log10(upper / lower)
    intervals = int(np.ceil(_PER_DECADE * decades))
    even = np.geomspace(lower, upper, max(3, intervals + 1))
    distances = half_widths[:, None] * _BESIDE
    beside = resonances[:, None] * np.exp(distances)
    inside = beside[(beside > lower) & (beside < upper)]
    return np.unique(np.concatenate([even, inside]))


@dataclasses.dataclass(frozen=True)
class _Disc:
    """Around where abs(Z_h) vanishes, through what is displayed, at frequencies (M,)."""

    plane: DistancePlane
    radius: Array  # abs(Z_h) as displayed, N·s/m

    @classmethod
    def of(cls, display: Display, omega: Array) -> _Disc:
        grid = warp(omega, display.period)
        mass = display.environment.mass
        plane = DistancePlane.of(grid, display.device, display.hold, mass).flat()
        shown = shown_element(grid, display)
        displayed = Point(shown.stiffness, shown.damping)
        return cls(plane, plane.distance(displayed))

    def select(self, which: Indices | Flags) -> _Disc:
        return _Disc(self.plane.select(which), self.radius[which])

    def margins(self, users: Users, integral: DiscIntegral, level: float) -> Array:
        """Return margins of populations, whose shape broadcasts with that of the frequencies."""
        shares = share_within(users, self.plane, self.radius, integral)
        edge = -special.ndtri(0.5 * (1.0 - level))
        score = special.ndtri(np.clip(shares, 0.0, 1.0))
        return np.asarray(edge - np.abs(score))


class Margins(NamedTuple):
    """By how many SDs of a normal abs(Z_h) lies inside its central range; negative outside.

    The share of users with less than what is displayed, as a normal score, is compared with those
    of both ends of the range.
    """

    at_omega: Array  # (D, M) of D draws; those near zero have all digits
    least: Array  # (D,) over the whole range; outside, that of the M frequencies is enough


class MarginsAt:
    """Margins at frequencies (M,), for many populations like those that show how to integrate.

    Shares are integrated to an accuracy.
    """

    def __init__(
        self, display: Display, like: Users, omega: Array, level: float, accuracy: float
    ) -> None:
        self._disc = _Disc.of(display, omega)
        self._level = level
        chosen = choose_integral(like.few(), self._disc.plane, self._disc.radius, accuracy)
        self._integrals = by_integral(chosen)

    def of(self, users: Users) -> Array:
        """Return the margins (D, M) of populations."""
        margins = np.empty((users.size, self._disc.radius.size))
        for integral, frequencies in self._integrals.items():
            part = self._disc.select(frequencies)
            step = max(1, PASS // (part.radius.size * integral.nodes))
            for start in range(0, users.size, step):
                rows = slice(start, start + step)
                some = users.select(rows).column()
                margins[rows, frequencies] = part.margins(some, integral, self._level)
        return margins


def search_margins(display: Display, users: Users, omega: Array, level: float) -> Margins:
    """Look at every frequency of `omega` (M,), and between those where a margin dips."""
    disc = _Disc.of(display, omega)
    exact = by_integral(choose_integral(users.few(), disc.plane, disc.radius))
    margins = MarginsAt(display, users, omega, level, _FIRST_ACCURACY).of(users)
    unsure = np.abs(margins) < _UNSURE_BELOW
    # The least has all digits, also where it is no dip but an end of the range.
    unsure[np.arange(users.size), margins.argmin(axis=1)] = True
    for integral, frequencies in exact.items():
        draw, index = np.nonzero(unsure & frequencies)
        if draw.size:
            margins[draw, index] = disc.select(index).margins(users.select(draw), integral, level)
    least = margins.min(axis=1)
    dips = _dips(margins)
    # Of a draw that is outside no dip is asked.
    dips &= (least >= 0.0)[:, None]
    for integral, frequencies in exact.items():
        draw, index = np.nonzero(dips & frequencies)
        if draw.size:
            found = _search_dips(display, users, omega, (draw, index), integral, level)
            # A flat dip, which the next integral would not show, has no bracket and no result.
            np.fmin.at(least, draw, found)
    return Margins(margins, least)


def _dips(margins: Array) -> Flags:
    """Say which margins (D, M) are no larger than both neighbours, and small enough to search."""
    dips = np.zeros(margins.shape, dtype=bool)
    middle = margins[:, 1:-1]
    below_left = middle <= margins[:, :-2]
    below_right = middle <= margins[:, 2:]
    dips[:, 1:-1] = below_left & below_right & (middle < _SEARCHED_BELOW)
    return dips


def _search_dips(
    display: Display,
    users: Users,
    omega: Array,
    dips: tuple[Indices, Indices],
    integral: DiscIntegral,
    level: float,
) -> Array:
    """Return the least margin at each dip, given by its draw and its frequency; NaN without one."""
    draw, index = dips

    def margin_at(log_omega: Array, draw: Array) -> Array:
        disc = _Disc.of(display, np.exp(log_omega))
        return disc.margins(users.select(draw.astype(np.intp)), integral, level)

    log_omega = np.log(omega)
    # SciPy divides zero by zero where three values are equal.
    with np.errstate(invalid="ignore"):
        lowest = elementwise.find_minimum(
            margin_at,
            (log_omega[index - 1], log_omega[index], log_omega[index + 1]),
            args=(draw.astype(float),),
            tolerances={"xatol": _DIP_PLACE, "fatol": _DIP_MARGIN, "xrtol": 0.0, "frtol": 0.0},
        )
    return np.asarray(lowest.f_x)


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
    level : float
        Share of all users that a central range holds.
    """

    def __init__(self, display: Display, users: Users, omega: Array, *, level: float) -> None:
        self._display = display
        self._users = users
        self._omega = omega
        self._level = level
        self._boxes = users.central_ranges(level)
        grid = warp(omega, display.period)
        mass = display.environment.mass
        self._plane = DistancePlane.of(grid, display.device, display.hold, mass).flat()
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
        grid = warp(self._omega[:, None], display.period)
        shown = shown_element(grid, display)
        stiffness, damping = np.broadcast_arrays(shown.stiffness, shown.damping)
        inside = self._inside_plane(stiffness, damping)
        (rows,) = np.nonzero(inside.any(axis=1))
        (draws,) = np.nonzero(inside.any(axis=0))
        known = self._ranged[draws]
        self._work_out(draws[~known])
        cells = np.ix_(rows, draws)
        kept = inside[cells]
        plane = DistancePlane(*(field[:, None] for field in self._plane))
        displayed = plane.distance(Point(stiffness[:, rows], damping[:, rows]))
        for index, radius in enumerate(displayed):
            kept &= radius[:, None] >= self._ranges.lower[draws, index]
            kept &= radius[:, None] <= self._ranges.upper[draws, index]
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
            found = magnitude_ranges(self._users.select(draws), self._plane, self._level)
            self._ranges.lower[draws] = found.lower
            self._ranges.upper[draws] = found.upper
            self._ranged[draws] = True


def _stays_in(shown: Array, limits: Range) -> Flags:
    """Say which columns of (M, C) stay in each of D ranges, (C, D)."""
    least = shown.min(axis=0)[:, None]
    most = shown.max(axis=0)[:, None]
    return (least >= limits.low) & (most <= limits.high)
