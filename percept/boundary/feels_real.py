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

from percept.boundary.users import DiscIntegral, Users, choose_integral, share_within
from percept.haptics.containment import plane_departures
from percept.haptics.impedance import warp
from percept.haptics.perceived import DistancePlane, Point, shown_element
from percept.haptics.records import Display
from percept.html import NotebookRecord

__all__ = [
    "Evidence",
    "Feeling",
    "feels_real",
    "judge",
    "least_margins",
    "magnitude_margins",
    "search_grid",
]

Array = NDArray[np.float64]
Feeling: TypeAlias = Literal["feels real", "does not", "too little data"]

#: Frequencies per decade before the search between them.
_PER_DECADE = 12
#: Half-widths of a resonance at which abs(Z_h) is looked at on either side.
_BESIDE = np.array([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0])
#: A margin of a draw, in SDs of a normal, below which rounding and the search decide.
_TOO_NEAR = 1e-6
#: A dip between frequencies is searched where the margin beside it is below this, in SDs.
_SEARCHED_BELOW = 1.0
#: Accuracy of the log omega of a dip; the margin is flat there.
_DIP_PLACE = 1e-5
#: Accuracy of the margin of a dip, in SDs.
_DIP_MARGIN = 1e-8
#: Draws judged first; they are doubled while the error straddles a threshold.
_FIRST_DRAWS = 512
#: Accuracy of shares that are looked at first; a margin near zero is then worked out again.
_FIRST_ACCURACY = 1e-4
#: Margins, in SDs, below which the first shares do not tell the sign.
_UNSURE_BELOW = 0.1
#: Standard errors between a probability and a threshold that decide.
_CLEAR = 2.0
#: Values of (draws, frequencies, nodes) computed at once.
_PASS = 1 << 20
#: Populations that show how the integral is best taken.
_TRIED = 8


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
        gaps = abs(self.probability - decision), abs(self.probability - (1.0 - decision))
        return min(gaps) > _CLEAR * self.error


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
    judged: list[_Margins] = []
    start = 0
    stop = min(_FIRST_DRAWS, users.size)
    while True:
        some = users.select(slice(start, stop))
        judged.append(_search_margins(display, some, omega, level))
        evidence = _evidence(judged, inside_plane[:stop], omega)
        if stop == users.size or evidence.clear_of(decision):
            return evidence
        start = stop
        stop = min(2 * stop, users.size)


def _evidence(judged: list[_Margins], inside_plane: NDArray[np.bool_], omega: Array) -> Evidence:
    """Count the draws under which a display feels real."""
    least = np.concatenate([margins.least for margins in judged])
    inside_at = sum(np.count_nonzero(margins.at_omega >= 0.0, axis=0) for margins in judged)
    draws = least.size
    inside = least >= 0.0
    too_near = float((np.abs(least) < _TOO_NEAR).mean())
    probability = float((inside & inside_plane).mean())
    # Where all draws agree the binomial error counts as one draw.
    binomial = max(float(np.sqrt(probability * (1.0 - probability) / draws)), 1.0 / draws)
    lowest = int(np.argmin(inside_at))
    return Evidence(
        probability=probability,
        magnitude=float(inside.mean()),
        plane=float(inside_plane.mean()),
        lowest=float(np.min(inside_at)) / draws,
        lowest_omega=float(omega[lowest]),
        error=binomial + too_near,
        too_near=too_near,
        draws=draws,
    )


def search_grid(lower: float, upper: float, resonances: Array, half_widths: Array) -> Array:
    """Choose frequencies from `lower` to `upper`, rad/s, that no dip of a margin lies unseen between.

    `half_widths` are relative, one per resonance.
    """
    count = max(3, int(np.ceil(_PER_DECADE * np.log10(upper / lower))) + 1)
    beside = resonances[:, None] * np.exp(half_widths[:, None] * _BESIDE)
    inside = beside[(beside > lower) & (beside < upper)]
    return np.unique(np.concatenate([np.geomspace(lower, upper, count), inside]))


def magnitude_margins(display: Display, users: Users, omega: Array, *, level: float) -> Array:
    """Return by how many SDs of a normal abs(Z_h) lies inside its central range, (D, M).

    The share of users with less than what is displayed, as a normal score, is compared with those
    of both ends of the range. Negative outside.
    """
    disc = _Disc.of(display, omega)
    return _margins_on(disc, _integrals(disc, users), users, level)


