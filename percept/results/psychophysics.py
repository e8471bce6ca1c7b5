"""The numbers that psychophysics reports: points of equality, thresholds, spreads, reliability."""

from __future__ import annotations

import dataclasses
from typing import Literal, TypeAlias

from percept.html import NotebookRecord
from percept.inference.record import Family, Method
from percept.results.intervals import Estimate

#: `docs/methods.md` defines each one.
Measure: TypeAlias = Literal[
    "pse",
    "sd_subjects",
    "jnd",
    "jnd_quartile",
    "weber",
    "icc_1",
    "correlation",
    "sigma_u",
    "sigma_w",
    "sigma_e",
    "icc_c1",
    "icc_a1",
    "gamma",
    "sigma_slope",
]

#: Whether the typical user's bias is smaller than one JND.
Equivalence: TypeAlias = Literal["within", "beyond", "too little data"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PsychophysicsRow(Estimate):
    """One measure of one quantity; SDs are taken on the scale of the family."""

    environment: str | None  # None over all environments
    subject: str | None = None  # None of all subjects together
    measure: Measure
    error: float | None  # Monte Carlo standard error of the limits, the larger; None if exact
    approximate: bool  # Whether the classical interval holds its level approximately


@dataclasses.dataclass(frozen=True, kw_only=True)
class PseLineRow(Estimate):
    """Point of subjective equality at one reference, on the line about which environments lie."""

    condition: str  # Levels of all factors; empty without factors
    reference: float  # In `unit`
    error: float | None  # Monte Carlo standard error of the limits, the larger


@dataclasses.dataclass(frozen=True, kw_only=True)
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
