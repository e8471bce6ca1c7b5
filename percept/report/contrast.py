"""Factors, groups and covariates: what the first screen and their section say of contrasts."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from percept.errors import capitalised, counted
from percept.inference.record import percent
from percept.report.numbers import bare, digits_of, rounded
from percept.report.select import (
    KINDS,
    METHODS,
    Section,
    Words,
    distinct,
    listed,
    matching,
    ordered,
    words_of,
)
from percept.results import AnovaRow, ContrastRow, LevelValues, Results
from percept.sessions.formula import TRIAL_REFERENCE
from percept.sessions.quantities import Quantity

__all__ = ["Design", "LevelPanel", "contrast", "contrast_sentences", "design_words", "level_panels"]

_SAID = 3  # more contrasts than this are counted on the first screen, not said
#: What is compared, in the order of the table.
_PARTS = ("level", "bias", "spread", "interaction", "slope")
#: Digits of an estimate, at least: beside a wide interval it has the digits of the narrow one.
_LEAST_DIGITS = 3


@dataclasses.dataclass(frozen=True)
class AnovaTable:
    """The analysis of variance of one quantity."""

    quantity: Quantity
    rows: list[AnovaRow]


@dataclasses.dataclass(frozen=True)
class Contrasts:
    """The section of factors, groups and covariates."""

    within: str  # Factors of which each subject has all levels, as a list in words
    groups: str  # Factors of which each subject has one level
    ratio: bool  # Whether contrasts of bias are ratios, else differences
    bayesian: bool
    overall: list[ContrastRow]  # Of the average user, over all references
    rows: list[ContrastRow]  # Pair by pair of levels
    several: bool  # Quantities
    anova: list[AnovaTable]
    least_digits: int = _LEAST_DIGITS  # Of estimates


def contrast(results: Results) -> Section | None:
    """Return the contrasts of all factors, pair by pair of levels, and slopes of covariates."""
    rows = results.contrast
    if not rows:
        return None
    parameters = distinct(rows, "parameter")
    pairs = list(dict.fromkeys((row.factor, row.first, row.second) for row in rows))

    def place(row: ContrastRow) -> tuple[int, int, int]:
        pair = pairs.index((row.factor, row.first, row.second))
        return pair, parameters.index(row.parameter), _PARTS.index(row.of)

    view = Contrasts(
        within=listed(distinct(matching(rows, within=True), "factor")),
        groups=listed(distinct(matching(rows, within=False), "factor")),
        ratio=rows[0].family == "lognormal",
        bayesian="bayesian" in distinct(rows, "method"),
        overall=_overall(rows),
        rows=sorted(rows, key=place),
        several=len(parameters) > 1,
        anova=[
            AnovaTable(results.data.quantities[name], matching(results.anova, parameter=name))
            for name in distinct(results.anova, "parameter")
        ],
    )
    factors = listed(distinct(rows, "factor"))
    compared = [row for row in rows if row.of != "level"] or rows
    versus = "levels two by two"
    if len({(row.factor, row.first, row.second) for row in compared}) == 1:
        versus = f"{compared[0].second} against {compared[0].first}"
    return Section("contrast", f"{factors}: {versus}", view)


@dataclasses.dataclass(frozen=True)
class LevelPanel:
    """A figure of one quantity over the levels of one factor."""

    name: str  # Of its file, without ending
    parameter: str
    factor: str
    means: list[ContrastRow]  # The average user at every level, by both methods


def level_panels(results: Results) -> list[LevelPanel]:
    """Return a panel per quantity and factor whose levels have means."""
    found = []
    pairs = dict.fromkeys((row.parameter, row.factor) for row in results.levels)
    for number, (parameter, factor) in enumerate(pairs, start=1):
        of_factor = matching(results.contrast, parameter=parameter, factor=factor)
        means = matching(of_factor, of="level", kind="mean")
        if means:
            found.append(LevelPanel(f"levels_{parameter}_{number}", parameter, factor, means))
    return found


@dataclasses.dataclass(frozen=True)
class Design:
    """Factors, groups and covariates of a study, as the methods paragraph names them."""

    within: str  # "2 levels of hand and 3 levels of load"; empty without
    groups: list[str]  # "12 novice and 11 expert (group)"
    covariates: str
    own_slopes: str  # Covariates of which each subject has a slope


def design_words(results: Results) -> Design:
    """Name the levels of factors, the sizes of groups, and the covariates."""
    # Of several quantities the first has the same levels.
    every = matching(results.levels, parameter=results.data.parameters[0])
    levels = matching(every, environment=None)
    within = []
    groups = []
    for factor in distinct(levels, "factor"):
        of_factor = matching(levels, factor=factor)
        if of_factor[0].within:
            within.append(f"{len(of_factor)} levels of {factor}")
            continue
        sizes = []
        for row in of_factor:
            of_level = matching(every, factor=factor, level=row.level)
            sizes.append(f"{_subjects_at(of_level)} {row.level}")
        groups.append(f"{listed(sizes)} ({factor})")
    slopes = matching(results.contrast, of="slope")
    covariates = listed(distinct(slopes, "factor"))
    own_slopes = listed(distinct(matching(slopes, within=True), "factor"))
    return Design(listed(within), groups, covariates, own_slopes)


def _subjects_at(rows: Sequence[LevelValues]) -> int:
    """Count the subjects with a value in any of the rows: some lack references, and an overall."""
    by_subject = zip(*(row.values for row in rows), strict=True)
    return sum(any(value is not None for value in values) for values in by_subject)


def _overall(rows: Sequence[ContrastRow]) -> list[ContrastRow]:
    """Return every contrast over all references, of each quantity's best method.

    Without such a contrast, return those of single references. They are the average user's, or of
    the first kind that there is.
    """
    of_users = [row for row in rows if row.of not in ("level", "spread")]
    best = []
    for factor, parameter in dict.fromkeys((row.factor, row.parameter) for row in of_users):
        of_quantity = matching(of_users, factor=factor, parameter=parameter)
        kind = ordered(KINDS, of_quantity, "kind")[0]
        of_kind = matching(of_quantity, kind=kind)
        for first, second in dict.fromkeys((row.first, row.second) for row in of_kind):
            of_pair = matching(of_kind, first=first, second=second)
            method = ordered(METHODS[::-1], of_pair, "method")[0]
            of_method = matching(of_pair, method=method)
            best += matching(of_method, environment=None) or of_method
    return best


def contrast_sentences(results: Results) -> list[str]:
    """Say how the levels of the factor differ, on what grounds, and how many contrasts remain."""
    contrasts = _overall(results.contrast)
    # No one sentence says what an interaction is.
    rows = [row for row in contrasts if row.of != "interaction"]
    words = words_of(results)
    sentences = []
    for row in rows[:_SAID]:
        label = results.data.quantities[row.parameter].label
        if row.environment is not None:
            label += f" in {row.environment}"
        sure = "confidence" if row.method == "classical" else "probability"
        rests_on = f"{row.n} of {counted(row.of_subjects, words.user, words.users)}"
        if row.environment is None and row.of_references > 1:
            matched = results.data.quantities[row.parameter].is_matched
            places = "references" if matched else words.environments
            rests_on += f" and {len(row.references)} of {row.of_references} {places}"
            if len(row.references) < row.of_references:
                rests_on += f", {listed(row.references)}"
        said = f"{_who_sets(row, words)} {label} {_difference(row)}"
        if row.of == "slope" and row.factor == TRIAL_REFERENCE:
            said = _along_the_reference(row, f"{words.users} set {label}")
        sentences.append(f"{said} with {percent(row.level)} {sure}, from {rests_on}.")
    if len(contrasts) > len(sentences):
        more = counted(len(contrasts) - len(sentences), "more contrast")
        factors = listed(distinct(contrasts, "factor"))
        sentences.append(f"The section on {factors} has {more}.")
    return sentences


def _who_sets(row: ContrastRow, words: Words) -> str:
    """Begin a sentence with the users whose contrast a row holds."""
    if row.kind == "user":
        return f"The next {words.user} sets"
    if row.share is not None:
        return f"At least {percent(row.share)} of {words.users} set"
    return f"{capitalised(words.users)} set"


def _along_the_reference(row: ContrastRow, users_set: str) -> str:
    """Say how settings, and their ratio to the reference, change over a decade of it."""
    if row.family != "lognormal":
        way = "falls" if row.estimate < 0 else "rises"
        size = f"{_size(row, abs(row.estimate))} {row.unit}"
        what = f"the difference from the reference that {users_set} {way} by {size}"
        return f"Per decade of reference {what}: {_ends(row)} {row.unit}"
    way = "falls" if row.estimate < 1 else "rises"
    # The reference itself is ten times as high.
    times = f"{users_set} {_size(row, 10.0 * row.estimate)} times as high"
    ratio = f"the ratio to the reference {way} to {_size(row, row.estimate)} times"
    return f"Per decade of reference {times}: {ratio}, {_ends(row)}"


def _size(row: ContrastRow, value: float) -> str:
    """Write a value with the digits of a row's estimate."""
    digits = max(digits_of(row.estimate, row.lower, row.upper), _LEAST_DIGITS)
    return bare(rounded(value, digits))


def _ends(row: ContrastRow) -> str:
    """Write a row's interval."""
    lower = bare(rounded(row.lower, digits_of(row.lower, row.lower, row.upper)))
    upper = bare(rounded(row.upper, digits_of(row.upper, row.lower, row.upper)))
    return f"{lower} to {upper}"


def _difference(row: ContrastRow) -> str:
    """Say how the second level differs from the first, with the interval."""
    size = _size(row, abs(row.estimate))
    ends = _ends(row)
    if row.of == "slope":
        row = dataclasses.replace(row, second=f"{row.second} of {row.factor}")
    if row.family == "lognormal":
        return f"{size} times as high with {row.second} as with {row.first}: {ends}"
    side = "lower" if row.estimate < 0 else "higher"
    levels = f"{side} with {row.second} than with {row.first}"
    return f"{size} {row.unit} {levels}: {ends} {row.unit}"
