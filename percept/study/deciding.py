"""How many more subjects would decide whether a display feels real.

A truth is drawn from the posterior, n more subjects of it are simulated by their mean and scatter,
and all subjects together are judged by the classical rule. The wanted n is the smallest that
decides with a stated probability.

The rule asks for confidences, which a distance d from the mean of N subjects, in their SDs,
decides: "feels real" up to one critical distance, "does not" from another on. Stiffness and damping
follow it exactly. For abs(Z_h) the distance is the normal score of the share of users below what is
displayed, and N is the number of subjects that tell a single quantity as well as N tell this score.
"""

from __future__ import annotations

import bisect
import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.interpolate import PchipInterpolator
from scipy.optimize import elementwise

from percept.boundary.confidence import PARTS, SubjectPairs
from percept.boundary.feels_real import MarginsAt
from percept.boundary.users import Users
from percept.haptics.axis import warp
from percept.haptics.perceived import shown_element
from percept.haptics.records import Display
from percept.inference.classical.central_range import central_range_confidence
from percept.inference.classical.moments import Moments
from percept.results import MoreSubjects

__all__ = ["ASSURANCE", "Critical", "more_subjects"]

Array = NDArray[np.float64]

#: Probability with which the wanted number decides; as in plans of interval widths.
ASSURANCE = 0.8
#: Subjects beyond which no number is given.
_MOST = 1_000
#: Frequencies at which abs(Z_h) is judged: where it is least favourable, and few are.
_FREQUENCIES = 6
#: Truths that show which frequencies these are.
_TRIED = 64
#: Variance of a score, of one subject, below which shares show none.
_LEAST_VARIANCE = 1e-3
#: Subjects whose scatter sets how far scores are looked at about a truth.
_STEP_SUBJECTS = 40
#: Accuracy of shares: that of their scores is then 0.001 at the edge of a range of 99 %.
_ACCURACY = 1e-5
#: Scores are not told apart beyond this.
_LARGEST_SCORE = 4.0
#: SDs; the critical distance of two subjects at any decision lies below.
_FARTHEST = 1e8
#: Subjects at which critical distances are worked out; they are smooth between.
_KNOTS = np.unique(np.geomspace(2.0, 1e5, 48).astype(int))
#: Directions in which a population differs: both means, both SDs, and the correlation.
_DIRECTIONS = 5


@dataclasses.dataclass(frozen=True)
class Critical:
    """Distances from the mean, in SDs, that decide, by the number of subjects."""

    level: float
    decision: float

    def real(self, n: Array) -> Array:
        """Return the largest distance that feels real."""
        return _interpolated(self.decision, self.level, n)

    def does_not(self, n: Array) -> Array:
        """Return the smallest distance that does not."""
        return _interpolated((1.0 - self.decision) / PARTS, self.level, n)


def _interpolated(confidence: float, level: float, n: Array) -> Array:
    log_n = np.log(np.clip(n, _KNOTS[0], _KNOTS[-1]))
    return np.asarray(np.exp(_critical_distance(confidence, level)(log_n)))


@cache
def _critical_distance(confidence: float, level: float) -> PchipInterpolator:
    """Return the log distance that has a confidence, by the logarithm of the subjects."""

    def excess(log_distance: Array, n: Array) -> Array:
        users = Moments(np.zeros(n.shape), np.ones(n.shape), n.astype(int))
        reached = central_range_confidence(np.exp(log_distance), users, level=level)
        return np.asarray(reached) - confidence

    ends = -np.log(_FARTHEST), np.log(_FARTHEST)
    found = elementwise.find_root(excess, ends, args=(_KNOTS,))
    # Few subjects may reach a high confidence nowhere, and then at no distance but zero.
    return PchipInterpolator(np.log(_KNOTS), np.where(found.success, found.x, ends[0]))


