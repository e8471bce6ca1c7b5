"""What is seldom meant in a study that can be read: warnings to look at before believing it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import counted
from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, Notice, Places, clip, shown
from percept.sessions.values import fold, is_missing

__all__ = ["doubtful_ids", "doubtful_scales", "screen"]

#: A value as many times the median of its environment, or as small a part of it, is hardly ever a
#: person's.
_GROSS = 30.0
#: Subjects an environment needs for its median to say anything of one of them.
_FEWEST = 3
#: Values below this share of all are few.
_FEW = 0.05
#: Environments that a study hardly has on purpose.
_MANY = 12
#: A whole turn in units of angles, and the names of logarithmic units.
_TURNS = {"deg": 360.0, "°": 360.0, "degree": 360.0, "degrees": 360.0, "rad": 2 * np.pi}
_LOGARITHMIC = re.compile(r"db.*|bels?|np|phons?|cents?|semitones?|octaves?|decades?|ph")
#: Equal values at one end that chance hardly gives, where adjustments are read to several digits.
_ENOUGH = 4
#: Cyrillic and Greek letters, and the Latin ones that look the same.
_HOMOGLYPHS = str.maketrans(
    "АВЕКМНОРСТХаеорсухіѕјԁһ" + "ΑΒΕΖΗΙΚΜΝΟΡΤΥΧονκρ",
    "ABEKMHOPCTXaeopcyxisjdh" + "ABEZHIKMNOPTYXovkp",
)


def doubtful_ids(table: pd.DataFrame, place: Places) -> Iterator[Notice]:
    """Notice ids that look alike or like a missing value, with the first row of each."""
    for column in IDS:
        firsts = table[column].drop_duplicates()
        names = firsts.tolist()
        rows = [_where(place(int(position))) for position in firsts.index]
        written = [f"{_written(name)} ({row})" for name, row in zip(names, rows, strict=True)]
        alike: dict[str, list[str]] = {}
        for name, text in zip(names, written, strict=True):
            alike.setdefault(_look(name), []).append(text)
            if is_missing(name):
                yield Notice(f"{column} {text} is taken as a name: is it a missing value?")
        for texts in alike.values():
            if len(texts) > 1:
                yield Notice(f"{column}s {', '.join(texts)} look alike and are kept apart")


def _where(place: Any) -> str:
    return f"{place['file']}:{place['row']}"


def _written(name: str) -> str:
    """Quote a name; letters that look like Latin ones are written by their number."""
    clipped = clip(name)
    return ascii(clipped) if name.translate(_HOMOGLYPHS) != name else repr(clipped)


def _look(name: str) -> str:
    """Reduce a name to its looks: without case, leading zeros, or the script of a letter."""
    plain = unicodedata.normalize("NFKC", fold(name)).translate(_HOMOGLYPHS).casefold()
    try:
        return f"{float(plain):.15g}"
    except ValueError:
        return plain.lstrip("0")


def doubtful_scales(references: pd.DataFrame, quantities: Iterable[Quantity]) -> Iterator[Notice]:
    """Warn of quantities whose unit has no ratios; `references` has a column for each of them."""
    for quantity in quantities:
        values = references[quantity.name].dropna().to_numpy(dtype=float)
        unit = quantity.unit.casefold()
        turn = _TURNS.get(unit)
        if _LOGARITHMIC.fullmatch(unit) and values.any():
            why = "is a logarithm, so that ratios of its values mean nothing."
            errors = "adjusted − reference"
        elif turn and len(values) and max(np.ptp(values), np.abs(values).max()) > turn / 2:
            why = (
                f"goes round: references reach beyond half a turn, {turn / 2:.4g} {quantity.unit}."
            )
            errors = "adjusted − reference, within half a turn"
        else:
            continue
        name = quantity.name
        text = (
            f"{quantity.label} in {quantity.unit} {why} Analyse its errors instead: give {name}_adj"
            f' a column of {errors}, set {name}_ref = 0 in [environments], family = "normal" in'
            f" [inference] and scale = {{ {name} = 1.0 }} in [model]."
        )
        yield Notice(text, column=f"{name}_adj")


def _single_trials(table: pd.DataFrame) -> Iterator[Notice]:
    """Warn of references that differ on every trial."""
    trials = table["environment"].value_counts(sort=False)
    single = int((trials == 1).sum())
    if len(trials) > _MANY and single > len(trials) / 2:
        text = (
            f"{single} of {len(trials)} environments have one trial: the reference seems to differ"
            " on every trial. Name a column of conditions, environment in [columns], and give each"
            " condition one reference in [environments]."
        )
        yield Notice(text, column="environment")


def screen(
    table: pd.DataFrame,
    quantities: Iterable[Quantity],
    place: Places,
    pooled: Iterable[str],
    family: str,
) -> Iterator[Notice]:
    """Warn of what is seldom meant. Nothing is left out: that is for the analyst to declare."""
    yield from _single_trials(table)
    for quantity in quantities:
        yield from _gross_errors(table, quantity.name, place)
        yield from _without_logarithm(table, quantity.name, place, family)
        yield from _at_a_limit(table, quantity.name, place)
        yield from _never_moved(table, quantity.name)
    yield from _empty_cells(table)
    for column in pooled:
        yield from _pooled(table, column)


def _empty_cells(table: pd.DataFrame) -> Iterator[Notice]:
    """Name the subjects that lack an environment."""
    tried = set(table.groupby(["subject", "environment"], sort=False).groups)
    lacking = []
    for subject, environment in product(table["subject"].unique(), table["environment"].unique()):
        if (subject, environment) not in tried:
            lacking.append(f"{subject} at {environment}")
    if lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Notice(f"{counted(len(lacking), 'cell')} {has} no trial: {shown(lacking)}")


def _gross_errors(table: pd.DataFrame, parameter: str, place: Places) -> Iterator[Notice]:
    """Name values many times above or below the median of their environment."""
    column = f"{parameter}_adj"
    positive = table[table[column] > 0]
    by_environment = positive.groupby("environment", sort=False)
    typical = by_environment[column].transform("median")
    enough = by_environment["subject"].transform("nunique") >= _FEWEST
    far = (positive[column] > _GROSS * typical) | (positive[column] < typical / _GROSS)
    gross = positive.assign(median=typical)[enough & far]
    if gross.empty:
        return
    rows = gross[["subject", "environment", column, "median"]].to_numpy()
    named = ["{} at {}: {:.6g}, median {:.6g}".format(*row) for row in rows]
    text = (
        f"{counted(len(gross), 'value')} of {parameter} far from the median of the environment,"
        f" here the first: a slip? Subjects {shown(named)}"
    )
    yield Notice(text, column=column, **place(gross.index[0]))


def _without_logarithm(
    table: pd.DataFrame, parameter: str, place: Places, family: str
) -> Iterator[Notice]:
    """Count zeros and negative values, and say which way out fits them."""
    column = f"{parameter}_adj"
    reference = f"{parameter}_ref"
    known = table[table[column].notna()]
    low = known[known[column] <= 0]
    if low.empty:
        return
    few_zeros = bool((low[column] == 0).all()) and len(low) <= _FEW * len(known)
    no_ratio = bool((low[reference] <= 0).any())
    # The normal family takes zeros and negative values; only a few zeros are doubted there.
    if family != "lognormal" and (no_ratio or not few_zeros):
        return
    if no_ratio:
        way = (
            'References of zero or below have no ratio: set family = "normal" in [inference] and'
            " scale in [model]. If the zero of the scale is arbitrary, add one offset to"
            f" {reference} and {column} in [columns]."
        )
    elif few_zeros:
        least = float(known.loc[known[column] > 0, column].min())
        rule = f'{{ column = "{column}", below = {least!r}, why = "no adjustment" }}'
        way = (
            f"If they are failed trials, [sessions] exclude = [{rule}] leaves them out and logs"
            ' them. If people meant them, set family = "normal" in [inference].'
        )
    else:
        way = 'To leave out this many biases the rest: set family = "normal" in [inference].'
    text = f"{_share(len(low), len(known), parameter)} zero or negative, here the first. {way}"
    yield Notice(text, column=column, **place(low.index[0]))


def _share(count: int, total: int, parameter: str) -> str:
    """Such as "2 values of k (20.0% of 10) are"."""
    verb = "is" if count == 1 else "are"
    return f"{counted(count, 'value')} of {parameter} ({count / total:.1%} of {total:,}) {verb}"


def _at_a_limit(table: pd.DataFrame, parameter: str, place: Places) -> Iterator[Notice]:
    """Warn where many more values equal the largest or least than the one next to it."""
    column = f"{parameter}_adj"
    counts = table[column].value_counts().sort_index()
    if len(counts) < 3:
        return
    total = int(counts.sum())
    for extreme, beside, which, way in ((-1, -2, "largest", "above"), (0, 1, "least", "below")):
        count = int(counts.iloc[extreme])
        value = float(counts.index[extreme])
        many = count >= max(_ENOUGH, _FEW * total, 3 * counts.iloc[beside])
        # Zeros have a warning of their own.
        if not many or value <= 0:
            continue
        limit = float(counts.index[beside])
        rule = f'{{ column = "{column}", {way} = {limit!r}, why = "limit of the control" }}'
        text = (
            f"{_share(count, total, parameter)} the {which} of all, {value:g}: the limit of the"
            f" control? Such a value says only that the adjustment lies {way} it, and makes the"
            f" spread too small. [sessions] exclude = [{rule}] leaves them out and logs them."
        )
        first = table.index[table[column] == value][0]
        yield Notice(text, column=column, **place(first))


def _never_moved(table: pd.DataFrame, parameter: str) -> Iterator[Notice]:
    """Name subjects who have several trials, and left the reference in all of them."""
    column = f"{parameter}_adj"
    known = table[table[column].notna()]
    same = known[column] == known[f"{parameter}_ref"]
    by_subject = same.groupby(known["subject"], sort=False).agg(["all", "size"])
    still = by_subject.index[by_subject["all"] & (by_subject["size"] > 1)]
    if len(still):
        noun = "subject" if len(still) == 1 else "subjects"
        who = f"{noun} {shown([str(name) for name in still])}"
        text = f"{who} left {parameter} at the reference in every trial: was the setting recorded?"
        yield Notice(text, column=column)


def _pooled(table: pd.DataFrame, column: str) -> Iterator[Notice]:
    """Say what becomes of groups that the analysis does not tell apart."""
    levels = table.groupby(column, sort=False)["subject"].nunique()
    if len(levels) < 2:
        return
    sizes = ", ".join(
        f"{shown([str(name)])} {counted(int(n), 'subject')}" for name, n in levels.items()
    )
    text = f"{len(levels)} groups ({sizes}) are pooled: "
    if (table.groupby("subject", sort=False)[column].nunique() > 1).any():
        text += "a subject's trials of every group count as repeats of one another. "
        text += f'[study] factor = "{column}" contrasts them.'
    else:
        text += "every interval is of all groups together. "
        if len(levels) == 2:
            text += f'"percept compare FILE --by {column}" compares them.'
        else:
            two = ", ".join(f'"{name}"' for name in levels.index[:2])
            text += f'"percept compare FILE --by {column}" compares two of them, which [sessions]'
            text += f" only = {{ {column} = [{two}] }} keeps."
    yield Notice(text, column=column)
