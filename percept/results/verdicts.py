"""Whether an environment feels real to users, directly and through the coupling, by each method."""

from __future__ import annotations

import dataclasses

from percept.html import NotebookRecord
from percept.results.fields import Family, Feeling, Method

__all__ = ["Confidences", "PosteriorEvidence", "Verdict"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PosteriorEvidence:
    """Posterior probability that what is displayed lies in the central range of users at every ω."""

    outcome: Feeling
    probability: float  # By abs(Z_h) and by effective stiffness and damping
    error: float  # Its Monte Carlo standard error
    draws: int
    straddles: bool  # Whether two errors reach over a threshold after all draws
    magnitude: float  # By abs(Z_h) alone
    plane: float  # By effective stiffness and damping alone
    lowest: float  # By abs(Z_h) at the one omega where it is least probable
    lowest_omega: float  # rad/s


@dataclasses.dataclass(frozen=True, kw_only=True)
class Confidences:
    """Classical confidence that what is displayed lies in the central range of users, by parts."""

    outcome: Feeling
    family: Family
    least: float  # Of the parts below
    stiffness: float  # At the omega least favourable to it
    damping: float
    magnitude: float | None  # Of abs(Z_h); None with fewer than three subjects
    magnitude_omega: float | None  # Where it is least, rad/s
    together: float | None  # That all parts hold at every omega
    together_error: float | None  # Its Monte Carlo standard error


@dataclasses.dataclass(frozen=True, kw_only=True)
class Verdict(NotebookRecord):
    """Whether one environment, as it is displayed, feels real."""

    environment: str
    coupled: bool  # Through the coupling, or directly
    level: float  # Share of all users that a central range holds
    decision: float  # It feels real from this probability on, and does not from one minus it down
    outcome: Feeling  # Of `method`
    method: Method  # Bayesian where there is a posterior
    probability: float  # Posterior probability, or the classical method's least confidence
    bayesian: PosteriorEvidence | None
    classical: Confidences | None
    stable_and_real: float | None  # None directly, where stability is undecided, and without draws
