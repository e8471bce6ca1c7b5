"""What is seldom meant in a study that can be read: warnings, mistyped adjustments among them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import counted
from percept.sessions.merged import by_environment
from percept.sessions.options import DataTables
from percept.sessions.quantities import Quantity
from percept.sessions.records import Factors, Found, shown

#: Numbers that stand for a missing value: -999, 9999 and others of nines, in any unit.
_CODE = re.compile(r"99+0*")
#: Half a turn in units of angles, and names of logarithmic units.
_HALF_TURNS = dict.fromkeys(("deg", "°", "degree", "degrees"), 180.0)
_HALF_TURNS |= dict.fromkeys(("rad", "radian", "radians"), math.pi)
_LOGARITHMIC = re.compile(r"db.*|bels?|np|phons?|cents?|semitones?|octaves?|decades?|ph")
#: Different settings from which on two subjects who share them are hardly two people.
_DIFFERENT = 4

#: Decades, a factor of five, that a digit too many or too few makes at least.
_SLIP = math.log10(5.0)
#: Values that are looked at in an environment; where more are far off, they have another reason.
_MOST_SLIPS = 20
#: SDs of the other trials beyond which a value is no ordinary one: one in 16,000 of normal ones.
_FAR = 4.0
#: SD in decades, a factor of 1.4, that trials are given at least.
_LEAST_SD = 0.15
#: SDs between the quartiles of normal values.
_QUARTILES = 1.349


def doubts(
    table: pd.DataFrame, adjusted: Sequence[Quantity], options: DataTables, factors: Factors | None
) -> Iterator[Found]:
    """Find what is seldom meant in trials of quantities, as they were read.

    Nothing is left out: that is for the analyst to declare.
    """
    for quantity in adjusted:
        yield from _codes(table, quantity)
        yield from _without_ratios(table, quantity)
        if options.family == "lognormal":
            yield from _without_logarithm(table, quantity)
    yield from slips(table, adjusted)
    yield from _copies(table, adjusted)
    yield from _empty_cells(table, factors)
    yield from _pooled(table, options)


def _copies(table: pd.DataFrame, adjusted: Sequence[Quantity]) -> Iterator[Found]:
    """Name subjects whose settings are those of another subject, value by value."""
    columns = [f"{quantity.name}_adj" for quantity in adjusted]
    ordered = table.sort_values(["environment", "session", "trial"], kind="stable")
    first_of: dict[tuple[object, ...], str] = {}
    for subject, rows in ordered.groupby("subject", sort=False):
        settings = rows[columns].to_numpy(dtype=float)
        known = settings[~np.isnan(settings)]
        if len(np.unique(known)) < _DIFFERENT:
            continue
        first = first_of.setdefault((*rows["environment"], settings.tobytes()), str(subject))
        if first == subject:
            continue
        name = json.dumps(str(subject), ensure_ascii=False)
        text = (
            f"subjects {shown([first])} and {shown([str(subject)])} have the same {len(known)}"
            " settings: a copy? Then [sessions] exclude ="
            f' [{{ column = "subject", equals = {name}, why = "a copy" }}] leaves it out.'
        )
        yield Found(text, "subject", rows.index.min())


def _missing_codes(values: pd.Series[float]) -> list[float]:
    """Give the numbers, at either end of all values, that seem to stand for a missing one."""
    codes = []
    for code in (values.min(), values.max()):
        others = values[values != code]
        if others.empty or not _CODE.fullmatch(f"{abs(code):.12g}"):
            continue
        reach = others.max() - others.min()
        alone_below = code < 0 <= others.min()
        if alone_below or not others.min() - reach <= code <= others.max() + reach:
            codes.append(float(code))
    return codes


def _codes(table: pd.DataFrame, quantity: Quantity) -> Iterator[Found]:
    """Ask whether a number is a code for a missing value."""
    column = f"{quantity.name}_adj"
    values = table[column].dropna()
    for code in _missing_codes(values):
        rows = values.index[values == code]
        limit = f"below = {code + 0.5!r}" if code < 0 else f"above = {code - 0.5!r}"
        verb = "is" if len(rows) == 1 else "are"
        text = (
            f"{counted(len(rows), 'value')} of {quantity.name} {verb} {code:g}: a code for a"
            " missing value? Then [sessions] exclude ="
            f' [{{ column = "{column}", {limit}, why = "missing" }}] leaves such rows out.'
        )
        yield Found(text, column, rows[0])


def _without_logarithm(table: pd.DataFrame, quantity: Quantity) -> Iterator[Found]:
    """Count the zeros and negative values of a lognormal family, and say both ways out."""
    column = f"{quantity.name}_adj"
    known = table.dropna(subset=column)
    values = known[column]
    is_low = values <= 0
    if set(values[is_low]) <= set(_missing_codes(values)):
        return
    count = int(is_low.sum())
    text = (
        f"{counted(count, 'value')} of {quantity.name} ({count / len(known):.1%} of"
        f" {len(known):,}) {'is' if count == 1 else 'are'} zero or negative, here the first:"
        f" {by_environment(known, is_low)}. If people meant it, set family ="
        ' "normal" in [inference], and scale in [model] for references of zero or below.'
    )
    if not is_low.all():
        least = float(values[~is_low].min())
        text += (
            " If nobody meant it, [sessions] exclude ="
            f' [{{ column = "{column}", below = {least!r}, why = "not meant" }}] leaves such'
            " trials out and logs them. To leave out many biases the rest."
        )
    yield Found(text, column, is_low.idxmax())


def empty_cells(table: pd.DataFrame, factors: Factors | None) -> pd.DataFrame:
    """Find the subjects and environments without a trial; subjects of other groups do not count.

    Parameters
    ----------
    table : DataFrame
        Trials, with the columns of the factors.
    factors : Factors or None
        Columns whose levels tell environments apart.

    Returns
    -------
    DataFrame
        A row for each: `subject` and `environment`.
    """
    levels = table.groupby("subject", sort=False)[list(factors.levels if factors else ())].nunique()
    groups = [name for name in levels if (levels[name] == 1).all()]
    subjects = table[["subject", *groups]].drop_duplicates()
    environments = table[["environment", *groups]].drop_duplicates()
    cells = subjects.merge(environments, "inner" if groups else "cross", groups or None)
    cells = cells[["subject", "environment"]]
    tried = pd.MultiIndex.from_frame(table[["subject", "environment"]])
    return cells[~pd.MultiIndex.from_frame(cells).isin(tried)]


def _empty_cells(table: pd.DataFrame, factors: Factors | None) -> Iterator[Found]:
    """Name the subjects that lack an environment."""
    cells = empty_cells(table, factors)
    lacking = (cells["subject"] + " at " + cells["environment"]).tolist()
    of_subjects = table.groupby("subject", sort=False)["environment"].nunique()
    if lacking and len(of_subjects) > 1 and (of_subjects == 1).all():
        yield Found("each subject met one environment: environments are groups of subjects")
    elif lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Found(f"{counted(len(lacking), 'cell')} {has} no trial: {shown(lacking)}")


def _pooled(table: pd.DataFrame, options: DataTables) -> Iterator[Found]:
    """Say how groups that the analysis does not tell apart are analysed."""
    kept = {"group", *options.sessions.groups} - {*options.split}
    for column in table.columns.intersection(list(kept)):
        levels = table.groupby(column, sort=False)["subject"].nunique()
        if len(levels) < 2:
            continue
        sizes = ", ".join(
            f"{shown([str(name)])} {counted(int(n), 'subject')}" for name, n in levels.items()
        )
        text = (
            f"{len(levels)} groups ({sizes}) are pooled: every interval is of all groups together."
            f' [study] factor = "{column}" contrasts them; "percept compare FILE --by {column}"'
            " compares two groups of different subjects."
        )
        yield Found(text, column)


def _without_ratios(table: pd.DataFrame, quantity: Quantity) -> Iterator[Found]:
    """Warn of logarithms, and of angles that wrap: 350 and 10 deg lie beside each other."""
    column = f"{quantity.name}_adj"
    reference = f"{quantity.name}_ref"
    unit = quantity.unit.casefold()
    largest = table[[reference, column]].abs().max().max()
    wraps = largest > _HALF_TURNS.get(unit, math.inf)
    is_logarithm = _LOGARITHMIC.fullmatch(unit) and table[reference].any()
    if wraps or is_logarithm:
        why = "reaches beyond half a turn and wraps" if wraps else "is a logarithm"
        text = (
            f"{quantity.label} in {quantity.unit} {why}, so that ratios of its values mean"
            f" nothing. Analyse its errors: give {column} a column of adjusted − reference, set"
            f' {reference} = 0 in [environments], family = "normal" in [inference] and'
            f" scale = {{ {quantity.name} = 1.0 }} in [model]."
        )
        yield Found(text, column)


def slips(table: pd.DataFrame, adjusted: Sequence[Quantity]) -> Iterator[Found]:
    """Name adjustments that look mistyped, by quantity and in the order of the rows.

    Parameters
    ----------
    table : DataFrame
        Trials.
    adjusted : sequence of Quantity
        What they adjusted.

    Yields
    ------
    Found
        A value five times, or a fifth of, what the others and the same subject's other trials lead
        one to expect.
    """
    for quantity in adjusted:
        column = f"{quantity.name}_adj"
        trials = table[table[column] > 0]
        reference = trials[f"{quantity.name}_ref"]
        shown_at = np.log10(reference.where(reference > 0))
        found = dict(_mistyped(trials, np.log10(trials[column]), shown_at))
        for index in sorted(found):
            text = (
                f"{quantity.name} = {trials[column][index]:.6g} of subject"
                f" {shown([trials['subject'][index]])}, where the other trials of"
                f" {shown([trials['environment'][index]])} have a median of"
                f" {trials[column][found[index]].median():.6g}: mistyped?"
            )
            yield Found(text, column, index)


def _mistyped(
    trials: pd.DataFrame, decades: pd.Series[float], shown_at: pd.Series[float]
) -> Iterator[tuple[Any, pd.Index]]:
    """Find rows far off in their environment, with the other rows there."""
    grouped = decades.groupby(trials["environment"], sort=False)
    off = decades - grouped.transform("median")
    for _, here in grouped:
        # Of two trials the median lies half-way.
        far = off[here.index].abs().nlargest(_MOST_SLIPS)
        for index in far.index[far > _SLIP / 2]:
            value = here[index]
            others = here.drop(index)
            low, median, high = np.quantile(others, (0.25, 0.5, 0.75))
            # Of two trials either may be the slip: it is the one farther from what was shown.
            reference = shown_at[index]
            if len(others) == 1 and not abs(value - reference) > abs(median - reference):
                continue
            sd = max(_LEAST_SD, (high - low) / _QUARTILES)
            ordinary = _FAR * sd * np.sqrt(1.0 + 1.0 / len(others))
            if abs(value - median) <= max(_SLIP, ordinary):
                continue
            # A subject who is as far off in other trials has a habit, or another unit.
            of_subject = off[trials["subject"] == trials["subject"][index]].drop(index)
            if not abs(value - median - of_subject.median()) < _SLIP:
                yield index, others.index
