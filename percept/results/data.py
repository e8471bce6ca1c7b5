"""What was read, what a result was made from, and how far the sampler and the model hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator

from percept.html import NotebookRecord
from percept.inference.record import Family
from percept.inference.sampling.gate import Gate
from percept.sessions.quantities import Quantity
from percept.sessions.records import Exclusion, Source


@dataclass(frozen=True)
class Provenance:
    """What a result was made from."""

    versions: dict[str, str]  # Of percept, Python and the libraries, by name
    seed: int
    files: tuple[Source, ...]
    scene: Mapping[str, Any]  # Every setting, by table and key


@dataclass(frozen=True)
class Note:
    """Something the reader decided, or doubts, with its place where it has one."""

    text: str
    file: str | None = None
    row: int | None = None  # Physical line of the file; the header is 1


@dataclass(frozen=True)
class DesignCounts:
    """How many cells, trials and sessions the study has."""

    cells: int  # Subjects times environments, other groups' cells not counted
    missing: int  # Cells without a trial
    trials: tuple[int, int]  # Fewest and most in a cell
    sessions: tuple[int, int]  # Fewest and most of a subject


@dataclass(frozen=True)
class CellValues:
    """What the subjects adjusted in one environment: their own means over trials, of no model."""

    environment: str
    parameter: str
    reference: float  # In `unit`, as all that follows
    n: int  # Subjects
    mean: float | None  # None without subjects
    sd: float | None  # None with fewer than two
    values: tuple[float, ...]  # One per subject
    unit: str


@dataclass(frozen=True, kw_only=True)
class SubjectRow:
    """What one subject adjusted of one quantity, over all environments."""

    subject: str
    parameter: str
    n: int  # Environments with an adjustment
    relative: bool  # Whether deviations are fractions of the reference; else they are in `unit`
    log: bool  # Whether `mean` is geometric, and `sd` one of logarithms
    mean: float  # Deviation from the reference
    sd: float | None  # Between environments; None with fewer than two
    distance: float | None  # From the others' mean in their SDs; None with fewer than two others
    unit: str


@dataclass(frozen=True)
class Words:
    """What a study calls one and several environments, subjects and users, and what these did."""

    environment: str
    environments: str
    subject: str
    subjects: str
    user: str  # Users, unless the study names its subjects
    users: str
    verb: str = "set"  # What they did to a quantity, in the past tense


@dataclass(frozen=True)
class Data:
    """What was read: subjects, environments, quantities, notices, and the values of every cell."""

    form: str  # "trials", or "summary" of published limits
    simulated: bool
    subjects: int
    rows: int
    environments: tuple[str, ...]
    references: int  # Environments, each once for all levels of the factor
    parameters: tuple[str, ...]
    quantities: dict[str, Quantity]  # By parameter
    words: Words
    counts: dict[str, int]  # Of rows read, left out and missing, by what is counted
    notices: tuple[Note, ...]
    doubts: tuple[Note, ...]
    exclusions: tuple[Exclusion, ...]
    design: DesignCounts | None  # None for published limits
    cells: tuple[CellValues, ...]
    people: tuple[SubjectRow, ...] = ()


@dataclass(frozen=True)
class Prior:
    """A prior in force."""

    prior: str  # Its key in [model.priors]
    value: float
    meaning: str


def _measures(gate: Any) -> Any:
    """Read what a run was too short to measure: null is NaN."""
    if not isinstance(gate, dict):
        return gate
    return {name: math.nan if value is None else value for name, value in gate.items()}


@dataclass(frozen=True)
class Diagnostics(NotebookRecord):
    """How the hierarchical model was sampled."""

    #: Its measures are null where a run is too short for them.
    gate: Annotated[Gate, BeforeValidator(_measures)]
    steps: int  # Per ensemble
    ensembles: int
    walkers: int  # Per ensemble
    tolerance: float  # Monte Carlo error asked for, of every limit, in half-widths
    priors: tuple[Prior, ...]


@dataclass(frozen=True)
class NormalityTest:
    """Shapiro and Wilk's test of one cell's values (normal) or of their logarithms (lognormal)."""

    environment: str
    parameter: str
    family: Family
    statistic: float
    p_value: float
    n: int


@dataclass(frozen=True)
class SubjectCheck:
    """A subject against what the others predict."""

    subject: str
    pareto_k: float  # Pareto index of leaving the subject out
    farther: float  # Probability of lying as far off, or farther
    outlier: bool


@dataclass(frozen=True)
class CellOutlier:
    """A subject's cell that lies far from what the other subjects predict."""

    subject: str
    environment: str
    parameter: str
    value: float  # In the parameter's unit
    below: float  # Predictive probability of a smaller value


@dataclass(frozen=True)
class LeftOut(NotebookRecord):
    """Each subject against what the others predict."""

    good_k: float  # Pareto index up to which reweighting is trusted, with this many draws
    subjects: tuple[SubjectCheck, ...]
    cells: tuple[CellOutlier, ...]
    messages: tuple[str, ...]  # Outliers by name, with what to do


@dataclass(frozen=True)
class IntervalWithout:
    """The average user's interval without each subject in turn, in the order of `LeftOut`.

    None stands where the weights of the draws cannot be trusted. Of many environments there are the
    first, as of curves.
    """

    environment: str
    parameter: str
    estimate: tuple[float | None, ...]  # In the parameter's unit
    lower: tuple[float | None, ...]
    upper: tuple[float | None, ...]


@dataclass(frozen=True)
class PredictiveCheck:
    """A statistic of one cell against new studies drawn from the posterior."""

    environment: str
    parameter: str
    statistic: str  # "mean", "sd" or "farthest"
    above: float  # Share of new studies with more
    unusual: bool  # Too far out for chance, over all checks of the study


@dataclass(frozen=True, kw_only=True)
class Checks(NotebookRecord):
    """Checks of the model; without a Bayesian fit of subjects only the tests of normality."""

    normality: tuple[NormalityTest, ...]
    loo: LeftOut | None = None
    without: tuple[IntervalWithout, ...] = ()
    statistics: tuple[PredictiveCheck, ...] = ()
