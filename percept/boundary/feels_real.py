"""Evidence that a display feels real: it lies in the central range of users at every omega.

Each posterior draw is a population of users. Its score is how far what is displayed lies from the
median user, in SDs of a normal: the largest over all omega, by abs(Z_h) and by effective stiffness
and damping. Under a draw a display feels real where its score lies within that of the central
range. Wide limits of few subjects are no evidence here: they make some draws hold the display and
others not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import elementwise

from percept.boundary.shares import DiscIntegral, Discs, Users, score_of, share_within
from percept.haptics.loop import log_grid
from percept.haptics.perceived import Display, displayed
from percept.haptics.shown import shown_limits

__all__ = [
    "CENTRALS",
    "FEWEST_FOR_MAGNITUDE",
    "MAP_DRAWS",
    "Evidence",
    "Feeling",
    "Scores",
    "feels_real",
    "judge",
    "plane_scores",
    "rough_probability",
    "search_grid",
    "search_scores",
    "share_error",
]

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
#: A distance of a score from the edge, in SDs, below which rounding and the search decide.
_TOO_NEAR = 1e-6
#: Accuracy of the log omega of a peak; the score is flat there.
_PEAK_PLACE = 1e-5
#: Accuracy of the score of a peak, in SDs.
_PEAK_SCORE = 1e-8
#: Draws judged first; they are doubled while the error straddles a threshold.
_FIRST_DRAWS = 512
#: Draws behind a map or another device, and where these do not decide: 0.95 is known to 0.014 and
#: 0.007 by them.
MAP_DRAWS = (256, 1024)
#: Accuracy of shares: at the edge of a 99 % range 1e-6 of the users are 7e-5 SDs.
_ACCURACY = 1e-6
#: The same on maps.
_MAP_ACCURACY = 1e-4
#: Standard errors between a probability and a threshold that decide.
_CLEAR = 2.0


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """Posterior probability that a display feels real at every omega of a range."""

    probability: float  # By abs(Z_h) and by effective stiffness and damping
    magnitude: float  # By abs(Z_h) alone
    plane: float  # By effective stiffness and damping alone
    by_central: tuple[float, ...]  # Probability against each central share of `CENTRALS`
    lowest: float  # By abs(Z_h) at the one omega where it is least probable
    lowest_omega: float  # rad/s; of many devices, the median of theirs
    error: float  # Monte Carlo standard error of `probability`, with the draws that are too near
    too_near: float  # Share of draws whose score is nearer to the edge than the search resolves
    scores: Array  # (D,) Largest distance of each draw from its median user, in SDs
    real: Flags  # (D,) Under which draws it feels real

    @property
    def draws(self) -> int:
        """Number of draws, D."""
        return self.real.size

    def clear_of(self, decision: float) -> bool:
        """Whether the probability is clear of both thresholds, `decision` and one minus it."""
        return _is_clear(self.probability, self.error, decision)

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

    Returns
    -------
    Evidence
        From the first draws, doubled until the verdict is clear or all are used.
    """
    plane = plane_scores(display, users, float(omega.min()), float(omega.max()))
    if omega.ndim == 1:
        omega = np.union1d(omega, _typical_peaks(display, users, omega))
    judged: list[Scores] = []
    start = 0
    stop = min(_FIRST_DRAWS, users.size)
    while True:
        some = slice(start, stop)
        shown = display
        if display.count is not None:
            shown = display.select(np.arange(start, stop))
        some_omega = omega
        if omega.ndim == 2:
            some_omega = omega[some]
        judged.append(search_scores(shown, users.select(some), some_omega, central))
        evidence = _evidence(judged, plane[:stop], omega, central)
        if stop == users.size or evidence.clear_of(decision):
            return evidence
        start = stop
        stop = min(2 * stop, users.size)


def rough_probability(
    display: Display,
    users: Users,
    omega: Array,
    *,
    central: float,
    decision: float,
) -> float:
    """Return the share of draws under which a display feels real, without a search between omega.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    users : Users
        Populations, in random order.
    omega : ndarray, shape (M,)
        rad/s, dense where scores peak.
    central, decision : float
        As of `feels_real`.

    Returns
    -------
    float
        For maps: shares of users are known to some ten-thousandths. It is that of 256 draws, or
        of 1,024 where these are not clear of `decision` and of one minus it.
    """
    edge = score_of(central)
    plane = plane_scores(display, users, omega[0], omega[-1])
    real = 0
    start = 0
    for stop in MAP_DRAWS:
        stop = min(stop, users.size)
        inside = start + np.flatnonzero(plane[start:stop] <= edge)
        if inside.size:
            discs = Discs.of(display, users.select(inside), omega)
            scores = _scores(discs.shares(_MAP_ACCURACY))
            real += int(np.count_nonzero(scores.max(axis=1) <= edge))
            # Further draws are looked at where one of these is worst, or outside.
            outside = np.flatnonzero((scores > edge).any(axis=0))
            omega = omega[np.union1d(scores.argmax(axis=1), outside)]
        probability = real / stop
        if _is_clear(probability, share_error(probability, stop), decision):
            break
        start = stop
    return probability


