"""Which column has which part in a study, judged from what is in it; its name is one hint more.

A subject's id stays for a run of rows and comes again. An order counts up. A reference has values
that nearly every subject meets. An adjustment differs within a cell and goes with its reference. A
moment rises and never comes again. Each judgement gives points; what comes close to the choice is
kept as an alternative.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.sessions.evidence import (
    UNITS,
    Column,
    agreement,
    counts_up,
    is_designed,
    is_moment,
    nearness,
    steadiness,
    varies_within,
)
from percept.sessions.quantities import IMPEDANCE

__all__ = [
    "DECIBELS",
    "ID_COLUMNS",
    "MOST_QUANTITIES",
    "NOT_ADJUSTED",
    "Numbers",
    "Roles",
    "crossed_with_environment",
    "drop_unnamed_subject",
    "is_order",
    "judge_environment",
    "judge_ids",
    "judge_numbers",
    "take_most_varied",
]

#: Units of logarithms that are read as amplitudes.
DECIBELS = ("dB", "db", "dB SPL", "dB HL")
#: Canonical columns of ids, in the order of a proposal.
ID_COLUMNS = ("subject", "session", "environment", "trial")
_WORDS = {
    "subject": (
        "participant part subject subj sub nsub pp ppid pid vp vpn observer person respondent"
        " proband rater judge panelist worker animal dog rat mouse rabbit monkey child student"
        " pupil patient id code"
    ),
    "session": "session visit day",
    "environment": "environment condition standard stimulus reference cond stim level item",
    "trial": "trial trl repetition rep repeat run",
    "adjusted": (
        "response resp adjusted adjustment adj match matched matching estimate estimated final "
        "reproduced reproduction judgment judgement setting answer guess guessed perceived"
    ),
    "reference": (
        "reference ref standard stimulus stim target true actual physical presented cur current"
        " test sample shown"
    ),
    "timing": "started stopped onset rt latency timestamp date clock frame frames elapsed wait",
    "group": "group grp treatment arm sex gender cohort class",
    "duration": "rt latency duration elapsed",
    "outcome": "score rating outcome y dv points",
    "other": "initial start error err bias deviation confidence age",
    "empty": "value mean level size magnitude the of in id nr no num number",
}
_ID_WORDS = {name: _WORDS[name].split() for name in ID_COLUMNS}
_ADJUSTED = frozenset(_WORDS["adjusted"].split())
_REFERENCE = frozenset(_WORDS["reference"].split())
#: Words of columns that hold when something happened, or what nobody adjusts.
NOT_ADJUSTED = frozenset(f"{_WORDS['timing']} {_WORDS['other']}".split())
_TIMING = frozenset(_WORDS["timing"].split())
#: Words of columns that part subjects into groups, and of times that may be the only response.
_GROUP = frozenset(_WORDS["group"].split())
_DURATION = frozenset(_WORDS["duration"].split())
_OUTCOME = frozenset(_WORDS["outcome"].split())
#: Words that say nothing of what was adjusted.
_EMPTY = frozenset(_WORDS["empty"].split()).union(*_ID_WORDS.values())
#: Points for a name that is a word of the role, and for one that has it among others.
_WHOLE_NAME = 3.0
_PART_OF_NAME = 2.0
#: Points that each earlier word of a role's list is worth more.
_EARLIER_WORD = 0.05
#: Points for more than two values, which weigh as much as a word in the name.
_GRADED = 2.0
#: Points for what is in a column, each: steady for a run of rows, designed, of one scale.
_CONTENT = 1.5
#: Share of its points that a condition keeps where each subject has one: they are groups.
_OF_GROUPS = 0.25
#: Levels that a second condition has at most.
_MOST_LEVELS = 12
#: Points a subject's id has at least: a name, or steady cells with many subjects.
_SUBJECT_FROM = 2.0
#: Subjects from which on steady cells count in full: fewer are rather groups.
_MANY_SUBJECTS = 5
#: Share of runs of rows from which on cells are steady: a few subjects came twice.
_STEADY = 0.9
#: Rank correlation from which on an adjustment may go with a reference.
_LEAST_AGREEMENT = 0.2
#: Points two columns have at least to be adjustment and reference without a name that says so:
#: such as near values, and a rank correlation of 0.5 with a designed reference.
_PAIR_FROM = 3.5
#: Points below the choice at which another column is an alternative.
_CLOSE = 1.5
#: Alternatives that a proposal names for one column.
_MOST_ALTERNATIVES = 2
#: Quantities taken from one table.
MOST_QUANTITIES = 3
#: Columns of numbers that are looked at: every pair of them is compared.
_MOST_NUMBERS = 40


@dataclass
class Roles:
    """Which column has which part, by canonical name."""

    found: dict[str, Column] = field(default_factory=dict)
    alternatives: dict[str, list[Column]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)  # Of new quantities
    #: Quantities that a scene names; without them percept names what it finds.
    declared: tuple[str, ...] = ()

    @property
    def taken(self) -> list[Column]:
        """Columns that have a part."""
        return list(self.found.values())

    @property
    def has_adjustment(self) -> bool:
        """Whether a column holds adjustments."""
        return any(canonical.endswith("_adj") for canonical in self.found)

    def take(self, canonical: str, ranked: Sequence[tuple[float, Column]]) -> None:
        """Give the first of a ranking its part, and keep what comes close behind it."""
        points, column = ranked[0]
        self.found[canonical] = column
        close = [other for behind, other in ranked[1:] if behind > points - _CLOSE]
        self.alternatives[canonical] = close[:_MOST_ALTERNATIVES]


@dataclass(frozen=True)
class Numbers:
    """Columns of numbers, with what the subjects say of each."""

    columns: list[Column]
    durations: list[Column]  # Left out of `columns`, for studies that have no other response
    designed: frozenset[str]
    subjects: npt.NDArray[np.intp]

    @classmethod
    def of(cls, columns: Iterable[Column], subjects: npt.NDArray[np.intp]) -> Numbers:
        """Keep columns of numbers that are no moments and do not count up."""
        kept = []
        durations = []
        for column in columns:
            if not column.is_numeric:
                continue
            if _TIMING & set(column.words):
                if _DURATION & set(column.words) and not is_moment(column):
                    durations.append(column)
                continue
            # A few adjustments rise by chance; a name that says what they are goes before.
            is_clock = is_moment(column) and not _ADJUSTED & set(column.words)
            if not is_clock and not is_order(column):
                kept.append(column)
        kept = kept[:_MOST_NUMBERS]
        designed = {column.name for column in kept if is_designed(column, subjects)}
        return cls(kept, durations, frozenset(designed), subjects)


def is_order(column: Column) -> bool:
    """Whether a column counts trials; a name that says adjustment or reference goes before."""
    named = (_ADJUSTED | _REFERENCE) & set(column.words)
    return not named and counts_up(column)


def _named(column: Column, role: str) -> float:
    """Points of a name for the role of an id."""
    whole = re.sub("(?<=.)(number|num|no|nr|id)$", "", "".join(column.words))
    words = _ID_WORDS[role]
    for rank, word in enumerate(words):
        if whole == word:
            return _WHOLE_NAME - _EARLIER_WORD * rank
    for rank, word in enumerate(words):
        if word in column.words and word != "id":
            return _PART_OF_NAME - _EARLIER_WORD * rank
    return 0.0


def _ranking(points: Iterable[tuple[float, Column]]) -> list[tuple[float, Column]]:
    """Order columns by their points, those with none left out."""
    return sorted((pair for pair in points if pair[0] > 0), key=lambda pair: -pair[0])


def judge_ids(roles: Roles, free: Sequence[Column]) -> None:
    """Find subject, session and trial among columns that have no part yet."""
    if "subject" not in roles.found:
        points = [(_subject_points(column), column) for column in free]
        ranked = [pair for pair in _ranking(points) if pair[0] >= _SUBJECT_FROM]
        if ranked:
            roles.take("subject", ranked)
    free = [column for column in free if column not in roles.taken]
    for role in ("session", "trial"):
        if role in roles.found:
            continue
        points = [(_named(column, role), column) for column in free if _may_number(column, role)]
        if ranked := _ranking(points):
            roles.take(role, ranked)


def _subject_points(column: Column) -> float:
    """Points of a column as the subject's id: its name, and cells that stay for a run of rows."""
    rows = len(column.cells)
    levels = len(column.texts)
    named = _named(column, "subject")
    if levels < 2 or (column.is_numeric and not column.is_whole):
        return 0.0
    if (_TIMING | {*_ID_WORDS["trial"]}) & set(column.words):
        return 0.0
    if not named and _GROUP & set(column.words):
        return 0.0
    if not named and (levels > rows / 2 or is_order(column) or is_moment(column)):
        return 0.0
    many = min(1.0, levels / _MANY_SUBJECTS)
    points = named + many
    if steadiness(column) > _STEADY:
        points += _CONTENT * many
    return points


