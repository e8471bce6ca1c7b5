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
from percept.boundary.shares import LEAST, Users
from percept.errors import RefusalError
from percept.haptics.perceived import Display
from percept.haptics.shown import shown_limits
from percept.inference.classical.fiducial import central_range_confidence, fiducial_draws
from percept.inference.classical.moments import Moments
from percept.inference.record import Family
from percept.results import Confidences

Array = NDArray[np.float64]

#: Fiducial draws of the population: a confidence of 0.95 is known to 0.005 by them.
_DRAWS = 2048
#: Parts that may each say "does not": stiffness, damping, abs(Z_h).
PARTS = 3
#: Subjects that the joint law of stiffness and damping needs.
FEWEST_FOR_PAIR = 3


@dataclass(frozen=True, eq=False)
class Subjects:
    """What the classical method knows of the users of one environment."""

    family: Family
    stiffness: Moments  # On the family's scale
    damping: Moments
    users: Users | None  # Fiducial draws; None where subjects give no joint law

    @property
    def relative_sd(self) -> float:
        """SD of stiffness between users, relative to its mean."""
        sd = float(self.stiffness.sd)
        if self.family == "lognormal":
            return sd
        return sd / max(abs(float(self.stiffness.mean)), LEAST)


def outcome_of(
    stiffness: float,
    damping: float,
    magnitude: float | None = None,
    *,
    subjects: int,
    decision: float,
    tests: tuple[int, int] = (1, 1),
) -> Feeling:
    """Judge by the least confident part.

    Parameters
    ----------
    stiffness, damping, magnitude : float
        Confidence in each part; None where abs(Z_h) is not judged.
    subjects : int
        Of few abs(Z_h) never says "does not".
    decision : float
        Confidence from which a display feels real.
    tests : pair of int
        Those behind the confidences in stiffness and damping: two where a part reaches over the
        mean user.

    Returns
    -------
    Feeling
    """
    parts = [stiffness, damping]
    refuting = [stiffness * tests[0], damping * tests[1]]
    if magnitude is not None:
        parts.append(magnitude)
        if subjects >= FEWEST_FOR_MAGNITUDE:
            refuting.append(magnitude)
    if min(parts) >= decision:
        return "feels real"
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
    subjects: Subjects,
    within: tuple[float, float],
    *,
    central: float,
    decision: float,
    likely: Evidence | None = None,
) -> Confidences:
    """Judge a display by the subjects of its environment.

    Parameters
    ----------
    display : Display
        One environment, directly or through a coupling.
    subjects : Subjects
        What is known of them.
    within : pair of float
        Range of omega, rad/s.
    central : float
        Share of all users that a central range holds.
    decision : float
        Confidence from which a display is said to feel real.
    likely : Evidence, optional
        Of the display under `fiducial_users`; without it abs(Z_h) is not judged.

    Returns
    -------
    Confidences
        Of stiffness and damping exact, of abs(Z_h) as good as its draws.

    Raises
    ------
    RefusalError
        Where all users set one quantity to the same value.
    """
    shown = shown_limits(display, *within)
    log = subjects.family == "lognormal"
    by_stiffness, stiffness_tests = _least_confidence(
        shown.stiffness, subjects.stiffness, central, log=log
    )
    by_damping, damping_tests = _least_confidence(shown.damping, subjects.damping, central, log=log)
    magnitude = likely.lowest if likely else None
    outcome = outcome_of(
        by_stiffness,
        by_damping,
        magnitude,
        subjects=int(np.min([subjects.stiffness.n, subjects.damping.n])),
        decision=decision,
        tests=(stiffness_tests, damping_tests),
    )
    return Confidences(
        outcome=outcome,
        family=subjects.family,
        probability=min(by_stiffness, by_damping, 1.0 if magnitude is None else magnitude),
        stiffness=by_stiffness,
        damping=by_damping,
        magnitude=magnitude,
        magnitude_omega=likely.lowest_omega if likely else None,
        together=likely.probability if likely else None,
        together_error=likely.error if likely else None,
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
