"""Intervals of what users set, contrasts, how the methods differ, and psychophysics' numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from percept.html import NotebookRecord
from percept.inference.record import Family, Kind, Method

#: `docs/methods.md` defines each one.
Measure: TypeAlias = Literal[
    "sd_subjects",
    "jnd",
    "weber",
    "icc_1",
    "correlation",
    "sigma_u",
    "sigma_w",
    "sigma_e",
    "gamma",
    "sigma_slope",
]

#: Whether the typical user's bias is smaller than one JND.
Equivalence: TypeAlias = Literal["within", "beyond", "too little data"]


@dataclass(frozen=True, kw_only=True)
class Estimate(NotebookRecord):
    """What a method says of one number of one quantity: what all tables of estimates share."""

    parameter: str  # The quantity; of a correlation both, as "k, b"
    method: Method
    family: Family  # Distribution between users
    level: float  # Confidence or credibility
    estimate: float  # In `unit`, as the limits
    lower: float
    upper: float
    unit: str  # Empty for a pure number
    n: int  # Subjects behind it


@dataclass(frozen=True, kw_only=True)
class IntervalRow(Estimate):
    """An interval of one parameter in one environment; its estimate is the users' mean.

    Under the lognormal family that mean is geometric.
    """

    environment: str
    kind: Kind  # What it covers: the average user, the next user, or a share of all users
    joint: str  # "marginal", or "bonferroni": widened so that k and b hold together
    share: float | None  # Of all users, for kind "share"
    confidence: float | None  # For kind "share"
    reference: float | None  # In `unit`
    left_out: int = 0  # Adjustments at the limits of their control, which it does not describe
    covers: str  # The sentence that says what it covers


@dataclass(frozen=True, kw_only=True)
class ContrastRow(Estimate):
    """Two levels of a factor, the second against the first; an interaction; or a slope.

    It is a ratio (lognormal, spread, or precision), or a difference. The unit of differences is
    "references", or the quantity's where one of these is not positive. Within subjects it rests on
    those with all levels.
    """

    factor: str
    first: str
    second: str
    environment: str | None  # None over all references
    references: tuple[str, ...]  # Environments it rests on
    #: "bias", "interaction", "slope", "level" for its mean; "spread" for the ratio of SDs between
    #: subjects, "precision" for that of SDs between trials.
    of: str
    kind: Kind | None  # None for spread and precision
    share: float | None
    confidence: float | None
    #: Limits between which all contrasts of the factor in this quantity and kind lie together.
    lower_together: float | None
    upper_together: float | None
    p_value: float | None = None
    probability_above: float | None = None  # Posterior probability of more than no difference
    d_z: float | None = (
        None  # Mean of subjects' own differences over their SD, on the family's scale
    )
    error: float | None = None  # Of ratios: Monte Carlo standard error of the limits, the larger
    within: bool  # Whether each subject has all levels


@dataclass(frozen=True, kw_only=True)
class LevelValues:
    """What the subjects set at one level of a factor: of no model."""

    factor: str
    level: str
    parameter: str
    environment: str | None = None  # None over all references
    within: bool  # Whether each subject has all levels
    #: One per subject, in the same order at all levels: a ratio to the reference (lognormal), or a
    #: difference in the unit of the contrasts. None without some cell of the level.
    values: tuple[float | None, ...]


@dataclass(frozen=True, kw_only=True)
class AnovaRow(NotebookRecord):
    """The test of a term by analysis of variance of subjects' means on the family's scale."""

    factor: str  # Columns joined by ":"; the references are the column "environment"
    parameter: str
    family: Family
    f: float
    df: float  # Uncorrected, as `df_error` and `p_value`
    df_error: float
    p_value: float
    epsilon: float  # Greenhouse and Geisser's; 1 with one contrast, and between subjects
    df_corrected: float  # Times `epsilon`, as is that of the error
    df_error_corrected: float
    p_corrected: float
    partial_eta2: float
    generalised_eta2: float
    n: int  # Subjects


@dataclass(frozen=True, kw_only=True)
class MethodPair(NotebookRecord):
    """The intervals of both methods of one kind and family."""

    environment: str
    parameter: str
    kind: Kind
    family: Family
    width_ratio: float | None  # Bayesian over classical
    relative: bool  # Whether all references of the parameter are positive
    shift: float | None  # Bayesian estimate over the classical one, less one; else less the other


@dataclass(frozen=True, kw_only=True)
class BandPair(NotebookRecord):
    """How a band of abs(Z_h) differs from another one: exact envelopes of one kind and family.

    The other is the classical one, or that of another study.
    """

    environment: str
    kind: Kind
    method: Method
    family: Family
    place: float  # Its middle over that of the other one, less one, where that is largest
    place_omega: float  # Where that is, rad/s
    place_median: float  # Over log omega
    width: float  # Logarithm of its width over that of the other one, where that is largest
    width_omega: float
    width_median: float


@dataclass(frozen=True, kw_only=True)
class LadderEffect:
    """What one step from the classical interval to the Bayesian one does."""

    environment: str
    parameter: str
    kind: Kind
    cause: str  # "all" for the whole difference
    log_width: float  # Log ratio of widths
    log_width_error: float  # Its Monte Carlo standard error
    centre: float  # Shift of the midpoint, in classical half-widths
    centre_error: float


@dataclass(frozen=True)
class Ladder(NotebookRecord):
    """The steps from the classical interval (Eq. 15; normal family) to the Bayesian one."""

    effects: tuple[LadderEffect, ...]
    notes: tuple[str, ...] = ()  # Environments without a ladder, and why


@dataclass(frozen=True, kw_only=True)
class PsychophysicsRow(Estimate):
    """One measure of one quantity; SDs are taken on the scale of the family."""

    environment: str | None  # None over all environments
    subject: str | None = None  # None of all subjects together
    measure: Measure
    error: float | None  # Monte Carlo standard error of the limits, the larger; None if exact
    approximate: bool  # Whether the classical interval holds its level approximately


@dataclass(frozen=True, kw_only=True)
class EquivalenceRow(NotebookRecord):
    """Whether a bias is smaller than one JND, by one method."""

    environment: str
    parameter: str
    method: Method
    family: Family
    outcome: Equivalence
    jnd: float | None  # In `unit`; None where each draw has its own, from trials
    unit: str
    reference: float  # In `unit`
    decision: float  # Probability, or confidence, that decides
    probability: float | None = (
        None  # Posterior, that the bias is smaller; None by the classical method
    )
    error: float | None = None  # Its Monte Carlo standard error
    p_within: float | None = None  # Of the two one-sided tests; None by the Bayesian method
    p_beyond: float | None = None  # Of the tests that it is larger: the smaller one, doubled
