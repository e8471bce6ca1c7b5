"""The numbers that psychophysics reports: points of equality, thresholds, spreads, reliability."""

from __future__ import annotations

import dataclasses
from typing import Literal, TypeAlias

from percept.html import NotebookRecord
from percept.inference.record import Family, Method

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
class PsychophysicsRow(NotebookRecord):
    """One measure of one quantity, by one method."""

    environment: str | None  # None over all environments
    subject: str | None = None  # None of all subjects together
    parameter: str  # Quantity; of a correlation both, as "k, b"
    measure: Measure
    method: Method
    family: Family  # Scale on which SDs are taken; under "lognormal" that of the logarithms
    level: float  # Confidence or credibility
    estimate: float  # In `unit`, as the limits and their error
    lower: float
    upper: float
    error: float | None  # Monte Carlo standard error of the limits, the larger; None if exact
    unit: str  # Empty for a pure number
    n: int  # Subjects behind it
    approximate: bool  # Whether the classical interval holds its level approximately


@dataclasses.dataclass(frozen=True, kw_only=True)
class PseLineRow(NotebookRecord):
    """Point of subjective equality at one reference, on the line about which environments lie."""

    parameter: str
    condition: str  # Levels of all factors; empty without factors
    method: Method
    family: Family
    level: float
    reference: float  # In `unit`, as all numbers after it
    estimate: float
    lower: float
    upper: float
    error: float | None  # Monte Carlo standard error of `lower` and `upper`, the larger
    unit: str
    n: int  # Subjects behind it


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
    probability: float | None  # Posterior, that the bias is smaller; None by the classical method
    error: float | None  # Its Monte Carlo standard error
    p_within: float | None  # Of the two one-sided tests; None by the Bayesian method
    p_beyond: float | None  # Of the tests that it is larger: the smaller one, doubled