def _may_number(column: Column, role: str) -> bool:
    """Whether a column may number sessions or trials; trials need whole numbers."""
    if len(column.texts) < 2 or _TIMING & set(column.words):
        return False
    return role == "session" or column.is_whole


def judge_numbers(roles: Roles, numbers: Numbers) -> None:
    """Find adjustments, their references and the quantities that these are of."""
    named = [column for column in numbers.columns if _may_be_adjusted(column, numbers)]
    named = [column for column in named if _ADJUSTED & set(column.words)]
    others = [other for other in numbers.columns if other not in named]
    references = {column.name: _references(column, others, numbers) for column in named}
    # Beside one that goes with a reference, such as a response, stands a "response time".
    with_reference = [column for column in named if references[column.name]]
    for column in (with_reference or named)[:MOST_QUANTITIES]:
        _add_quantity(roles, [(1.0, column)], references[column.name])
    if roles.has_adjustment:
        return
    pairs: list[tuple[float, Column, Column]] = []
    for column in numbers.columns:
        if _may_be_adjusted(column, numbers) and column.name not in numbers.designed:
            others = [other for other in numbers.columns if other is not column]
            best = _references(column, others, numbers)[:1]
            pairs += [(points, column, other) for points, other in best]
    pairs.sort(key=lambda pair: -pair[0])
    if pairs and pairs[0][0] >= _PAIR_FROM:
        adjusted = [(points, column) for points, column, _ in pairs]
        others = [other for other in numbers.columns if other is not pairs[0][1]]
        _add_quantity(roles, adjusted, _references(pairs[0][1], others, numbers))