def _is_clear(probability: float, error: float, decision: float) -> bool:
    """Say whether a probability is clear of both thresholds, `decision` and one minus it."""
    from_real = abs(probability - decision)
    from_not = abs(probability - (1.0 - decision))
    return min(from_real, from_not) > _CLEAR * error


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
    judged: list[Scores],
    plane: Array,
    omega: Array,
    central: float,
) -> Evidence:
    """Count the draws under which a display feels real."""
    edge = score_of(central)
    magnitude = np.concatenate([scores.largest for scores in judged])
    largest = np.maximum(magnitude, plane)
    inside = largest <= edge
    inside_at = np.zeros(omega.shape[-1])
    for scores in judged:
        inside_at += np.count_nonzero(scores.at_omega <= edge, axis=0)
    from_edge = np.abs(magnitude - edge)
    too_near = _share(from_edge < _TOO_NEAR)
    probability = _share(inside)
    by_central = []
    for share in CENTRALS:
        within = largest <= score_of(share)
        by_central.append(_share(within))
    lowest = int(np.argmin(inside_at))
    return Evidence(
        probability=probability,
        magnitude=_share(magnitude <= edge),
        plane=_share(plane <= edge),
        by_central=tuple(by_central),
        lowest=float(inside_at[lowest]) / inside.size,
        lowest_omega=float(np.median(omega[..., lowest])),
        error=share_error(probability, inside.size) + too_near,
        too_near=too_near,
        scores=largest,
        real=inside,
    )


def _share(flags: Flags) -> float:
    """Return the share of flags that are set."""
    return float(flags.mean())


def search_grid(
    lower: float,
    upper: float,
    resonances: Array,
    half_widths: Array,
) -> Array:
    """Choose frequencies from `lower` to `upper`, rad/s, so close that no peak of a score hides.

    `half_widths` are relative, one per resonance. Resonances (R,) of one device, or (D, R) of D,
    which have frequencies each: (D, M), where those beyond the range stand at its ends.
    """
    beside = resonances[..., None] * np.exp(half_widths[:, None] * _BESIDE)
    near = beside.reshape(*resonances.shape[:-1], -1)
    return log_grid((lower, upper), _PER_DECADE, near)


class Scores(NamedTuple):
    """By how many SDs of a normal abs(Z_h) as displayed lies from the median user's.

    The share of users with less than what is displayed, as a normal score, in size.
    """

    at_omega: Array  # (D, M) of D draws
    largest: Array  # (D,) over the whole range; outside every range, that of the M frequencies


def _scores(shares: Array) -> Array:
    """Return by how many SDs of a normal shares lie from a half, in size."""
    return np.abs(special.ndtri(np.clip(shares, 0.0, 1.0)))


def search_scores(
    display: Display,
    users: Users,
    omega: Array,
    central: float,
) -> Scores:
    """Look at every frequency of `omega`, (M,) or (D, M), and between those where a score peaks."""
    discs = Discs.of(display, users, omega)
    scores = _scores(discs.shares(_ACCURACY))
    largest = scores.max(axis=1)
    # Outside all ranges no peak is asked.
    widest = score_of(max(*CENTRALS, central))
    inside = largest <= widest
    highest = _reach(scores, np.atleast_2d(omega))
    draw, index = np.nonzero((highest > largest[:, None]) & inside[:, None])
    if draw.size:
        integrals = discs.integrals(_ACCURACY)
        found = _search_peaks(display, users, omega, (draw, index), integrals)
        # A flat peak has no bracket and no result.
        np.fmax.at(largest, draw, found.score)
    return Scores(scores, largest)


def _typical_peaks(display: Display, users: Users, omega: Array) -> Array:
    """Return where between (M,) frequencies, rad/s, the score of a typical population peaks.

    There the fewest populations hold what is displayed.
    """
    typical = users.typical()
    discs = Discs.of(display, typical, omega)
    scores = _scores(discs.shares(_MAP_ACCURACY))
    draw, index = np.nonzero(np.isfinite(_reach(scores, omega[None])))
    integrals = discs.integrals(_MAP_ACCURACY)
    found = _search_peaks(display, typical, omega, (draw, index), integrals)
    return found.omega[np.isfinite(found.score)]


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


class _Peaks(NamedTuple):
    """The n peaks of scores over omega, (n,)."""

    score: Array  # The largest; NaN where none was found
    omega: Array  # rad/s


def _search_peaks(
    display: Display,
    users: Users,
    omega: Array,
    peaks: tuple[Indices, Indices],
    integrals: Mapping[DiscIntegral, Flags],
) -> _Peaks:
    """Search each peak, given by its draw and its frequency."""
    draw, index = peaks
    log_omega = np.log(np.atleast_2d(omega))
    row = draw if len(log_omega) > 1 else np.zeros_like(draw)

    def depth_at(log_omega: Array, draw: Array, index: Array) -> Array:
        which = draw.astype(np.intp)
        shown = display
        if display.count is not None:
            shown = display.select(which)
        plane, radius = displayed(shown, np.exp(log_omega))
        shares = np.empty(radius.shape)
        for integral, frequencies in integrals.items():
            (here,) = np.nonzero(frequencies[index.astype(np.intp)])
            some = users.select(which[here])
            shares[here] = share_within(some, plane.select(here), radius[here], integral)
        return -_scores(shares)

    low = log_omega[row, index - 1]
    middle = log_omega[row, index]
    high = log_omega[row, index + 1]
    # SciPy divides zero by zero where three values are equal.
    with np.errstate(invalid="ignore"):
        lowest = elementwise.find_minimum(
            depth_at,
            (low, middle, high),
            args=(draw.astype(float), index.astype(float)),
            tolerances={"xatol": _PEAK_PLACE, "fatol": _PEAK_SCORE, "xrtol": 0.0, "frtol": 0.0},
        )
    return _Peaks(-np.asarray(lowest.f_x), np.exp(lowest.x))
