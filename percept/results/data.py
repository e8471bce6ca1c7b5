"""What was read, and what a result was made from."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from percept.sessions.quantities import Quantity


@dataclasses.dataclass(frozen=True)
class SourceFile:
    """A file that was read."""

    name: str  # Without its folders
    sha256: str  # Of its bytes
    rows: int


@dataclasses.dataclass(frozen=True)
class Provenance:
    """What a result was made from."""

    versions: dict[str, str]  # Of percept, Python and the libraries, by name
    seed: int
    files: tuple[SourceFile, ...]
    scene: Mapping[str, Any]  # Every setting, by table and key


@dataclasses.dataclass(frozen=True)
class Note:
    """Something the reader decided, or doubts, with its place where it has one."""

    text: str
    file: str | None = None
    row: int | None = None  # Physical line of the file; the header is 1


@dataclasses.dataclass(frozen=True)
class LeftOutRow:
    """One observation or subject that was left out."""

    who: str
    what: str
    why: str
    file: str | None = None
    row: int | None = None


@dataclasses.dataclass(frozen=True)
class DesignCounts:
    """How many cells, trials and sessions the study has."""

    cells: int  # Subjects times environments, other groups' cells not counted
    missing: int  # Cells without a trial
    trials: tuple[int, int]  # Fewest and most in a cell
    sessions: tuple[int, int]  # Fewest and most of a subject


@dataclasses.dataclass(frozen=True)
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class SubjectRow:
    """What one subject adjusted of one quantity, over all environments."""

    subject: str
    parameter: str
    n: int  # Environments with an adjustment
    trials: int
    relative: bool  # Whether deviations are fractions of the reference; else they are in `unit`
    log: bool  # Whether `mean` is geometric, and `sd` one of logarithms
    mean: float  # Deviation from the reference
    sd: float | None  # Between environments; None with fewer than two
    distance: float | None  # From the others' mean in their SDs; None with fewer than two others
    unit: str


@dataclasses.dataclass(frozen=True)
class Words:
    """What a study calls one and several environments, subjects and users, and what these did."""

    environment: str
    environments: str
    subject: str
    subjects: str
    user: str  # Users, unless the study names its subjects
    users: str
    verb: str = "set"  # What they did to a quantity, in the past tense


@dataclasses.dataclass(frozen=True)
class Data:
    """What was read: subjects, environments, quantities, notices, and the values of every cell."""

    form: str  # "trials", or "summary" of published limits
    simulated: bool
    subjects: int
    rows: int
    environments: tuple[str, ...]
    references: int  # Environments, each once for all levels of the factor
    factor: str | None  # Column of conditions within subjects
    parameters: tuple[str, ...]
    quantities: dict[str, Quantity]  # By parameter
    words: Words
    counts: dict[str, int]  # Of rows read, left out and missing, by what is counted
    notices: tuple[Note, ...]
    doubts: tuple[Note, ...]
    exclusions: tuple[LeftOutRow, ...]
    design: DesignCounts | None  # None for published limits
    cells: tuple[CellValues, ...]
    people: tuple[SubjectRow, ...] = ()
