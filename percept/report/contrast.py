"""Conditions within subjects: what the first screen and the section of the factor say of their contrasts."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from percept.errors import counted
from percept.inference.record import percent
from percept.report.numbers import bare, digits_of, rounded
from percept.report.select import METHODS, Section, distinct, listed, matching, ordered, words_of
from percept.results import ContrastRow, Results
from percept.sessions.quantities import Quantity

__all__ = ["contrast", "contrast_sentences"]

_SAID = 3  # more contrasts than this are counted on the first screen, not said


@dataclasses.dataclass(frozen=True)
class ContrastTable:
    """The contrasts of two levels in the bias or the spread of one quantity."""

    first: str
    second: str
    quantity: Quantity
    of: str
    rows: list[ContrastRow]


@dataclasses.dataclass(frozen=True)
class Contrasts:
    """The section of a factor."""

    factor: str
    ratio: bool  # Whether contrasts of bias are ratios, else differences
    bayesian: bool
    overall: list[ContrastRow]  # Of the average user, over all references
    tables: list[ContrastTable]


def contrast(results: Results) -> Section | None:
    """Return the contrasts of conditions within subjects, pair by pair of levels."""
    rows = results.contrast
    if not rows:
        return None
    pairs = list(dict.fromkeys((row.first, row.second) for row in rows))
    tables = []
    for first, second in pairs:
        of_pair = matching(rows, first=first, second=second)
        for parameter in distinct(rows, "parameter"):
            quantity = results.data.quantities[parameter]
            for of in ("bias", "spread"):
                alike = matching(of_pair, parameter=parameter, of=of)
                if alike:
                    tables.append(ContrastTable(first, second, quantity, of, alike))
    view = Contrasts(
        factor=rows[0].factor,
        ratio=rows[0].family == "lognormal",
        bayesian="bayesian" in distinct(rows, "method"),
        overall=_overall(rows),
        tables=tables,
    )
    versus = f"{pairs[0][1]} against {pairs[0][0]}" if len(pairs) == 1 else "levels two by two"
    return Section("contrast", f"{rows[0].factor}: {versus}", view)


def _overall(rows: Sequence[ContrastRow]) -> list[ContrastRow]:
    """Return the average user's contrast over all references, of each quantity's best method.

    Without any such contrast it is those of single references.
    """
    means = matching(rows, of="bias", kind="mean")
    overall = matching(means, environment=None) or means
    best = []
    for parameter in distinct(overall, "parameter"):
        alike = matching(overall, parameter=parameter)
        best += matching(alike, method=ordered(METHODS[::-1], alike, "method")[0])
    return best


def contrast_sentences(results: Results) -> list[str]:
    """Say how the levels of the factor differ, what that rests on, and how many contrasts more there are."""
    rows = _overall(results.contrast)
    words = words_of(results)
    users = f"{words.users[:1].upper()}{words.users[1:]}"
    sentences = []
    for row in rows[:_SAID]:
        label = results.data.quantities[row.parameter].label
        if row.environment is not None:
            label += f" in {row.environment}"
        sure = "confidence" if row.method == "classical" else "probability"
        rests_on = f"{row.n} of {counted(row.of_subjects, words.user, words.users)}"
        if row.environment is None:
            rests_on += f" and {len(row.references)} of {row.of_references} references"
            if len(row.references) < row.of_references:
                rests_on += f", {listed(row.references)}"
        sentences.append(
            f"{users} set {label} {_difference(row)} with {percent(row.level)} {sure}, from"
            f" {rests_on}."
        )
    if len(rows) > _SAID:
        more = counted(len(rows) - _SAID, "contrast")
        sentences.append(f"The section on {rows[0].factor} has {more} more.")
    return sentences


def _difference(row: ContrastRow) -> str:
    """Say how the second level differs from the first, with the interval."""
    digits = digits_of(row.estimate, row.lower, row.upper)
    ends = f"{bare(rounded(row.lower, digits))} to {bare(rounded(row.upper, digits))}"
    size = bare(rounded(abs(row.estimate), digits))
    if row.family == "lognormal":
        return f"{size} times as high with {row.second} as with {row.first}: {ends}"
    side = "lower" if row.estimate < 0 else "higher"
    levels = f"{side} with {row.second} than with {row.first}"
    return f"{size} {row.unit} {levels}: {ends} {row.unit}"
