"""How many more subjects would decide whether a display feels real.

Under a draw of the users what is displayed lies z SDs from the median user, by the part that is
least favourable. N + n subjects estimate z with the variance v(z) = (1 + z²/2)/(N + n). With e the
edge of the central range, the classical rule says "feels real" of estimates below e - q·√v(e) and
"does not" of those above e + q'·√v(e), where q and q' are normal quantiles of the confidences that
it asks for. The wanted n is the smallest that decides often enough, on average over draws.
"""

from __future__ import annotations

import bisect

import numpy as np
from scipy import special

from percept.boundary.confidence import PARTS
from percept.boundary.feels_real import edge_of
from percept.results import MoreSubjects
from percept.study.basics import Array

#: Probability with which the wanted number decides; as in plans of interval widths.
ASSURANCE = 0.8
#: Subjects beyond which no number is given.
_MOST = 1_000
#: SDs beyond which no distance is told apart: all are decided at once.
_FARTHEST = 10.0


def more_subjects(scores: Array, subjects: int, *, central: float, decision: float) -> MoreSubjects:
    """Find how many more subjects would decide whether a display feels real.

    Parameters
    ----------
    scores : ndarray, shape (D,)
        Under each draw of the users, how many SDs what is displayed lies from the median user.
    subjects : int
        Those that there are, N.
    central : float
        Share of all users that a central range holds.
    decision : float
        Confidence from which a display is said to feel real.

    Returns
    -------
    MoreSubjects
        The smallest number, up to 1,000, that decides with a probability of 0.8.
    """
    edge = edge_of(central)
    scores = np.minimum(scores, _FARTHEST)
    for_real = special.ndtri(decision)
    for_not = -special.ndtri((1.0 - decision) / PARTS)

    def probability(more: int) -> float:
        root_n = np.sqrt(subjects + more)
        at_edge = np.sqrt(1.0 + 0.5 * edge**2) / root_n
        error = np.sqrt(1.0 + 0.5 * scores**2) / root_n
        real = special.ndtr((edge - for_real * at_edge - scores) / error)
        does_not = special.ndtr((scores - edge - for_not * at_edge) / error)
        return float((real + does_not).mean())

    count = 1 + bisect.bisect_left(range(1, _MOST + 1), ASSURANCE, key=probability)
    return MoreSubjects(subjects=count if count <= _MOST else None, assurance=ASSURANCE, most=_MOST)
