"""Evidence that a display feels real: it lies in the central range of users at every omega.

Each posterior draw is a population of users. Its score is how far what is displayed lies from the
median user, in SDs of a normal: the largest over all omega, by abs(Z_h) and by effective stiffness
and damping. Under a draw a display feels real where its score lies within that of the central
range. Wide limits of few subjects are no evidence here: they make some draws hold the display and
others not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.shares import (
    Users,
    chosen_integrals,
    score_of,
    shares_at_frequencies,
    shares_of_cells,
)
from percept.haptics.loop import log_grid
from percept.haptics.perceived import Display, DistancePlane, displayed
from percept.haptics.shown import shown_limits
from percept.searches import section_minimum

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Feeling: TypeAlias = Literal["feels real", "does not", "too little data"]

#: Central shares of users that every display is judged against, beside the one that decides.
CENTRALS = (0.8, 0.9, 0.95, 0.99)
#: Subjects from which on abs(Z_h) may say "does not": of 3 it would in 10 % of unbiased studies.
FEWEST_FOR_MAGNITUDE = 6
#: Frequencies per decade before the search between them: each a fifth above the one before. Only at
#: a resonance abs(Z_h) bends over less.
_PER_DECADE = 12
#: Half-widths of a resonance at which abs(Z_h) is looked at on either side: each twice the last.
_BESIDE = np.array([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0])
#: A distance of a score from the edge, in SDs, below which the accuracy of shares and of the search
#: decides.
_TOO_NEAR = 2e-4
#: Rounds of the search for a peak's score: its place is known to 1e-2 of the bracket, and the score
#: is flat there. And for its place.
_PEAK_ROUNDS = 2
_PLACE_ROUNDS = 3
#: Draws looked at everywhere. Further ones are looked at where one of these is worst, and on either
#: side: of a thousand draws at most one crosses an edge elsewhere alone.
_FIRST_LOOK = 64
#: And where more than this fraction of the most draws lie outside: it may be least probable there.
_NEAR_MOST = 0.9
#: Draws judged first, and on: more where the error straddles a threshold.
DRAWS = (512, 1024, 2048, 4096)
#: The same behind a map or another device: 0.95 is known to 0.014 and 0.007 by them.
MAP_DRAWS = (256, 1024)
#: Standard errors between a probability and a threshold that decide.
_CLEAR = 2.0


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """Posterior probability that a display feels real at every omega of a range."""

    probability: float  # By abs(Z_h) and by effective stiffness and damping
    magnitude: float  # By abs(Z_h) alone
    plane: float  # By effective stiffness and damping alone
    by_central: tuple[float, ...]  # Probability against each further central share
    error: float  # Monte Carlo standard error of `probability`, with the draws that are too near
    scores: Array  # (D,) Largest distance of each draw from its median user, in SDs
    real: Flags  # (D,) Under which draws it feels real
    lowest: float = 1.0  # By abs(Z_h) at the one omega where it is least probable
    lowest_omega: float = np.nan  # rad/s; of many devices, the median of theirs

    @property
    def draws(self) -> int:
        """Number of draws, D."""
        return self.real.size

    def clear_of(self, decision: float) -> bool:
        """Whether the probability is clear of both thresholds, `decision` and one minus it."""
        from_real = abs(self.probability - decision)
        from_not = abs(self.probability - (1.0 - decision))
        return min(from_real, from_not) > _CLEAR * self.error

    def outcome(self, decision: float, subjects: int) -> Feeling:
        """Judge; of few subjects stiffness and damping alone may say "does not"."""
        found = judge(self.probability, decision)
        if found == "does not" and subjects < FEWEST_FOR_MAGNITUDE:
            return "does not" if self.plane <= 1.0 - decision else "too little data"
        return found


def judge(probability: float, decision: float) -> Feeling:
    """Turn a probability into one of three outcomes."""
    if probability >= decision:
        return "feels real"
    return "does not" if probability <= 1.0 - decision else "too little data"


def feels_real(
    display: Display,
    users: Users,
    omega: Array,
    *,
    central: float,
    decision: float,
    draws: Sequence[int] = DRAWS,
    brief: bool = False,
) -> Evidence:
    """Judge a display under draws of the population, as many as the verdict needs.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling; or D, of a device for each population.
    users : Users
        D populations, in random order.
    omega : ndarray, shape (M,) or (D, M)
        rad/s, from `search_grid`; peaks between these frequencies are searched.
    central : float
        Share of all users that a central range holds.
    decision : float
        Probability from which a display is said to feel real.
    draws : sequence of int
        Numbers of draws after which the verdict may be clear.
    brief : bool
        Whether to find the probability alone: not the least probable omega between
        frequencies, nor the probability against other central shares.

    Returns
    -------
    Evidence
        From the first draws, and from more until the verdict is clear or all are used.
    """
    plane = plane_scores(display, users, float(omega.min()), float(omega.max()))
    centrals = () if brief else CENTRALS
    edges = np.unique([score_of(share) for share in (central, *centrals)])
    if omega.ndim == 1 and not brief:
        omega = np.union1d(omega, _typical_peaks(display, users, omega))
    looked_at = np.arange(omega.shape[-1])
    integrals = None
    outside = np.zeros(looked_at.size)
    magnitude = np.empty(0)
    for stop in (_FIRST_LOOK, *draws):
        some = np.arange(magnitude.size, min(stop, users.size))
        shown = display if display.count is None else display.select(some)
        some_omega = omega[looked_at] if omega.ndim == 1 else omega[some]
        scores = search_scores(shown, users.select(some), some_omega, edges, integrals)
        magnitude = np.append(magnitude, scores.largest)
        outside[looked_at] += np.count_nonzero(scores.at_omega > score_of(central), axis=0)
        evidence = _evidence(magnitude, plane[: magnitude.size], central, centrals)
        if magnitude.size == users.size or (some[0] > 0 and evidence.clear_of(decision)):
            break
        integrals = scores.integrals
        if omega.ndim == 1 and some[0] == 0:
            worst = np.bincount(scores.at_omega.argmax(axis=1), minlength=looked_at.size)
            decides = np.convolve(worst, np.ones(3), mode="same") > 0.0
            if not brief:
                decides |= outside > _NEAR_MOST * outside.max()
            looked_at = np.flatnonzero(decides)
            integrals = integrals[looked_at]
    lowest = int(np.argmax(outside))
    return dataclasses.replace(
        evidence,
        lowest=1.0 - float(outside[lowest]) / magnitude.size,
        lowest_omega=float(np.median(omega[..., lowest])),
    )


def plane_scores(
    display: Display,
    users: Users,
    lower: float,
    upper: float,
) -> Array:
    """Return how far stiffness and damping as displayed lie from the median user's, in SDs, (D,).

    The farther of both, at its farthest omega of a range, rad/s.
    """
    shown = shown_limits(display, lower, upper)
    farthest = np.zeros(users.size)
    for quantity, limits in enumerate(shown):
        for end in limits:
            score = np.abs(users.score(end, quantity))
            farthest = np.maximum(farthest, score)
    return farthest


def share_error(share: float, count: int) -> float:
    """Return the standard error of a share of `count` independent draws.

    Where all draws agree it is one draw: by Wilson's interval of one standard error the truth may
    lie 1/(count + 1) away.
    """
    variance = share * (1.0 - share) / count
    return max(float(np.sqrt(variance)), 1.0 / count)


def _evidence(
    magnitude: Array, plane: Array, central: float, centrals: Sequence[float]
) -> Evidence:
    """Count the draws under which a display feels real, by their scores (D,)."""
    edge = score_of(central)
    largest = np.maximum(magnitude, plane)
    inside = largest <= edge
    too_near = float(np.mean(np.abs(magnitude - edge) < _TOO_NEAR))
    probability = float(np.mean(inside))
    return Evidence(
        probability=probability,
        magnitude=float(np.mean(magnitude <= edge)),
        plane=float(np.mean(plane <= edge)),
        by_central=tuple(float(np.mean(largest <= score_of(share))) for share in centrals),
        error=share_error(probability, inside.size) + too_near,
        scores=largest,
        real=inside,
    )


def search_grid(
    lower: float,
    upper: float,
    resonances: Array,
    half_width: float,
) -> Array:
    """Choose frequencies from `lower` to `upper`, rad/s, so close that no peak of a score hides.

    `half_width` is relative, of each resonance. Resonances (R,) of one device, or (D, R) of D,
    which have frequencies each: (D, M), where those beyond the range stand at its ends.
    """
    beside = resonances[..., None] * np.exp(half_width * _BESIDE)
    near = beside.reshape(*resonances.shape[:-1], -1)
    return log_grid((lower, upper), _PER_DECADE, near)


class Scores(NamedTuple):
    """By how many SDs of a normal abs(Z_h) as displayed lies from the median user's.

    The share of users with less than what is displayed, as a normal score, in size.
    """

    at_omega: Array  # (D, M) of D draws
    integrals: Indices  # (M,) that they were found by
    largest: Array  # (D,) over the whole range, as far as it decides on which side of edges it lies


def _scores(shares: Array) -> Array:
    """Return by how many SDs of a normal shares lie from a half, in size."""
    return np.abs(special.ndtri(np.clip(shares, 0.0, 1.0)))


def search_scores(
    display: Display,
    users: Users,
    omega: Array,
    edges: Array,
    integrals: Indices | None = None,
) -> Scores:
    """Look at every frequency of `omega`, (M,) or (D, M), and between those where a peak decides.

    A peak decides where it may pass the next of the edges, (E,), increasing. Integrals, (M,), are
    chosen unless they are known.
    """
    discs = _discs(display, omega)
    if integrals is None:
        integrals = chosen_integrals(users, *discs)
    scores = _scores(shares_at_frequencies(users, *discs, integrals))
    largest = scores.max(axis=1)
    next_edge = np.append(edges, np.inf)[np.searchsorted(edges, largest)]
    highest = _reach(scores, np.atleast_2d(omega))
    draw, index = np.nonzero(highest > next_edge[:, None])
    if draw.size:
        found, _ = _peaks(display, users, omega, (draw, index), integrals, _PEAK_ROUNDS)
        np.maximum.at(largest, draw, found)
    return Scores(scores, integrals, largest)


def _discs(display: Display, omega: Array) -> tuple[DistancePlane, Array]:
    """Return the plane and the abs(Z_h) of what is displayed at (M,) or (D, M) frequencies.

    By one display in arrays of shape (1, M), by D in such of (D, M).
    """
    omega = np.atleast_2d(omega)
    if display.count is not None:
        omega = np.broadcast_to(omega, (display.count, omega.shape[1]))
        rows = np.arange(display.count)
        display = display.select(np.repeat(rows, omega.shape[1]))
    plane, radius = displayed(display, omega.ravel())
    fields = [field.reshape(omega.shape) for field in plane]
    return DistancePlane(*fields), radius.reshape(omega.shape)


def _typical_peaks(display: Display, users: Users, omega: Array) -> Array:
    """Return where between (M,) frequencies, rad/s, the score of a typical population peaks.

    There the fewest populations hold what is displayed.
    """
    typical = users.typical()
    at_omega, integrals, _ = search_scores(display, typical, omega, np.empty(0))
    draw, index = np.nonzero(np.isfinite(_reach(at_omega, omega[None])))
    _, found = _peaks(display, typical, omega, (draw, index), integrals, _PLACE_ROUNDS)
    return found


def _reach(scores: Array, omega: Array) -> Array:
    """Return how high scores (D, M) may rise between frequencies; minus infinity beside peaks.

    A peak rises above the highest of three scores by at most 1.2 times as much as that lies above
    the lowest, in 4,000 peaks that were searched; here by twice as much.
    """
    reach = np.full(scores.shape, -np.inf)
    left = scores[:, :-2]
    right = scores[:, 2:]
    middle = scores[:, 1:-1]
    differ = np.diff(omega) > 0.0
    # An infinite score passes every edge by itself.
    peaks = np.isfinite(middle) & differ[:, :-1] & differ[:, 1:]
    peaks &= (middle >= left) & (middle >= right)
    lowest = np.minimum(left, right)[peaks]
    highest = middle[peaks]
    reach[:, 1:-1][peaks] = highest + 2.0 * (highest - lowest)
    return reach


def _peaks(
    display: Display,
    users: Users,
    omega: Array,
    peaks: tuple[Indices, Indices],
    integrals: Indices,
    rounds: int,
) -> tuple[Array, Array]:
    """Return the largest score at each of n peaks, by draw and frequency, and its omega, rad/s."""
    draw, index = peaks
    log_omega = np.log(np.broadcast_to(omega, (users.size, omega.shape[-1])))

    def depth(log_omega: Array) -> Array:
        """Return scores at (points, n) frequencies with their sign changed."""
        which = np.broadcast_to(draw, log_omega.shape).ravel()
        column = np.broadcast_to(index, log_omega.shape).ravel()
        shown = display if display.count is None else display.select(which)
        plane, radius = displayed(shown, np.exp(log_omega).ravel())
        shares = shares_of_cells(users.select(which), plane, radius, integrals[column])
        return -_scores(shares).reshape(log_omega.shape)

    low = log_omega[draw, index - 1]
    high = log_omega[draw, index + 1]
    place = section_minimum(depth, low, high, rounds=rounds)
    return -depth(place[None])[0], np.exp(place)
