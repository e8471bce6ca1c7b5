"""What is seldom meant in a study that can be read: warnings to look at before believing it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import counted
from percept.sessions.ends import by_environment
from percept.sessions.faults import faults, missing_codes
from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, Factors, Notice, Places, clip, shown
from percept.sessions.values import fold, is_missing

__all__ = ["Slip", "doubtful_ids", "doubtful_scales", "empty_cells", "screen", "slips"]

#: Decades from the median of the others (a factor of 30) that are hardly ever a person's.
_GROSS = float(np.log10(30.0))
#: Subjects an environment needs for its median to say anything of one of them.
_FEWEST = 3
#: Decades by which a digit too many or too few may miss ten: within a factor of two.
_NEAR_TEN = float(np.log10(2.0))
#: Decades from the median of all trials at which a value is looked at: of two trials the median
#: lies half-way.
_LOOKED_AT = 0.5 * (1.0 - _NEAR_TEN)
#: SDs of the other trials beyond which a value is no ordinary one: one in 16,000 of normal ones.
_FAR = 4.0
#: SD in decades that subjects usually have: a factor of 1.4.
_USUAL_SD = 0.15
#: SDs between the quartiles of normal values.
_QUARTILES = 1.349
#: Degrees of freedom that the scatter elsewhere counts for beside that of the environment itself.
_ELSEWHERE = 3.0
#: Values below this share of all are few.
_FEW = 0.05
#: Environments that a study hardly has on purpose.
_MANY = 12
#: Values that are named as mistyped; where more are, they have another reason.
_MOST_SLIPS = 20
#: Names of logarithmic units.
_LOGARITHMIC = re.compile(r"db.*|bels?|np|phons?|cents?|semitones?|octaves?|decades?|ph")
#: Equal values at one end that chance hardly gives, where adjustments are read to several digits.
_ENOUGH = 4
#: Cyrillic and Greek letters, and the Latin ones that look the same.
_HOMOGLYPHS = str.maketrans(
    "АВЕКМНОРСТХаеорсухіѕјԁһ" + "ΑΒΕΖΗΙΚΜΝΟΡΤΥΧονκρ",
    "ABEKMHOPCTXaeopcyxisjdh" + "ABEZHIKMNOPTYXovkp",
)

_Sorted = npt.NDArray[np.float64]


def doubtful_ids(table: pd.DataFrame, place: Places) -> Iterator[Notice]:
    """Notice ids that look alike or like a missing value, with the first row of each."""
    for column in IDS:
        firsts = table[column].drop_duplicates()
        names = firsts.tolist()
        rows = [_where(place(int(position))) for position in firsts.index]
        written = [f"{_written(name)} ({row})" for name, row in zip(names, rows, strict=True)]
        by_look: dict[str, list[str]] = {}
        for name, text in zip(names, written, strict=True):
            by_look.setdefault(_look(name), []).append(text)
            if is_missing(name):
                yield Notice(f"{column} {text} is taken as a name: is it a missing value?")
        for texts in by_look.values():
            if len(texts) > 1:
                text = f"{column}s {', '.join(texts)} look alike and are kept apart"
                yield Notice(f"{text}: if they are one, write them alike in the files")


def _where(place: Any) -> str:
    return f"{place['file']}:{place['row']}"


def _written(name: str) -> str:
    """Quote a name; letters that look like Latin ones are written by their number."""
    clipped = clip(name)
    return ascii(clipped) if name.translate(_HOMOGLYPHS) != name else repr(clipped)


def _look(name: str) -> str:
    """Reduce a name to its looks: "P_01" and "p1" are alike, and so are letters of two scripts."""
    plain = unicodedata.normalize("NFKC", fold(name)).translate(_HOMOGLYPHS).casefold()
    try:
        return f"{float(plain):.15g}"
    except ValueError:
        joined = re.sub(r"(?<=[^\W\d_])[\s_.-]+(?=\d)", "", plain)
        return re.sub(r"(?<!\d)0+(?=\d)", "", joined)


def doubtful_scales(references: pd.DataFrame, quantities: Iterable[Quantity]) -> Iterator[Notice]:
    """Warn of quantities whose unit has no ratios; `references` has a column for each of them."""
    for quantity in quantities:
        values = references[quantity.name].dropna().to_numpy(dtype=float)
        if not (_LOGARITHMIC.fullmatch(quantity.unit.casefold()) and values.any()):
            continue
        name = quantity.name
        text = (
            f"{quantity.label} in {quantity.unit} is a logarithm, so that ratios of its values mean"
            f" nothing. Analyse its errors instead: give {name}_adj a column of adjusted −"
            f' reference, set {name}_ref = 0 in [environments], family = "normal" in [inference]'
            f" and scale = {{ {name} = 1.0 }} in [model]."
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
    quantities: Sequence[Quantity],
    place: Places,
    pooled: Iterable[str],
    family: str,
    factors: Factors | None,
    *,
    left_out: bool = False,
) -> Iterator[Notice]:
    """Warn of what is seldom meant. Nothing is left out: that is for the analyst to declare.

    `left_out` says that the analyst declared limits, and that some cells may have lost all trials.
    """
    found = list(slips(table, quantities))
    for slip in found[:_MOST_SLIPS]:
        yield Notice(f"{slip.text}: mistyped?", column=f"{slip.parameter}_adj", **place(slip.index))
    if len(found) > _MOST_SLIPS:
        yield Notice(f"{counted(len(found) - _MOST_SLIPS, 'more value')} may be mistyped")
    yield from faults(table, quantities, place)
    yield from _single_trials(table)
    for quantity in quantities:
        yield from _without_logarithm(table, quantity.name, place, family)
        yield from _at_a_limit(table, quantity.name, place)
        yield from _never_moved(table, quantity.name)
    yield from _empty_cells(table, factors, "no trial left" if left_out else "no trial")
    for column in pooled:
        yield from _pooled(table, column)


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
    tried = set(table.groupby(["subject", "environment"], sort=False).groups)
    group_of: list[Mapping[Hashable, str]] = []
    group_at: list[Mapping[Hashable, str]] = []
    for column in factors.levels if factors else ():
        own = table.groupby("subject", sort=False)[column]
        if (own.nunique() == 1).all():
            group_of.append(own.first().astype(str).to_dict())
            cells = table.drop_duplicates("environment").set_index("environment")[column]
            group_at.append(cells.astype(str).to_dict())
    for subject, name in product(table["subject"].unique(), table["environment"].unique()):
        meant = all(
            of_subject[subject] == at[name]
            for of_subject, at in zip(group_of, group_at, strict=True)
        )
        if meant and (subject, name) not in tried:
            yield subject, name


def _empty_cells(table: pd.DataFrame, factors: Factors | None, what: str) -> Iterator[Notice]:
    """Name the subjects that lack an environment."""
    lacking = [f"{subject} at {name}" for subject, name in empty_cells(table, factors)]
    of_subjects = table.groupby("subject", sort=False)["environment"].nunique()
    if lacking and len(of_subjects) > 1 and (of_subjects == 1).all():
        yield Notice("each subject met one environment: environments are groups of subjects")
    elif lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Notice(f"{counted(len(lacking), 'cell')} {has} {what}: {shown(lacking)}")


def _without_logarithm(
    table: pd.DataFrame, parameter: str, place: Places, family: str
) -> Iterator[Notice]:
    """Count zeros and negative values, and say which way out fits them."""
    column = f"{parameter}_adj"
    reference = f"{parameter}_ref"
    known = table.dropna(subset=column)
    low = known[known[column] <= 0]
    if low.empty or set(low[column]) <= set(missing_codes(known[column])):
        return
    few = len(low) <= _FEW * len(known)
    few_zeros = few and bool((low[column] == 0).all())
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
            f" them. If zero is an end of the control, limits = [0.0, inf] below"
            f" [quantities.{parameter}] leaves them out and counts them. If people meant them,"
            ' set family = "normal" in [inference].'
        )
    elif few:
        least = float(known.loc[known[column] > 0, column].min())
        rule = f'{{ column = "{column}", below = {least!r}, why = "slip of sign" }}'
        way = (
            f"If nobody meant that, [sessions] exclude = [{rule}] leaves such trials out and logs"
            ' them. If people meant it, set family = "normal" in [inference].'
        )
    else:
        way = 'To leave out this many biases the rest: set family = "normal" in [inference].'
    text = f"{_share(len(low), len(known), parameter)} zero or negative, here the first. {way}"
    if not no_ratio:
        text += f" There are {by_environment(known, (known[column] <= 0).to_numpy())}."
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
        limits = f"[-inf, {value:g}]" if way == "above" else f"[{value:g}, inf]"
        there = by_environment(table, (table[column] == value).to_numpy())
        text = (
            f"{_share(count, total, parameter)} the {which} of all, {value:g}: the limit of the"
            f" control? There are {there}. Such a value says only that the adjustment lies {way}"
            f" it, and makes the spread too small. [quantities.{parameter}] limits ="
            f" {limits} leaves them out, counts them and logs them."
        )
        first = table.index[table[column] == value][0]
        yield Notice(text, column=column, **place(first))


def _never_moved(table: pd.DataFrame, parameter: str) -> Iterator[Notice]:
    """Name subjects who have several trials, and left the reference in all of them."""
    column = f"{parameter}_adj"
    known = table.dropna(subset=column)
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
        columns = ["subject", "environment", f"{name}_adj", f"{name}_ref"]
        trials = table[columns].set_axis(["subject", "environment", "value", "reference"], axis=1)
        trials = trials[trials["value"] > 0]
        trials["decades"] = np.log10(trials["value"])
        middle = trials.groupby("environment", sort=False)["decades"].transform("median")
        trials["off"] = trials["decades"] - middle
        beside = _Others(trials)
        looked_at = trials[trials["off"].abs() > _LOOKED_AT]
        one: Any
        for one in looked_at.itertuples():
            if len(beside.decades[one.environment]) > 1 and _is_slip(one, beside):
                usual = _quantile(beside.values[one.environment], one.value, 0.5)
                text = (
                    f"{name} = {one.value:.6g} of subject {shown([one.subject])}, where the"
                    f" other trials of {shown([one.environment])} have a median of {usual:.6g}"
                )
                yield Slip(one.Index, one.environment, name, text)


class _Others:
    """Trials sorted by environment and by subject once, so that each is cheap to leave out."""

    def __init__(self, trials: pd.DataFrame) -> None:
        by_environment = trials.groupby("environment", sort=False)
        self.decades = {name: np.sort(own) for name, own in by_environment["decades"]}
        self.values = {name: np.sort(own) for name, own in by_environment["value"]}
        self.subjects = by_environment["subject"].nunique().to_dict()
        self.off = {name: np.sort(own) for name, own in trials.groupby("subject")["off"]}
        sds = by_environment["decades"].agg(_robust_sd)
        #: SD that the other environments usually have, in decades.
        ordered = np.sort(sds)
        self.usual_sd = {name: _quantile(ordered, sd, 0.5) for name, sd in sds.items()}
        if len(sds) == 1:
            self.usual_sd = dict.fromkeys(sds.index, _USUAL_SD)


def _quantile(ordered: _Sorted, left_out: float, share: float) -> float:
    """Quantile of sorted numbers without one of them."""
    last = len(ordered) - 2
    if last < 0:
        return np.nan
    gap = np.searchsorted(ordered, left_out)
    below = int(share * last)
    above = min(below + 1, last)
    # Behind the gap each number stands one place later.
    low = ordered[below + (below >= gap)]
    high = ordered[above + (above >= gap)]
    return float(low + (share * last - below) * (high - low))


def _is_slip(one: Any, others: _Others) -> bool:
    """Whether a digit explains how far a trial lies from those beside it, or nothing does."""
    beside = others.decades[one.environment]
    typical = _quantile(beside, one.decades, 0.5)
    distance = abs(one.decades - typical)
    gross = distance > _GROSS and others.subjects[one.environment] >= _FEWEST
    if abs(distance - 1.0) > _NEAR_TEN and not gross:
        return False
    if len(beside) == 2:
        # Of two trials either may be the slip: it is the one farther from what was shown.
        shown = np.log10(one.reference) if one.reference > 0 else np.nan
        if not abs(one.decades - shown) > abs(typical - shown):
            return False
    freedom = len(beside) - 2
    quartiles = [_quantile(beside, one.decades, share) for share in (0.25, 0.75)]
    own_sd = (quartiles[1] - quartiles[0]) / _QUARTILES
    elsewhere = _ELSEWHERE * others.usual_sd[one.environment] ** 2
    variance = (elsewhere + freedom * own_sd**2) / (_ELSEWHERE + freedom)
    if distance <= _FAR * np.sqrt(variance * (1.0 + 1.0 / (len(beside) - 1))):
        return False
    # A subject who is as far off in other trials has a habit, or another unit.
    habit = _quantile(others.off[one.subject], one.off, 0.5)
    off = one.decades - typical
    return not abs(off - habit) < 1.0 - _NEAR_TEN


def _robust_sd(decades: pd.Series) -> float:
    """SD of normal values that have these quartiles."""
    return float(decades.quantile(0.75) - decades.quantile(0.25)) / _QUARTILES