@dataclasses.dataclass(frozen=True, eq=False)
class _Sample:
    """Subjects by what the classical rule needs of them; of many studies with a first axis."""

    count: int
    mean: Array  # (2,) or (S, 2)
    scatter: Array  # (2, 2) or (S, 2, 2), about the mean

    @classmethod
    def of(cls, values: Array) -> _Sample:
        mean = values.mean(axis=0)
        centred = values - mean
        return cls(len(values), mean, centred.T @ centred)

    def joined(self, other: _Sample) -> _Sample:
        """Put subjects of two samples together."""
        count = self.count + other.count
        apart = other.mean - self.mean
        outer = apart[..., :, None] * apart[..., None, :]
        mean = self.mean + (other.count / count) * apart
        between = (self.count * other.count / count) * outer
        return _Sample(count, mean, self.scatter + other.scatter + between)

    def users(self, *, log: bool) -> Users:
        """Return populations with the sample's mean and covariance."""
        return Users.of(self.mean, self.scatter / (self.count - 1), log=log)


class _Truths:
    """Populations, and n new subjects of each: of the same random numbers for every n."""

    def __init__(self, users: Users, rng: np.random.Generator) -> None:
        size = users.size
        self._mean = users.mean.T
        self._root = _roots(users)
        self._normal = rng.standard_normal((size, 2, 1))
        self._tail = rng.uniform(size=(2, size))
        self._across = rng.standard_normal(size)
        self._log = users.log

    def sample(self, n: int) -> _Sample:
        """Draw the mean and scatter of n subjects of each truth."""
        error = self._root @ self._normal / np.sqrt(n)
        # Bartlett's root of the scatter of standard normal subjects; a single one has none.
        bartlett = np.zeros(self._root.shape)
        if n > 1:
            bartlett[:, 0, 0] = np.sqrt(special.chdtri(n - 1, self._tail[0]))
            bartlett[:, 1, 0] = self._across
        if n > 2:
            bartlett[:, 1, 1] = np.sqrt(special.chdtri(n - 2, self._tail[1]))
        root = self._root @ bartlett
        return _Sample(n, self._mean + error[..., 0], root @ np.swapaxes(root, 1, 2))

    def shifted(self, direction: int, sign: float) -> Users:
        """Move populations by one standard error of a direction, a step of so many subjects."""
        step = sign / np.sqrt(_STEP_SUBJECTS)
        mean = self._mean
        spread = np.eye(2)
        if direction < 2:
            mean = mean + step * self._root[:, :, direction]
        elif direction < 4:
            quantity = direction - 2
            spread[quantity, quantity] = np.exp(np.sqrt(2.0) * step)
        else:
            spread[:] = np.sinh(step)
            np.fill_diagonal(spread, np.cosh(step))
        covariance = self._root @ spread @ np.swapaxes(self._root, 1, 2)
        return Users.of(mean, covariance, log=self._log)


def _roots(users: Users) -> Array:
    """Return lower triangular roots (S, 2, 2) of the covariances."""
    correlation = users.correlation
    root = np.zeros((users.size, 2, 2))
    root[:, 0, 0] = users.sd[0]
    root[:, 1, 0] = correlation * users.sd[1]
    remainder = (1.0 - correlation) * (1.0 + correlation)
    root[:, 1, 1] = np.sqrt(remainder) * users.sd[1]
    return root


