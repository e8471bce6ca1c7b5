"""What is seldom meant in a study that can be read: warnings, mistyped adjustments among them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
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
#: SD in decades that subjects usually have, a factor of 1.4, and the degrees of freedom that it
#: counts for beside the other trials.
_USUAL_SD = 0.15
_USUAL_FREEDOM = 3.0
#: SDs between the quartiles of normal values.
_QUARTILES = 1.349


@dataclass(frozen=True)
class Observed:
    """What the checks look at: observations, and how they were read."""

    table: pd.DataFrame
    references: pd.DataFrame  # By environment, with a column for each quantity
    adjusted: Sequence[Quantity]
    options: ReadOptions
    factors: Factors | None


def doubts(study: Observed, *, are_trials: bool) -> Iterator[Found]:
    """Find what is seldom meant. Nothing is left out: that is for the analyst to declare."""
    for check in _CHECKS if are_trials else (_logarithms,):
        yield from check(study)


def _logarithms(study: Observed) -> Iterator[Found]:
    """Warn of quantities whose unit has no ratios."""
    for quantity in study.adjusted:
        name = quantity.name
        references = study.references[name].fillna(0)
        if _LOGARITHMIC.fullmatch(quantity.unit.casefold()) and references.any():
            text = (
                f"{quantity.label} in {quantity.unit} is a logarithm, so that ratios of its values"
                f" mean nothing. Analyse its errors instead: give {name}_adj a column of adjusted −"
                f' reference, set {name}_ref = 0 in [environments], family = "normal" in'
                f" [inference] and scale = {{ {name} = 1.0 }} in [model]."
            )
            yield Found(text, f"{name}_adj")


def _first_slips(study: Observed) -> Iterator[Found]:
    """Name the values that look mistyped; of many the first."""
    found = list(slips(study))
    yield from found[:_MOST_SLIPS]
    if len(found) > _MOST_SLIPS:
        more = counted(len(found) - _MOST_SLIPS, "more value")
        yield Found(f"{more} may be mistyped")


def _copies(study: Observed) -> Iterator[Found]:
    """Name subjects whose settings are those of another subject, value by value."""
    columns = [f"{quantity.name}_adj" for quantity in study.adjusted]
    ordered = study.table.sort_values(["environment", "session", "trial"], kind="stable")
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


def _single_trials(study: Observed) -> Iterator[Found]:
    """Warn of references that differ on every trial."""
    counts = study.table["environment"].value_counts(sort=False)
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


def _codes(study: Observed) -> Iterator[Found]:
    """Ask whether a number is a code for a missing value."""
    for quantity in study.adjusted:
        column = f"{quantity.name}_adj"
        values = study.table[column].dropna()
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


def _without_logarithm(study: Observed) -> Iterator[Found]:
    """Count the zeros and negative values of a lognormal family, and say both ways out."""
    for quantity in study.adjusted if study.options.family == "lognormal" else ():
        column = f"{quantity.name}_adj"
        known = study.table.dropna(subset=column)
        values = known[column]
        is_low = values <= 0
        if set(values[is_low]) <= set(_missing_codes(values)):
            continue
        text = f"{_share(int(is_low.sum()), len(known), quantity.name)} zero or negative, here the"
        text += f" first: {by_environment(known, is_low)}. If people meant it, set family ="
        text += ' "normal" in [inference], and scale in [model] for references of zero or below.'
        if not is_low.all():
            least = float(values[~is_low].min())
            text += (
                " If nobody meant it, [sessions] exclude ="
                f' [{{ column = "{column}", below = {least!r}, why = "not meant" }}] leaves such'
                " trials out and logs them. To leave out many biases the rest."
            )
        yield Found(text, column, is_low.idxmax())


def _share(count: int, total: int, parameter: str) -> str:
    """Such as "2 values of k (20.0% of 10) are"."""
    verb = "is" if count == 1 else "are"
    return f"{counted(count, 'value')} of {parameter} ({count / total:.1%} of {total:,}) {verb}"


def _at_a_limit(study: Observed) -> Iterator[Found]:
    """Warn where many more values equal the largest or least than the one next to it."""
    for quantity, (extreme, beside, which) in product(
        study.adjusted, ((-1, -2, "largest"), (0, 1, "least"))
    ):
        column = f"{quantity.name}_adj"
        values = study.table[column]
        counts = values.value_counts().sort_index()
        # Zeros have a warning of their own.
        if len(counts) < 3 or counts.index[extreme] <= 0:
            continue
        count = int(counts.iloc[extreme])
        value = float(counts.index[extreme])
        if count < max(_ENOUGH, _FEW * counts.sum(), 3 * counts.iloc[beside]):
            continue
        limits = f"[-inf, {value:g}]" if which == "largest" else f"[{value:g}, inf]"
        at_limit = values == value
        text = (
            f"{_share(count, counts.sum(), quantity.name)} the {which} of all, {value:g}: the limit"
            f" of the control? There are {by_environment(study.table, at_limit)}. Such a value"
            " says only that the adjustment lies beyond it, and makes the spread too small."
            f" [quantities.{quantity.name}] limits = {limits} leaves them out, counts them and logs"
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


def _empty_cells(study: Observed) -> Iterator[Found]:
    """Name the subjects that lack an environment."""
    cells = empty_cells(study.table, study.factors)
    lacking = [f"{subject} at {name}" for subject, name in cells]
    of_subjects = study.table.groupby("subject", sort=False)["environment"].nunique()
    if lacking and len(of_subjects) > 1 and (of_subjects == 1).all():
        yield Found("each subject met one environment: environments are groups of subjects")
    elif lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Found(f"{counted(len(lacking), 'cell')} {has} no trial: {shown(lacking)}")


def _pooled(study: Observed) -> Iterator[Found]:
    """Say how groups that the analysis does not tell apart are analysed."""
    for column in study.options.pooled(study.table.columns):
        levels = study.table.groupby(column, sort=False)["subject"].nunique()
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


def slips(study: Observed) -> Iterator[Found]:
    """Name adjustments that look mistyped, by quantity and in the order of the rows.

    Parameters
    ----------
    study : Observed
        Trials.

    Yields
    ------
    Found
        A value about ten times, or a tenth of, what the others and the same subject's other trials
        lead one to expect; or thirty times off the median of the others, either way.
    """
    for quantity in study.adjusted:
        column = f"{quantity.name}_adj"
        trials = study.table[study.table[column] > 0]
        reference = trials[f"{quantity.name}_ref"]
        shown_at = np.log10(reference.where(reference > 0))
        values = trials[column]
        found = dict(_mistyped(trials, np.log10(values), shown_at))
        for index in sorted(found):
            text = (
                f"{quantity.name} = {values[index]:.6g} of subject"
                f" {shown([trials['subject'][index]])}, where the other trials of"
                f" {shown([trials['environment'][index]])} have a median of"
                f" {values[found[index]].median():.6g}: mistyped?"
            )
            yield Found(text, column, index)


def _mistyped(
    trials: pd.DataFrame, decades: pd.Series[float], shown_at: pd.Series[float]
) -> Iterator[tuple[Any, pd.Index]]:
    """Find rows that a digit explains, or nothing does; with the rows beside each."""
    grouped = decades.groupby(trials["environment"], sort=False)
    off = decades - grouped.transform("median")
    for _, here in grouped:
        candidates = here[off[here.index].abs() > _LOOKED_AT]
        if len(here) < 2 or len(candidates) > _MOST_LOOKED_AT:
            continue
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
            squares = _USUAL_FREEDOM * _USUAL_SD**2 + freedom * ((high - low) / _QUARTILES) ** 2
            variance = squares / (_USUAL_FREEDOM + freedom)
            if distance <= _FAR * np.sqrt(variance * (1.0 + 1.0 / len(others))):
                continue
            # A subject who is as far off in other trials has a habit, or another unit.
            of_subject = off[trials["subject"] == trials["subject"][index]].drop(index)
            if not abs(value - median - of_subject.median()) < 1.0 - _NEAR_TEN:
                yield index, others.index


_CHECKS: tuple[Callable[[Observed], Iterator[Found]], ...] = (
    _logarithms,
    _codes,
    _without_logarithm,
    _at_a_limit,
    _first_slips,
    _copies,
    _single_trials,
    _empty_cells,
    _pooled,
)