def take_most_varied(roles: Roles, numbers: Numbers) -> None:
    """Take the numbers of most values for the adjustment: no name and no reference says more."""
    points = []
    for column in numbers.columns:
        named = bool(_OUTCOME & set(column.words))
        free = named or column.name not in numbers.designed
        if free and _may_be_adjusted(column, numbers):
            # The others are alternatives, however few values they have.
            score = _variety(column)
            if named:
                score += _PART_OF_NAME
            points.append((score, column))
    for column in numbers.durations:
        if varies_within(column, numbers.subjects):
            points.append((_variety(column) / 2.0, column))
    if ranked := _ranking(points):
        _add_quantity(roles, ranked, [])


def _variety(column: Column) -> float:
    """Points for different values: a yes or no is hardly an adjustment."""
    different = len(column.texts) / len(column.cells)
    if len(column.texts) > 2:
        return _GRADED + different
    return different


def _may_be_adjusted(column: Column, numbers: Numbers) -> bool:
    """Whether a column differs from row to row of a subject, and no word speaks against it."""
    if NOT_ADJUSTED & set(column.words):
        return False
    differs = len(column.texts) > 1 or len(column.cells) == 1
    return differs and varies_within(column, numbers.subjects)


def _references(
    column: Column, others: Sequence[Column], numbers: Numbers
) -> list[tuple[float, Column]]:
    """Rank the columns that may be the reference of an adjustment."""
    points = []
    for other in others:
        words = set(other.words)
        named = bool(_REFERENCE & words)
        fewer = len(other.texts) < len(column.texts) or named
        if not fewer or words & NOT_ADJUSTED or words & _ADJUSTED:
            continue
        if not named and not _may_be_shown(other, column, numbers):
            continue
        agreement_share = max(0.0, agreement(column, other, numbers.subjects))
        near = nearness(column, other)
        # A condition that is merely designed, or of another size, is no reference.
        if agreement_share < _LEAST_AGREEMENT and not (near and named):
            continue
        total = 2.0 * (agreement_share + near)
        if other.name in numbers.designed:
            total += _CONTENT
        if named:
            total += _PART_OF_NAME
        topic = _about(column, _ADJUSTED)
        if topic and topic == _about(other, _REFERENCE):
            total += _CONTENT
        points.append((total, other))
    return _ranking(points)


