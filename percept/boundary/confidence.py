"""Whether a display feels real by the classical method: environment by environment, part by part.

Stiffness and damping are judged by the noncentral t at their least favourable omega, exactly for
normal users. abs(Z_h) is judged at each omega by fiducial draws of the population, approximately.
A display feels real where every part is confident of it, and does not where one part is confident
of the contrary: the first keeps its error rate without, the second with, a correction for parts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from percept.boundary.feels_real import FEWEST_FOR_MAGNITUDE, Feeling, feels_real
from percept.boundary.shares import Users
from percept.haptics.perceived import Display
from percept.haptics.shown import shown_limits
from percept.html import NotebookRecord
from percept.inference.classical.fiducial import central_range_confidence, fiducial_draws
from percept.inference.classical.moments import Moments

__all__ = [
    "FEWEST_FOR_PAIR",
    "PARTS",
    "Confidence",
    "SubjectPairs",
    "confidence",
    "limits_confidence",
]

Array = NDArray[np.float64]

#: Most fiducial draws of the population.
_DRAWS = 2048
#: Parts that may each say "does not": stiffness, damping, abs(Z_h).
PARTS = 3
#: Subjects that the joint law of stiffness and damping needs.
FEWEST_FOR_PAIR = 3


@dataclass(frozen=True)
class Confidence(NotebookRecord):
    """Confidence that a display lies in the central range of users, part by part."""

    stiffness: float  # At the omega least favourable to it
    damping: float
    subjects: int
    # Tests that ask for the least favourable omega: two where a part reaches over the mean user.
    stiffness_tests: int = 1
    damping_tests: int = 1
    magnitude: float | None = None  # abs(Z_h) at its least favourable omega; None without pairs
    magnitude_omega: float | None = None  # rad/s
    together: float | None = None  # Share of draws in which all parts hold at every omega
    together_error: float | None = None  # Its Monte Carlo standard error
    scores: Array | None = field(default=None, compare=False)  # Of the draws, as of `Evidence`

    @property
    def parts(self) -> tuple[float, ...]:
        """Confidences of the parts that are known."""
        known = self.stiffness, self.damping, self.magnitude
        return tuple(part for part in known if part is not None)

    def verdict(self, decision: float) -> Feeling:
        """Judge by the least confident part; of few subjects abs(Z_h) never says "does not"."""
        if min(self.parts) >= decision:
            return "feels real"
        refuting = [self.stiffness * self.stiffness_tests, self.damping * self.damping_tests]
        if self.magnitude is not None and self.subjects >= FEWEST_FOR_MAGNITUDE:
            refuting.append(self.magnitude)
        return "does not" if min(refuting) <= (1.0 - decision) / PARTS else "too little data"


@dataclass(frozen=True, eq=False)
class SubjectPairs:
    """What n subjects adjusted, a row of stiffness and damping each; logarithms where `log`."""

    values: Array  # (n, 2)
    log: bool


def confidence(
    display: Display,
    subjects: SubjectPairs,
    omega: Array,
    *,
    central: float,
    decision: float,
    rng: np.random.Generator,
) -> Confidence:
    """Judge a display by the subjects of its environment.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    subjects : SubjectPairs
        At least two; with fewer than three abs(Z_h) is not judged.
    omega : ndarray, shape (M,)
        rad/s, from `percept.boundary.feels_real.search_grid`.
    central : float
        Share of all users that a central range holds.
    decision : float
        Confidence from which a display is said to feel real.
    rng : numpy.random.Generator
        Source of the fiducial draws.

    Returns
    -------
    Confidence
        Of stiffness and damping exact, of abs(Z_h) by up to 2,048 draws.

    Raises
    ------
    RefusalError
        Where all users set one quantity to the same value.
    """
    stiffness = Moments.from_values(subjects.values[:, 0])
    damping = Moments.from_values(subjects.values[:, 1])
    by_parts = limits_confidence(
        display, stiffness, damping, omega, central=central, log=subjects.log
    )
    if len(subjects.values) < FEWEST_FOR_PAIR:
        return by_parts
    draws = fiducial_draws(subjects.values, _DRAWS, rng)
    users = Users.of(draws.mean, draws.covariance, log=subjects.log)
    evidence = feels_real(display, users, omega, central=central, decision=decision)
    return replace(
        by_parts,
        magnitude=evidence.lowest,
        magnitude_omega=evidence.lowest_omega,
        together=evidence.probability,
        together_error=evidence.error,
        scores=evidence.scores,
    )


def limits_confidence(
    display: Display,
    stiffness: Moments,
    damping: Moments,
    omega: Array,
    *,
    central: float,
    log: bool,
) -> Confidence:
    """Judge stiffness and damping alone, as published limits allow.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    stiffness, damping : Moments
        Of the users, of the logarithms where `log` is true.
    omega : ndarray, shape (M,)
        rad/s.
    central : float
        Share of all users that a central range holds.
    log : bool
        Whether users scatter by ratios.

    Returns
    -------
    Confidence
        Without abs(Z_h).

    Raises
    ------
    RefusalError
        Where all users set one quantity to the same value.
    """
    shown = shown_limits(display, float(omega[0]), float(omega[-1]))
    by_stiffness, stiffness_tests = _least(shown.stiffness, stiffness, central, log=log)
    by_damping, damping_tests = _least(shown.damping, damping, central, log=log)
    return Confidence(
        stiffness=by_stiffness,
        damping=by_damping,
        subjects=int(np.min([stiffness.n, damping.n])),
        stiffness_tests=stiffness_tests,
        damping_tests=damping_tests,
    )


def _least(
    extremes: Array,
    users: Moments,
    central: float,
    *,
    log: bool,
) -> tuple[float, int]:
    """Return the smallest confidence over omega, and how many tests that is.

    It falls to both sides of the mean, so an extreme has it. Extremes on both sides may each
    refute.
    """
    if log:
        # No user feels a stiffness or damping of zero or less under the lognormal family.
        if extremes[0] <= 0.0:
            return 0.0, 1
        extremes = np.log(extremes)
    confidences = central_range_confidence(extremes, users, central=central)
    both_sides = bool(extremes[0] < users.mean < extremes[1])
    return float(np.min(confidences)), 1 + both_sides
