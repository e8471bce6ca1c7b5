"""What is seldom meant in a study that can be read: warnings, mistyped adjustments among them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import counted
from percept.sessions.merged import by_environment
from percept.sessions.options import ReadOptions
from percept.sessions.quantities import Quantity
from percept.sessions.records import MOST_CONDITIONS, Factors, Found, shown

#: Numbers that stand for a missing value: -999, 9999 and others of nines, in any unit.
_CODE = re.compile(r"99+0*")
#: Equal settings, and different ones among them, from which on two subjects are hardly two people.
_EQUAL = 4
_DIFFERENT = 3
#: Values below this share of all are few.
_FEW = 0.05
#: Values that are named as mistyped; where more are, they have another reason.
_MOST_SLIPS = 20
#: Names of logarithmic units.
_LOGARITHMIC = re.compile(r"db.*|bels?|np|phons?|cents?|semitones?|octaves?|decades?|ph")
#: Equal values at one end that chance hardly gives, where adjustments are read to several digits.
_ENOUGH = 4


#: Decades from the median of the others (a factor of 30) that are hardly ever a person's.
_GROSS = float(np.log10(30.0))
#: Subjects an environment needs for its median to say anything of one of them.
_FEWEST = 3
#: Decades by which a digit too many or too few may miss ten: within a factor of two.
_NEAR_TEN = float(np.log10(2.0))
#: Decades from the median of all trials at which a value is looked at: of two trials the median
#: lies half-way.
_LOOKED_AT = 0.5 * (1.0 - _NEAR_TEN)
#: An environment with more of such values has wide scatter, and no slips.
_MOST_LOOKED_AT = 1_000
#: SDs of the other trials beyond which a value is no ordinary one: one in 16,000 of normal ones.
_FAR = 4.0
#: SD in decades that subjects usually have: a factor of 1.4.
_USUAL_SD = 0.15
#: SDs between the quartiles of normal values.
_QUARTILES = 1.349
#: Degrees of freedom that the scatter elsewhere counts for beside that of the environment itself.
_ELSEWHERE = 3.0


@dataclass(frozen=True)
class Trials:
    """The trials of a study, and how they were read."""

    table: pd.DataFrame
    quantities: Sequence[Quantity]
    options: ReadOptions
    factors: Factors | None


def doubts(trials: Trials) -> Iterator[Found]:
    """Find what is seldom meant. Nothing is left out: that is for the analyst to declare."""
    for quantity in trials.quantities:
        for check_one in _CHECKS_OF_A_QUANTITY:
            yield from check_one(trials, quantity.name)
    for check in _CHECKS:
        yield from check(trials)


def logarithms(references: pd.DataFrame, quantities: Sequence[Quantity]) -> Iterator[Found]:
    """Warn of quantities whose unit has no ratios; `references` has a column for each of them."""
    for quantity in quantities:
        name = quantity.name
        if _LOGARITHMIC.fullmatch(quantity.unit.casefold()) and references[name].fillna(0).any():
            text = (
                f"{quantity.label} in {quantity.unit} is a logarithm, so that ratios of its values"
                f" mean nothing. Analyse its errors instead: give {name}_adj a column of adjusted −"
                f' reference, set {name}_ref = 0 in [environments], family = "normal" in'
                f" [inference] and scale = {{ {name} = 1.0 }} in [model]."
            )
            yield Found(text, f"{name}_adj")


def _slips(trials: Trials) -> Iterator[Found]:
    """Name values that look mistyped."""
    found = list(slips(trials.table, trials.quantities))
    for slip in found[:_MOST_SLIPS]:
        yield Found(f"{slip.text}: mistyped?", f"{slip.parameter}_adj", slip.index)
    if len(found) > _MOST_SLIPS:
        yield Found(f"{counted(len(found) - _MOST_SLIPS, 'more value')} may be mistyped")


def _copies(trials: Trials) -> Iterator[Found]:
    """Name subjects whose settings are those of another subject, value by value."""
    columns = [f"{quantity.name}_adj" for quantity in trials.quantities]
    ordered = trials.table.sort_values(["environment", "session", "trial"], kind="stable")
    first_of: dict[tuple[object, ...], str] = {}
    for subject, rows in ordered.groupby("subject", sort=False):
        settings = rows[columns].to_numpy(dtype=float)
        known = settings[~np.isnan(settings)]
        if len(known) < _EQUAL or len(np.unique(known)) < _DIFFERENT:
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


def _single_trials(trials: Trials) -> Iterator[Found]:
    """Warn of references that differ on every trial."""
    counts = trials.table["environment"].value_counts(sort=False)
    single = int((counts == 1).sum())
    if len(counts) > MOST_CONDITIONS and single > len(counts) / 2:
        text = (
            f"{single} of {len(counts)} environments have one trial: the reference seems to differ"
            " on every trial. Name a column of conditions, environment in [columns], and give each"
            " condition one reference in [environments]."
        )
        yield Found(text, "environment")


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


def _codes(trials: Trials, parameter: str) -> Iterator[Found]:
    """Ask whether a number is a code for a missing value."""
    column = f"{parameter}_adj"
    values = trials.table[column].dropna()
    for code in _missing_codes(values):
        rows = values.index[values == code]
        limit = f"below = {code + 0.5!r}" if code < 0 else f"above = {code - 0.5!r}"
        verb = "is" if len(rows) == 1 else "are"
        text = (
            f"{counted(len(rows), 'value')} of {parameter} {verb} {code:g}: a code for a"
            " missing value? Then [sessions] exclude ="
            f' [{{ column = "{column}", {limit}, why = "missing" }}] leaves such rows out.'
        )
        yield Found(text, column, rows[0])


def _without_logarithm(trials: Trials, parameter: str) -> Iterator[Found]:
    """Count zeros and negative values, and say which way out fits them."""
    column = f"{parameter}_adj"
    reference = f"{parameter}_ref"
    known = trials.table.dropna(subset=column)
    values = known[column]
    low = known[values <= 0]
    if low.empty or set(low[column]) <= set(_missing_codes(values)):
        return
    few = len(low) <= _FEW * len(known)
    few_zeros = few and bool((low[column] == 0).all())
    no_ratio = bool((low[reference] <= 0).any())
    # The normal family takes zeros and negative values; only a few zeros are doubted there.
    if trials.options.family != "lognormal" and (no_ratio or not few_zeros):
        return
    way = 'To leave out this many biases the rest: set family = "normal" in [inference].'
    if no_ratio:
        way = (
            'References of zero or below have no ratio: set family = "normal" in [inference] and'
            " scale in [model]."
        )
    elif few:
        least = float(values[values > 0].min())
        why = "no adjustment" if few_zeros else "slip of sign"
        way = (
            "If nobody meant that, [sessions] exclude ="
            f' [{{ column = "{column}", below = {least!r}, why = "{why}" }}] leaves such trials out'
            " and logs them."
        )
        if few_zeros:
            way += (
                " If zero is an end of the control, limits = [0.0, inf] below"
                f" [quantities.{parameter}] leaves them out and counts them."
            )
        way += ' If people meant it, set family = "normal" in [inference].'
    text = f"{_share(len(low), len(known), parameter)} zero or negative, here the first. {way}"
    if not no_ratio:
        text += f" There are {by_environment(known, values <= 0)}."
    yield Found(text, column, low.index[0])


def _share(count: int, total: int, parameter: str) -> str:
    """Such as "2 values of k (20.0% of 10) are"."""
    verb = "is" if count == 1 else "are"
    return f"{counted(count, 'value')} of {parameter} ({count / total:.1%} of {total:,}) {verb}"


def _at_a_limit(trials: Trials, parameter: str) -> Iterator[Found]:
    """Warn where many more values equal the largest or least than the one next to it."""
    column = f"{parameter}_adj"
    values = trials.table[column]
    counts = values.value_counts().sort_index()
    if len(counts) < 3:
        return
    for extreme, beside, which, way in ((-1, -2, "largest", "above"), (0, 1, "least", "below")):
        count = int(counts.iloc[extreme])
        value = float(counts.index[extreme])
        many = count >= max(_ENOUGH, _FEW * counts.sum(), 3 * counts.iloc[beside])
        # Zeros have a warning of their own.
        if not many or value <= 0:
            continue
        limits = f"[-inf, {value:g}]" if way == "above" else f"[{value:g}, inf]"
        at_limit = values == value
        text = (
            f"{_share(count, counts.sum(), parameter)} the {which} of all, {value:g}: the limit of"
            f" the control? There are {by_environment(trials.table, at_limit)}. Such a value"
            f" says only that the adjustment lies {way} it, and makes the spread too small."
            f" [quantities.{parameter}] limits = {limits} leaves them out, counts them and logs"
            " them."
        )
        yield Found(text, column, at_limit.idxmax())


def empty_cells(table: pd.DataFrame, factors: Factors | None) -> Iterator[tuple[str, str]]:
    """Yield the subjects and environments without a trial; subjects of other groups do not count.

    Parameters
    ----------
    table : DataFrame
        Trials, with the columns of the factors.
    factors : Factors or None
        Columns whose levels tell environments apart.

    Yields
    ------
    tuple of str
        Subject and environment.
    """
    by_subject = table.groupby("subject", sort=False)
    columns = factors.levels if factors else ()
    groups = [name for name in columns if (by_subject[name].nunique() == 1).all()]
    # Each subject and each environment with its own levels of the groups.
    subjects, environments = (
        table.drop_duplicates(name)[[name, *groups]].astype(str).itertuples(index=False, name=None)
        for name in ("subject", "environment")
    )
    tried = set(by_subject["environment"].unique().explode().items())
    for (subject, *groups_met), (name, *groups_of) in product(subjects, environments):
        if groups_met == groups_of and (subject, name) not in tried:
            yield subject, name


def _empty_cells(trials: Trials) -> Iterator[Found]:
    """Name the subjects that lack an environment."""
    cells = empty_cells(trials.table, trials.factors)
    lacking = [f"{subject} at {name}" for subject, name in cells]
    of_subjects = trials.table.groupby("subject", sort=False)["environment"].nunique()
    if lacking and len(of_subjects) > 1 and (of_subjects == 1).all():
        yield Found("each subject met one environment: environments are groups of subjects")
    elif lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Found(f"{counted(len(lacking), 'cell')} {has} no trial: {shown(lacking)}")


def _pooled(trials: Trials) -> Iterator[Found]:
    """Say how groups that the analysis does not tell apart are analysed."""
    for column in trials.options.pooled(trials.table.columns):
        levels = trials.table.groupby(column, sort=False)["subject"].nunique()
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


@dataclass(frozen=True)
class Slip:
    """One adjustment that may be mistyped, and the other trials of its environment."""

    index: int  # Label of its row in the table of trials
    environment: str
    parameter: str
    text: str  # The value, and what lets one doubt it


def slips(table: pd.DataFrame, quantities: Iterable[Quantity]) -> Iterator[Slip]:
    """Find adjustments that look mistyped, by quantity and in the order of the rows.

    Parameters
    ----------
    table : DataFrame
        Trials as `Sessions.table` has them.
    quantities : iterable of Quantity
        What was adjusted.

    Yields
    ------
    Slip
        A value about ten times, or a tenth of, what the others and the same subject's other trials
        lead one to expect; or thirty times off the median of the others, either way.
    """
    for quantity in quantities:
        name = quantity.name
        trials = table[table[f"{name}_adj"] > 0]
        reference = trials[f"{name}_ref"]
        shown_at = np.log10(reference.where(reference > 0))
        values = trials[f"{name}_adj"]
        found = dict(_mistyped(trials, np.log10(values), shown_at))
        for index in sorted(found):
            environment = trials["environment"][index]
            text = (
                f"{name} = {values[index]:.6g} of subject {shown([trials['subject'][index]])},"
                f" where the other trials of {shown([environment])} have a median of"
                f" {values[found[index]].median():.6g}"
            )
            yield Slip(index, environment, name, text)


def _mistyped(
    trials: pd.DataFrame, decades: pd.Series[float], shown_at: pd.Series[float]
) -> Iterator[tuple[Any, pd.Index]]:
    """Find rows that a digit explains, or nothing does; with the rows beside each."""
    grouped = decades.groupby(trials["environment"], sort=False)
    off = decades - grouped.transform("median")
    sds = (grouped.quantile(0.75) - grouped.quantile(0.25)) / _QUARTILES
    environment: Any
    for environment, here in grouped:
        candidates = here[off[here.index].abs() > _LOOKED_AT]
        if len(here) < 2 or len(candidates) > _MOST_LOOKED_AT:
            continue
        elsewhere = sds.drop(environment).median() if len(sds) > 1 else _USUAL_SD
        subjects = trials["subject"][here.index].nunique()
        index: Any
        for index, value in candidates.items():
            others = here.drop(index)
            low, median, high = np.quantile(others, (0.25, 0.5, 0.75))
            distance = abs(value - median)
            is_gross = distance > _GROSS and subjects >= _FEWEST
            if not (is_gross or abs(distance - 1.0) <= _NEAR_TEN):
                continue
            # Of two trials either may be the slip: it is the one farther from what was shown.
            reference = shown_at[index]
            if len(others) == 1 and not abs(value - reference) > abs(median - reference):
                continue
            freedom = len(others) - 1
            own_sd = (high - low) / _QUARTILES
            variance = _ELSEWHERE * elsewhere**2 + freedom * own_sd**2
            variance /= _ELSEWHERE + freedom
            if distance <= _FAR * np.sqrt(variance * (1.0 + 1.0 / len(others))):
                continue
            # A subject who is as far off in other trials has a habit, or another unit.
            of_subject = off[trials["subject"] == trials["subject"][index]].drop(index)
            if not abs(value - median - of_subject.median()) < 1.0 - _NEAR_TEN:
                yield index, others.index


_CHECKS: tuple[Callable[[Trials], Iterator[Found]], ...] = (
    _slips,
    _copies,
    _single_trials,
    _empty_cells,
    _pooled,
)
_CHECKS_OF_A_QUANTITY: tuple[Callable[[Trials, str], Iterator[Found]], ...] = (
    _codes,
    _without_logarithm,
    _at_a_limit,
)