def _may_be_shown(other: Column, column: Column, numbers: Numbers) -> bool:
    """Whether most subjects meet the values of a column, and an adjustment differs beside it."""
    if other.name not in numbers.designed:
        return False
    cells = pd.MultiIndex.from_arrays([numbers.subjects, other.codes])
    return varies_within(column, pd.factorize(cells)[0])


def _add_quantity(
    roles: Roles,
    adjusted: Sequence[tuple[float, Column]],
    references: Sequence[tuple[float, Column]],
) -> None:
    """Name what was adjusted, and give an adjustment and its reference their parts."""
    column = adjusted[0][1]
    reference = references[0][1] if references else None
    unit = column.unit or (reference.unit if reference else None) or ""
    name = _about(column, _ADJUSTED)
    if not name and reference:
        name = _about(reference, _REFERENCE)
    name = name or UNITS.get(unit, "response")
    name = {"stiffness": "k", "damping": "b"}.get(name, name)
    if not re.fullmatch("[a-z][a-z0-9]*(_[a-z0-9]+)*", name):
        name = "response"
    if roles.declared:
        name = _declared_name(roles, name)
    if not name or f"{name}_adj" in roles.found:
        return
    if name not in IMPEDANCE and not roles.declared:
        # Decibels are read as amplitudes, which are pure numbers: their ratios mean something.
        roles.units[name] = "" if unit in DECIBELS else unit
    roles.take(f"{name}_adj", adjusted)
    if references:
        roles.take(f"{name}_ref", references)


def _declared_name(roles: Roles, name: str) -> str:
    """Choose the scene's name for a quantity: the same one, or the first without a column."""
    vacant = [other for other in roles.declared if f"{other}_adj" not in roles.found]
    if name in vacant:
        return name
    return vacant[0] if vacant else ""


def _about(column: Column, role_words: frozenset[str]) -> str:
    """Name what a column is of: the words that give no role."""
    silent = role_words | _EMPTY
    return "_".join(w for w in column.words if w not in silent and not w.isdigit())


def drop_unnamed_subject(roles: Roles) -> bool:
    """Take back a subject that its cells alone made one: they may be the adjustments."""
    subject = roles.found.get("subject")
    if subject is None or _named(subject, "subject"):
        return False
    del roles.found["subject"]
    return True


def judge_environment(roles: Roles, free: Sequence[Column]) -> None:
    """Find what tells environments apart: names of the references, or these themselves."""
    if "environment" in roles.found:
        return
    references = [column for name, column in roles.found.items() if name.endswith("_ref")]
    subject = roles.found.get("subject")
    points = []
    for column in free:
        total = _named(column, "environment")
        recurs = 1 <= len(column.texts) <= len(column.cells) / 2
        designed = subject is not None and is_designed(column, subject.codes)
        if not recurs or (column.is_numeric and not column.is_whole and not designed):
            continue
        if len(column.texts) == 1 and not total:
            continue
        if not all(_is_function(reference, column) for reference in references):
            continue
        if not references:
            # Without subjects words name conditions, and numbers may as well name subjects.
            told = designed if subject else not column.is_numeric
            total += _CONTENT * told
        if subject is not None and _is_function(column, subject):
            total *= _OF_GROUPS
        points.append((total, column))
    ranked = _ranking(points)
    if ranked:
        roles.take("environment", ranked)
    elif references:
        roles.found["environment"] = references[0]


def crossed_with_environment(roles: Roles, free: Sequence[Column]) -> list[Column]:
    """Give the other conditions that most subjects meet beside each of the environments."""
    environment = roles.found.get("environment")
    subject = roles.found.get("subject")
    if environment is None or subject is None or environment.name.endswith("_ref"):
        return []
    cells = pd.MultiIndex.from_arrays([subject.codes, environment.codes])
    codes = pd.factorize(cells)[0]
    crossed = []
    for column in free:
        words = set(column.words)
        few = 2 <= len(column.texts) <= _MOST_LEVELS
        if few and not words & (NOT_ADJUSTED | _OUTCOME) and is_designed(column, codes):
            crossed.append(column)
    return crossed


def _is_function(reference: Column, column: Column) -> bool:
    """Whether each value of a column goes with one reference."""
    pairs = np.unique(np.stack([column.codes, reference.codes]), axis=1)
    return len(pairs[0]) == len(np.unique(column.codes))