class _Search:
    """Shares of truths that so many more subjects decide."""

    def __init__(
        self,
        display: Display,
        subjects: SubjectPairs,
        users: Users,
        omega: Array,
        critical: Critical,
        rng: np.random.Generator,
    ) -> None:
        self._critical = critical
        self._log = users.log
        self._known = _Sample.of(subjects.values)
        self._truths = _Truths(users, rng)
        shown = shown_element(warp(omega, display.period), display)
        stiffness = np.atleast_1d(shown.stiffness)
        damping = np.atleast_1d(shown.damping)
        # Of each quantity the least and the largest over omega: one is the least favourable.
        self._shown = np.array(
            [[stiffness.min(), stiffness.max()], [damping.min(), damping.max()]],
        )
        least_favourable = _least_favourable(display, users, omega, critical.level)
        self._margins = MarginsAt(display, users, least_favourable, critical.level, _ACCURACY)
        self._ratio = self._subjects_ratio(users)

    def _scores(self, users: Users) -> Array:
        """Return how far abs(Z_h) as displayed lies from the median user's, in SDs, (D, M)."""
        edge = -special.ndtri(0.5 * (1.0 - self._critical.level))
        scores = edge - self._margins.of(users)
        return np.asarray(np.minimum(scores, _LARGEST_SCORE))

    def _subjects_ratio(self, users: Users) -> Array:
        """Return how many subjects of one quantity tell a score as well as one of these, (S, M).

        The score of a single quantity z SDs off has the variance (1 + z²/2)/N.
        """
        score = self._scores(users)
        variance = np.zeros(score.shape)
        for direction in range(_DIRECTIONS):
            above = self._scores(self._truths.shifted(direction, 1.0))
            below = self._scores(self._truths.shifted(direction, -1.0))
            variance += (0.5 * (above - below)) ** 2
        of_one_subject = _STEP_SUBJECTS * variance
        return (1.0 + 0.5 * score**2) / np.maximum(of_one_subject, _LEAST_VARIANCE)

    def probability(self, more: int) -> float:
        """Return the share of truths that so many more subjects decide."""
        return float(self.decided(more).mean())

    def decided(self, more: int) -> NDArray[np.bool_]:
        """Return which truths (S,) so many more subjects decide."""
        sample = self._known.joined(self._truths.sample(more))
        users = sample.users(log=self._log)
        distance = self._distances(users)
        count = np.array(float(sample.count))
        real = np.all(distance <= self._critical.real(count), axis=0)
        does_not = np.any(distance >= self._critical.does_not(count), axis=0)
        (undecided,) = np.nonzero(~does_not)
        if undecided.size:
            score = self._scores(users.select(undecided))
            telling = np.maximum(sample.count * self._ratio[undecided], 2.0)
            inside = score <= self._critical.real(telling)
            outside = score >= self._critical.does_not(telling)
            real[undecided] &= inside.all(axis=1)
            does_not[undecided] = outside.any(axis=1)
        return np.asarray(real | does_not)

    def _distances(self, users: Users) -> Array:
        """Return the largest distance over omega of what is displayed, by quantity, (2, S)."""
        shown = self._shown
        if self._log:
            if np.any(shown <= 0.0):
                return np.full(users.mean.shape, np.inf)
            shown = np.log(shown)
        apart = np.abs(shown[:, :, None] - users.mean[:, None])
        largest = apart.max(axis=1)
        return np.asarray(largest / users.sd)


def _least_favourable(display: Display, users: Users, omega: Array, level: float) -> Array:
    """Return the few frequencies at which abs(Z_h) most often lies farthest out."""
    few = users.select(slice(_TRIED))
    margins = MarginsAt(display, few, omega, level, _ACCURACY).of(few)
    lowest_two = margins.argsort(axis=1)[:, :2]
    counts = np.bincount(lowest_two.ravel(), minlength=omega.size)
    often = np.argsort(-counts, kind="stable")
    return omega[np.sort(often[:_FREQUENCIES])]


def more_subjects(
    display: Display,
    subjects: SubjectPairs,
    truths: Users,
    omega: Array,
    *,
    level: float,
    decision: float,
    rng: np.random.Generator,
) -> MoreSubjects:
    """Find how many more subjects would decide whether a display feels real.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    subjects : SubjectPairs
        At least two, on the scale of the truths.
    truths : Users
        S populations that the data leave likely, in random order: the more, the smaller the error.
    omega : ndarray, shape (M,)
        rad/s, from `percept.boundary.feels_real.search_grid`.
    level : float
        Share of all users that a central range holds.
    decision : float
        Confidence from which a display is said to feel real.
    rng : numpy.random.Generator
        Source of the new subjects.

    Returns
    -------
    MoreSubjects
        The smallest number, up to 1,000, that decides with a probability of 0.8.
    """
    search = _Search(display, subjects, truths, omega, Critical(level, decision), rng)
    probability = cache(search.probability)
    error = float(np.sqrt(ASSURANCE * (1.0 - ASSURANCE) / truths.size))
    numbers = range(1, _MOST + 1)

    def smallest(wanted: float) -> int:
        return 1 + bisect.bisect_left(numbers, wanted, key=probability)

    count = smallest(ASSURANCE)
    lower = smallest(ASSURANCE - error)
    upper = smallest(ASSURANCE + error)
    enough = count <= _MOST
    return MoreSubjects(
        subjects=count if enough else None,
        lower=min(lower, _MOST),
        upper=upper if upper <= _MOST else None,
        probability=probability(min(count, _MOST)),
        error=error,
        assurance=ASSURANCE,
        most=_MOST,
    )