def _integrals(disc: _Disc, users: Users) -> list[DiscIntegral]:
    """Return how the share is best integrated at each frequency, by a few of the populations."""
    return choose_integral(_few(users), disc.plane, disc.radius)


def _first_integrals(disc: _Disc, users: Users) -> list[DiscIntegral]:
    chosen = choose_integral(_few(users), disc.plane, disc.radius, _FIRST_ACCURACY)
    # The difference that settled is the error of half the nodes.
    return [integral._replace(nodes=integral.nodes // 2) for integral in chosen]


def _few(users: Users) -> Users:
    return users.select(slice(None, None, max(1, users.size // _TRIED))).column()


def _margins_on(disc: _Disc, integrals: list[DiscIntegral], users: Users, level: float) -> Array:
    margins = np.empty((users.size, len(integrals)))
    for integral in set(integrals):
        (columns,) = np.nonzero([other == integral for other in integrals])
        part = disc.select(columns)
        step = max(1, _PASS // (columns.size * integral.nodes))
        for start in range(0, users.size, step):
            some = users.select(slice(start, start + step)).column()
            shares = share_within(some, part.plane, part.radius, integral)
            margins[start : start + step, columns] = _margin(shares, level)
    return margins


def _make_sure(
    margins: Array, disc: _Disc, integrals: list[DiscIntegral], users: Users, level: float
) -> None:
    """Work margins near zero out again, with all digits."""
    unsure = np.abs(margins) < _UNSURE_BELOW
    for integral in set(integrals):
        here = unsure & np.array([other == integral for other in integrals])
        draw, column = np.nonzero(here)
        if draw.size:
            there = disc.select(column)
            some = users.select(draw)
            shares = share_within(some, there.plane, there.radius, integral)
            margins[draw, column] = _margin(shares, level)


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
        return cls(plane, plane.distance(Point(shown.stiffness, shown.damping)))

    def select(self, which: NDArray[np.intp]) -> _Disc:
        return _Disc(self.plane.select(which), self.radius[which])


def _margin(shares: Array, level: float) -> Array:
    edge = -special.ndtri(0.5 * (1.0 - level))
    return np.asarray(edge - np.abs(special.ndtri(np.clip(shares, 0.0, 1.0))))


def least_margins(display: Display, users: Users, omega: Array, *, level: float) -> Array:
    """Return each draw's smallest margin over the range; outside, that of the grid is enough."""
    return _search_margins(display, users, omega, level).least


class _Margins(NamedTuple):
    """Margins of D draws."""

    at_omega: Array  # (D, M)
    least: Array  # (D,) Over the whole range


def _search_margins(display: Display, users: Users, omega: Array, level: float) -> _Margins:
    """Look at every frequency, and between those where a margin dips."""
    disc = _Disc.of(display, omega)
    margins = _margins_on(disc, _first_integrals(disc, users), users, level)
    integrals = _integrals(disc, users)
    _make_sure(margins, disc, integrals, users, level)
    least = margins.min(axis=1)
    middle = margins[:, 1:-1]
    dips = (middle <= margins[:, :-2]) & (middle <= margins[:, 2:])
    dips &= (least >= 0.0)[:, None] & (middle < _SEARCHED_BELOW)
    log_omega = np.log(omega)
    for integral in set(integrals):
        here = dips & np.array([other == integral for other in integrals[1:-1]])
        draw, before = np.nonzero(here)
        if not draw.size:
            continue

        def margin_at(place: Array, draw: Array, integral: DiscIntegral = integral) -> Array:
            there = _Disc.of(display, np.exp(place))
            some = users.select(draw.astype(np.intp))
            return _margin(share_within(some, there.plane, there.radius, integral), level)

        lowest = elementwise.find_minimum(
            margin_at,
            (log_omega[before], log_omega[before + 1], log_omega[before + 2]),
            args=(draw.astype(float),),
            tolerances={"xatol": _DIP_PLACE, "fatol": _DIP_MARGIN, "xrtol": 0.0, "frtol": 0.0},
        )
        # A flat dip, which the next integral would not show, has no bracket and no result.
        np.fmin.at(least, draw, lowest.f_x)
    return _Margins(margins, least)
