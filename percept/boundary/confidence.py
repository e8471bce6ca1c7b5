"""Whether a display feels real by the classical method: environment by environment, part by part.

Stiffness and damping are judged by the noncentral t at their least favourable omega, exactly for
normal users. abs(Z_h) is judged at each omega by fiducial draws of the population, approximately.
A display feels real where every part is confident of it, and does not where one part is confident
of the contrary: the first keeps its error rate without, the second with, a correction for parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.boundary.feels_real import FEWEST_FOR_MAGNITUDE, Evidence, Feeling
from percept.boundary.shares import Users
from percept.errors import RefusalError
from percept.haptics.perceived import Display
from percept.haptics.shown import shown_limits
from percept.inference.classical.fiducial import central_range_confidence, fiducial_draws
from percept.inference.classical.moments import Moments

Array = NDArray[np.float64]

#: Fiducial draws of the population: a confidence of 0.95 is known to 0.005 by them.
_DRAWS = 2048
#: Parts that may each say "does not": stiffness, damping, abs(Z_h).
PARTS = 3
#: Subjects that the joint law of stiffness and damping needs.
FEWEST_FOR_PAIR = 3


@dataclass(frozen=True)
class Confidence:
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


def fiducial_users(values: Array, *, log: bool, rng: np.random.Generator) -> Users | None:
    """Draw 2,048 populations that the subjects leave likely.

    Parameters
    ----------
    values : ndarray, shape (n, 2)
        Stiffness and damping of each subject; logarithms where `log` is true.
    log : bool
        Whether users scatter by ratios.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    Users or None
        None where subjects give no joint law: fewer than three, or both quantities in proportion.
    """
    try:
        mean, covariance = fiducial_draws(values, _DRAWS, rng)
    except RefusalError:
        return None
    return Users.of(mean, covariance, log=log)


def confidence(
    display: Display,
    stiffness: Moments,
    damping: Moments,
    omega: Array,
    *,
    central: float,
    log: bool,
    magnitude: Evidence | None = None,
) -> Confidence:
    """Judge a display by the subjects of its environment.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    stiffness, damping : Moments
        Of the subjects, of the logarithms where `log` is true.
    omega : ndarray, shape (M,)
        rad/s, increasing.
    central : float
        Share of all users that a central range holds.
    log : bool
        Whether users scatter by ratios.
    magnitude : Evidence, optional
        Of the display under `fiducial_users`; without it abs(Z_h) is not judged.

    Returns
    -------
    Confidence
        Of stiffness and damping exact, of abs(Z_h) as good as its draws.

    Raises
    ------
    RefusalError
        Where all users set one quantity to the same value.
    """
    shown = shown_limits(display, float(omega[0]), float(omega[-1]))
    by_stiffness, stiffness_tests = _least_confidence(shown.stiffness, stiffness, central, log=log)
    by_damping, damping_tests = _least_confidence(shown.damping, damping, central, log=log)
    return Confidence(
        stiffness=by_stiffness,
        damping=by_damping,
        subjects=int(np.min([stiffness.n, damping.n])),
        stiffness_tests=stiffness_tests,
        damping_tests=damping_tests,
        magnitude=magnitude.lowest if magnitude else None,
        magnitude_omega=magnitude.lowest_omega if magnitude else None,
        together=magnitude.probability if magnitude else None,
        together_error=magnitude.error if magnitude else None,
    )


def _least_confidence(
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
