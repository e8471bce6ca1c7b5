"""Diagnostics of the sampler, and checks of the model against its data and priors."""

from __future__ import annotations

import dataclasses

from percept.html import NotebookRecord
from percept.inference.record import Family


@dataclasses.dataclass(frozen=True)
class GateVerdict:
    """Verdict on a run of the sampler, and the measures behind it."""

    passed: bool  # Whether the run has mixed, so that its numbers may be reported
    reasons: tuple[str, ...]  # What failed
    rhat: float | None  # Largest rank R-hat across ensembles
    autocorrelation_time: float | None  # Longest of a reported quantity, in steps
    slowest: str  # The quantity it belongs to
    times_run: float | None  # Kept steps per ensemble over that time
    effective_draws: float | None  # Of the slowest reported quantity
    acceptance: float | None  # Mean acceptance fraction
    lowest_acceptance: float | None  # Of the slowest walker
    worst_error: float | None  # Largest Monte Carlo error over half-width
    worst: str  # The estimate it belongs to
    tolerance_met: bool  # Whether that error is within the tolerance
    error_reached: str  # A sentence on the error where it misses the tolerance, else empty
    rhat_limit: float  # What R-hat had to stay below
    times_needed: float  # What `times_run` had to reach


@dataclasses.dataclass(frozen=True)
class Prior:
    """A prior in force."""

    prior: str  # Its key in [model.priors]
    value: float
    meaning: str


@dataclasses.dataclass(frozen=True)
class Diagnostics(NotebookRecord):
    """How the hierarchical model was sampled."""

    gate: GateVerdict
    steps: int  # Per ensemble
    ensembles: int
    walkers: int  # Per ensemble
    dimension: int  # Coordinates sampled
    tolerance: float  # Monte Carlo error asked for, of every limit, in half-widths
    priors: tuple[Prior, ...]


@dataclasses.dataclass(frozen=True)
class NormalityTest:
    """Shapiro and Wilk's test of one cell's values (normal) or of their logarithms (lognormal)."""

    environment: str
    parameter: str
    family: Family
    statistic: float
    p_value: float
    n: int


@dataclasses.dataclass(frozen=True)
class SubjectCheck:
    """A subject against what the others predict."""

    subject: str
    elpd: float | None  # Log predictive density given the others; None where not to be trusted
    pareto_k: float | None  # Pareto index of leaving the subject out
    farther: float  # Probability of lying as far off, or farther
    outlier: bool


@dataclasses.dataclass(frozen=True)
class CellOutlier:
    """A subject's cell against what the other subjects predict."""

    subject: str
    environment: str
    parameter: str
    value: float  # In the parameter's unit
    below: float  # Predictive probability of a smaller value
    outlier: bool


@dataclasses.dataclass(frozen=True)
class LeftOut(NotebookRecord):
    """Each subject against what the others predict."""

    #: Expected log predictive density of a new subject, summed over the subjects; None where that
    #: of one of them is not to be trusted.
    elpd: float | None
    se: float | None  # Its standard error
    good_k: float  # Pareto index up to which reweighting is trusted, with this many draws
    subjects: tuple[SubjectCheck, ...]
    cells: tuple[CellOutlier, ...]  # Only those that are outliers, in report.json
    messages: tuple[str, ...]  # Outliers by name, with what to do


@dataclasses.dataclass(frozen=True)
class IntervalWithout:
    """The average user's interval without each subject in turn, in the order of `LeftOut`.

    None stands where the weights of the draws cannot be trusted.
    """

    environment: str
    parameter: str
    estimate: tuple[float | None, ...]  # In the parameter's unit
    lower: tuple[float | None, ...]
    upper: tuple[float | None, ...]


@dataclasses.dataclass(frozen=True)
class PredictiveCheck:
    """A statistic of one cell against new studies drawn from the posterior."""

    environment: str
    parameter: str
    statistic: str  # "mean", "sd" or "farthest"
    observed: float
    lower: float
    upper: float
    above: float  # Share of new studies with more
    unusual: bool


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checks(NotebookRecord):
    """Checks of the model; without a Bayesian fit of subjects only the tests of normality."""

    normality: tuple[NormalityTest, ...]
    loo: LeftOut | None = None
    without: tuple[IntervalWithout, ...] = ()
    statistics: tuple[PredictiveCheck, ...] = ()
