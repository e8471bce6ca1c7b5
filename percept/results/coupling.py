"""What feels real, directly and through the coupling; the coupling's stability and its map."""

from __future__ import annotations

import dataclasses

from percept.haptics.design import QualifyingCoupling
from percept.html import NotebookRecord
from percept.results.data import Note
from percept.results.fields import Array, Family, Feeling, Inside, Kind, Method

__all__ = [
    "AdmissibleCouplings",
    "Confidences",
    "Coupling",
    "CouplingMap",
    "EnvironmentCouplings",
    "Leaning",
    "Membership",
    "MoreSubjects",
    "Passivity",
    "PosteriorEvidence",
    "Sensitivity",
    "StableEdge",
    "Verdict",
]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PosteriorEvidence:
    """Posterior probability that a display lies in the central range of users at every ω."""

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
class MoreSubjects(NotebookRecord):
    """How many more subjects would decide a verdict with a stated probability."""

    subjects: int | None  # None where `most` are not enough
    lower: int  # One Monte Carlo error below
    upper: int | None  # One above; None beyond `most`
    probability: float  # That so many decide, by the classical rule
    error: float  # Its Monte Carlo standard error
    assurance: float  # Probability that was wanted
    most: int  # Subjects beyond which no number is given


@dataclasses.dataclass(frozen=True, kw_only=True)
class Leaning:
    """The doubtful rows of an environment, and its verdict without those of the whole study."""

    rows: tuple[Note, ...]  # Each with its value and what lets one doubt it
    without: Verdict | None  # None where the rest carries no verdict


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
    # None where either method decides, and without a joint law of the subjects' values.
    more: MoreSubjects | None = None
    leaning: Leaning | None = None  # None where no row of the environment looks mistyped


@dataclasses.dataclass(frozen=True)
class Passivity:
    """Whether one reference, rendered without the coupling, is passive; dampings in N·s/m."""

    environment: str
    needed_colgate: float  # True hold and backward difference (Colgate and Schenkel)
    needed_paper: float  # Under the paper's Eqs 7 and 8
    device_damping: float
    passive: bool  # By Colgate and Schenkel


@dataclasses.dataclass(frozen=True, kw_only=True)
class Membership:
    """Whether a reference, directly and through the coupling, stays inside a boundary at every ω.

    A departure is the largest over the range, negative inside: of abs(Z_h) as a fraction of the
    boundary's curve, of effective (k, b) in widths of their limits.
    """

    environment: str
    method: Method
    kind: Kind
    family: Family
    joint: str
    shape: str
    verdict_uncoupled: Inside
    departure_uncoupled: float
    departure_omega_uncoupled: float  # rad/s
    plane_departure_uncoupled: float
    verdict_coupled: Inside
    departure_coupled: float
    departure_omega_coupled: float  # rad/s
    plane_departure_coupled: float
    effective_stiffness: float  # Through the coupling at `Coupling.read_at`, N/m
    effective_damping: float  # N·s/m


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Coupling(NotebookRecord):
    """What the coupling does, with the device, over the scene's frequencies."""

    stiffness: float  # Of the coupling, N/m
    damping: float  # Of the coupling, N·s/m
    verdict: str  # Llewellyn's criterion: "stable", "marginal", "unstable" or "undecided"
    reason: str  # Why
    margin: float  # Smallest ratio of what the device has to what the coupling needs
    binding_omega: float  # Where it binds, rad/s
    required_damping: float | None  # Damping a rigid device needs, N·s/m; None for other devices
    required_omega: float | None  # Where that need is largest, rad/s
    omega: Array  # (M,) Frequencies of the criterion, rad/s
    bound: Array  # (M,) The criterion's bound there
    admittance: Array  # (M,) Real part of the coupling's admittance there
    memberships: tuple[Membership, ...]  # Per rectangle of (k, b) and shape
    read_at: float  # Where single values are read, rad/s

    @property
    def stable(self) -> bool | None:
        """Whether the coupling is stable, at its limit it is not; None where that is undecided."""
        return {"stable": True, "marginal": False, "unstable": False}.get(self.verdict)


@dataclasses.dataclass(frozen=True)
class EnvironmentCouplings:
    """The couplings that are stable and realistic for one environment, or for all together."""

    name: str | None  # None for all together
    intervals: tuple[
        tuple[tuple[float, float], ...], ...
    ]  # Per line of damping: low, high k_c, N/m
    largest: QualifyingCoupling | None  # By stiffness; None where nothing qualifies
    softest: QualifyingCoupling | None


@dataclasses.dataclass(frozen=True, eq=False)
class CouplingMap:
    """The admissible couplings by the limits of one method."""

    method: Method
    damping: Array  # (n,) b_c of each line, N·s/m
    environments: tuple[EnvironmentCouplings, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class StableEdge:
    """The edge of what is stable in the plane of couplings."""

    stiffness: Array  # (n,) k_c, N/m
    damping: Array  # (n,) b_c, N·s/m


@dataclasses.dataclass(frozen=True, kw_only=True)
class AdmissibleCouplings(NotebookRecord):
    """Couplings that are stable and keep every environment inside a boundary."""

    kind: Kind
    family: Family
    stable: StableEdge | None  # None but for a rigid device
    maps: tuple[CouplingMap, ...]


@dataclasses.dataclass(frozen=True)
class Sensitivity(NotebookRecord):
    """Verdicts for lighter, heavier, less and better damped devices."""

    mass: tuple[float, ...]  # Of the devices judged, kg
    damping: tuple[float, ...]  # Of the devices judged, N·s/m
    own: tuple[int, int]  # Index of the scene's device: of its damping, of its mass
    verdict: tuple[tuple[str | None, ...], ...]  # By damping and mass; None without a coupling
    inside: dict[str, tuple[tuple[int, ...], ...]]  # By kind: environments that stay inside
    environments: int  # How many were judged
    required_damping: float | None  # Damping that the coupling needs of a rigid device, N·s/m
    method: str  # Whose limits
    family: str
