"""Checks over a whole study: references, duplicates, ids, units, the full grid, and what is seldom meant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, MASS, Exclusion, Notice, Place, Problems, shown

#: What tells a trial from others.
TRIAL = [*IDS, "trial"]
#: From this ratio of adjustments to references on, either way, a unit is doubted.
_OTHER_UNIT = 100.0
#: What N/mm is in N/m: the slip of units there is.
_THOUSAND = 1000.0
#: A value as many times the median of its environment, or as small a part of it, is hardly ever a person's.
_GROSS = 30.0
#: Subjects an environment needs for its median to say anything of one of them.
_FEWEST = 3
#: Values below this share of all are few.
_FEW = 0.05
#: Equal values at one end that chance hardly gives, where adjustments are read to several digits.
_ENOUGH = 4
#: Findings of a kind that are named one by one.
_NAMED = 5


def settle_references(
    table: pd.DataFrame,
    declared: Mapping[str, Mapping[str, float]],
    known: dict[str, dict[str, float]],
    parameters: Iterable[str],
    place: Place,
    problems: Problems,
) -> None:
    """Fill references from the scene or earlier rows, and hold every row of an environment to one reference.

    An environment without a mass has none.

    `known` holds the references of earlier blocks, by column and environment; those of this one are added.
    """
    codes, names = pd.factorize(table["environment"])
    for column in (*(f"{p}_ref" for p in parameters), *((MASS,) if MASS in table else ())):
        earlier = known.setdefault(column, {})
        given = np.array([declared.get(str(name), {}).get(column, np.nan) for name in names])
        values = table[column].to_numpy(dtype=float)
        first = np.full(len(names), np.nan)
        at = np.flatnonzero(~np.isnan(values))[::-1]
        first[codes[at]] = values[at]
        before = np.array([earlier.get(str(name), np.nan) for name in names])
        first = np.where(np.isnan(before), first, before)
        settled = np.where(np.isnan(given), first, given)
        earlier.update((str(n), v) for n, v in zip(names, settled.tolist(), strict=True) if v == v)
        expected = settled[codes]
        wrong = np.flatnonzero(~np.isnan(values) & (values != expected))
        for row in wrong[~pd.Series(codes[wrong]).duplicated()]:
            source = "an earlier row" if np.isnan(given[codes[row]]) else "the scene"
            others = int((codes[wrong] == codes[row]).sum())
            rows = f"; {others} rows have another, here the first" if others > 1 else ""
            problems.add(
                f"environment {shown([names[codes[row]]])} has the reference {expected[row]!s} in "
                f"{source}{rows}.",
                column=column,
                value=float(values[row]),
                hint="An environment has one reference; correct it, or name the environments apart, as "
                'environment = ["…", "…"] in [columns] does.',
                **place(int(row)),
            )
        if column == MASS:
            table[MASS] = np.nan_to_num(expected)
            continue
        lacking = np.isnan(expected) & ~table[column.replace("_ref", "_adj")].isna().to_numpy()
        for code in np.unique(codes[lacking]):
            message = f"environment {shown([names[code]])} has no reference."
            hint = f'Fill in {column}, or declare it in the scene: [environments."…"] {column} = …'
            problems.add(
                message, column=column, hint=hint, **place(int(np.flatnonzero(lacking & (codes == code))[0]))
            )
        table[column] = expected


def in_order(environments: Sequence[str], references: pd.DataFrame, listed: Iterable[str]) -> tuple[str, ...]:
    """Order environments as the scene lists them, and the rest by references, the first quantity first."""
    ranks = {name: at for at, name in enumerate(listed)}
    keys = {
        name: (ranks.get(name, len(ranks)), *(np.inf if v != v else v for v in row))
        for name, row in zip(environments, references.to_numpy(dtype=float).tolist(), strict=True)
    }
    return tuple(sorted(environments, key=keys.__getitem__))


def check_duplicates(
    table: pd.DataFrame, place: Place, problems: Problems, *, numbered: bool, split: Sequence[str] = ()
) -> None:
    """Find rows that stand twice for one subject, session, environment, group told apart and trial."""
    cell = [*dict.fromkeys((*TRIAL, *split))]
    again = np.flatnonzero(table.duplicated(cell).to_numpy())

    def where(at: int) -> str:
        origin = place(int(np.flatnonzero((table[cell] == table[cell].iloc[at]).all(axis=1))[0]))
        return f"{origin.get('file')}:{origin.get('row')}"

    tell_duplicates(table, again.tolist(), where, place, problems, numbered=numbered)


def tell_duplicates(
    table: pd.DataFrame,
    again: Sequence[int],
    where: Callable[[int], str],
    place: Place,
    problems: Problems,
    *,
    numbered: bool,
) -> None:
    """Record trials that stand twice: a few one by one, many as one problem with its size."""
    few = numbered and len(again) <= _NAMED
    rows = f"{len(again):,} of {len(table):,} rows ({len(again) / max(len(table), 1):.1%})"
    hint = 'Number the trials by the order of their rows: [sessions] trial = "order".'
    if numbered:
        hint = "Remove one row, or name the column that numbers the trials in [columns]. " + hint
    # Of trials without numbers it would keep one a cell, and drop the repeats that were asked about.
    event = f"keep {len(table) - len(again):,} rows" if numbered else "need a column of trials"
    hint += f' If rows are events of a trial, [sessions] keep = "last" would {event}.'
    for at in again if few else again[:1]:
        subject, session, environment, trial = (str(table[c].iloc[at]) for c in TRIAL)
        cell = f"subject {shown([subject])}, session {shown([session])}, environment {shown([environment])}"
        text = f"{cell}, trial {trial} stands already in {where(at)}."
        if not few:
            what = "trial" if numbered else "environment, and no column numbers their trials"
            text = f"{rows} repeat a subject, session and {what}. The first: {text}"
        problems.add(text, hint=hint, **place(int(at)))


def look_alikes(ids: Iterable[str], what: str) -> list[Notice]:
    """Notice ids that differ only in leading zeros, case or surrounding space, and padded ids."""
    same: dict[str, list[str]] = {}
    padded = []
    for name in ids:
        bare = name.strip("\ufeff \t\r\n\xa0")
        same.setdefault(bare.casefold().lstrip("0"), []).append(name)
        if bare != name:
            padded.append(name)
    alike = [names for names in same.values() if len(names) > 1]
    notices = [Notice(f"{what}s {shown(names)} look alike and are kept apart") for names in alike]
    if padded:
        notices.append(Notice(f"{what}s {shown(padded)} begin or end with space, which is kept"))
    return notices


def repeats_over_sessions(table: pd.DataFrame) -> list[Notice]:
    """Notice cells whose trials are from several sessions."""
    counts = table.groupby(["subject", "environment"], sort=False)["session"].nunique().to_numpy()
    several = int((counts > 1).sum())
    text = f"in {several} of {counts.size} cells (a subject in an environment) trials are from several "
    text += "sessions; all count as repeats, so that changes of a subject between sessions are part of the "
    return [Notice(f"{text}scatter of trials")] if several else []


def typical_ratio(values: npt.NDArray[np.float64], reference: npt.NDArray[np.float64]) -> float:
    """Median ratio of positive values to their references."""
    return float(np.exp(np.median(np.log(values) - np.log(reference))))


def units_differ(ratio: float) -> bool:
    """Whether a typical ratio of values to their references speaks for two units."""
    return not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT


def check_units(
    quantity: Quantity,
    ratio: float,
    declared: Set[str],
    place: Mapping[str, object],
    problems: Problems,
    *,
    value: float | None = None,
) -> list[Notice]:
    """Refuse adjustments that are typically `ratio` times their references, with the units `declared`."""
    if not units_differ(ratio):
        return []
    adjusted, reference = f"{quantity.name}_adj", f"{quantity.name}_ref"
    text = f"{adjusted} is {ratio:.3g} times {reference} at the median: their units seem to differ."
    settled = {adjusted, reference} & declared
    if len(settled) == 2:
        return [Notice(text, column=adjusted)]
    # One declared unit is as likely to be the slip as the other column: it settles nothing.
    hint = f"Correct the unit in [columns], or declare the units of both {adjusted} and {reference}."
    if not settled:
        # A slip makes numbers too small where the larger unit was meant.
        column = adjusted if ratio < 1 else reference
        unit = quantity.unit.replace("/m", "/mm") or "…"
        hint = f'Declare the unit: [columns] {column} = {{ name = "…", unit = "{unit}" }}.'
    problems.add(text, column=adjusted, value=value, hint=hint, **place)
    return []


def check_plausible(
    table: pd.DataFrame, quantities: Iterable[Quantity], declared: Set[str], place: Place, problems: Problems
) -> list[Notice]:
    """Refuse adjustments whose median ratio to their references is at least 100, or at most 1/100.

    A file whose own ratio is about a thousand times the others' is refused too: one machine wrote N/mm.
    """
    notices: list[Notice] = []
    for quantity in quantities:
        adjusted, reference = (
            table[f"{quantity.name}_{kind}"].to_numpy(dtype=float) for kind in ("adj", "ref")
        )
        known = np.flatnonzero((adjusted > 0) & (reference > 0))
        if len(known):
            at, value = int(known[0]), float(adjusted[known[0]])
            ratio = typical_ratio(adjusted[known], reference[known])
            notices += check_units(quantity, ratio, declared, place(at), problems, value=value)
            p, files = quantity.name, table["file"].to_numpy()[known]
            if files[0] == files[-1]:
                continue
            by_file = pd.Series(np.log(adjusted[known] / reference[known])).groupby(files).median()
            for file, log in by_file.items():
                own = float(np.exp(log))
                if not _THOUSAND / 3 < max(own / ratio, ratio / own) < _THOUSAND * 3:
                    continue
                text = f"{p}_adj is {own:.3g} times {p}_ref at the median of this file, and {ratio:.3g} times"
                text += " over all files: the units of the file seem to differ by a thousand."
                at = int(known[np.argmax(files == file)])
                if {f"{p}_adj", f"{p}_ref"} <= declared:
                    notices.append(Notice(text, column=f"{p}_adj"))
                    continue
                hint = f"Convert the file; where it is right, declare the units of {p}_adj and {p}_ref."
                where = {"column": f"{p}_adj", "value": float(adjusted[at]), "hint": hint}
                problems.add(text, **where, **place(at))
    return notices


def drop_unfinished(table: pd.DataFrame) -> tuple[pd.DataFrame, list[Exclusion]]:
    """Leave out subjects who lack an environment that others have."""
    environments = list(table["environment"].unique())
    seen = table.groupby("subject", sort=False)["environment"].unique()
    lacking = {str(s): [e for e in environments if e not in set(have)] for s, have in seen.items()}
    exclusions = [
        Exclusion(subject, f"all rows (no {shown(missing)})", "unfinished")
        for subject, missing in lacking.items()
        if missing
    ]
    kept = table[~table["subject"].isin([e.who for e in exclusions])]
    if not len(kept):
        message = "every subject lacks an environment that others have."
        raise UsageError(message, key="sessions.unfinished", hint='Leave out unfinished = "exclude".')
    return kept, exclusions


def count_grid(table: pd.DataFrame, rows: pd.Series[int]) -> Counter[str]:
    """Count observations, and the holes of the subject × environment × trial grid."""
    s, subjects = pd.factorize(table["subject"])
    e, environments = pd.factorize(table["environment"])
    cells = len(subjects) * len(environments)
    filled = np.bincount(s * len(environments) + e, weights=rows, minlength=cells)
    return Counter(
        {
            "observations": int(filled.sum()),
            "subjects": len(subjects),
            "environments": len(environments),
            "empty cells (subject × environment)": int((filled == 0).sum()),
            "missing repeats": int((filled.max() - filled[filled > 0]).sum()),
        }
    )


def screen(
    table: pd.DataFrame, parameters: Iterable[str], place: Place, pooled: Iterable[str] = ()
) -> Iterator[Notice]:
    """Warn of what is seldom meant. Nothing is left out: that is for the analyst to declare."""
    for p in parameters:
        yield from _gross_errors(table, p, place)
        yield from _without_logarithm(table, p, place)
        yield from _at_the_end(table, p, place)
        yield from _never_moved(table, p)
    yield from _not_tried(table)
    for column in pooled:
        yield from _pooled(table, column)


def _gross_errors(table: pd.DataFrame, parameter: str, place: Place) -> Iterator[Notice]:
    column = f"{parameter}_adj"
    positive = table[table[column] > 0]
    by_environment = positive.groupby("environment", sort=False)
    typical = by_environment[column].transform("median").to_numpy()
    enough = by_environment["subject"].transform("nunique").to_numpy() >= _FEWEST
    values = positive[column].to_numpy(dtype=float)
    found = np.flatnonzero(enough & ((values > _GROSS * typical) | (values < typical / _GROSS))).tolist()
    for at in found[:_NAMED]:
        row = positive.iloc[at]
        yield Notice(
            f"subject {shown([row['subject']])} set {parameter} to {values[at]:.6g} in "
            f"{shown([row['environment']])}, {values[at] / typical[at]:.2g} times the median of "
            f"{typical[at]:.6g} there: a slip?",
            column=column,
            **place(positive.index[at]),
        )
    if len(found) > _NAMED:
        rest = counted(len(found) - _NAMED, "more value")
        yield Notice(f"and {rest} of {parameter} as far from the median there", column=column)


def _without_logarithm(table: pd.DataFrame, parameter: str, place: Place) -> Iterator[Notice]:
    column = f"{parameter}_adj"
    values = table[column].dropna()
    low = values[values <= 0]
    if low.empty:
        return
    what = f"{_counted_share(len(low), len(values), parameter)} {'is' if len(low) == 1 else 'are'}"
    text = f"{what} zero or negative, here the first. The lognormal family, the default, takes none. "
    normal = 'family = "normal" in [inference]'
    if (table.loc[low.index, f"{parameter}_ref"] <= 0).any():
        text += (
            f"References of zero or below have no ratio: use {normal} with scale in [model]. Where the zero "
            f"of the scale is arbitrary, add one offset to {parameter}_ref and {column} in [columns]."
        )
    elif (low == 0).all() and len(low) <= _FEW * len(values):
        least = float(values[values > 0].min())
        rule = f'{{ column = "{column}", below = {least!r}, why = "no adjustment" }}'
        text += f"So few zeros may be failed trials: [sessions] exclude = [{rule}] leaves them out and logs "
        text += f"them. If people meant them, use {normal}."
    else:
        text += f"Leaving out this many biases what is left: use {normal}."
    yield Notice(text, column=column, **place(low.index[0]))


def _counted_share(count: int, total: int, parameter: str) -> str:
    return f"{counted(count, 'value')} of {parameter} ({count / total:.1%} of {total:,})"


def _at_the_end(table: pd.DataFrame, parameter: str, place: Place) -> Iterator[Notice]:
    """Warn where more values equal the largest or least of all than the one next to it, by far."""
    column = f"{parameter}_adj"
    found = table[column].value_counts().sort_index()
    values, counts = found.index.to_numpy(dtype=float), found.to_numpy()
    for at, beside, which, way in ((-1, -2, "largest", "above"), (0, 1, "least", "below")):
        # Zeros are told already, whatever they come from.
        if len(values) < 3 or counts[at] < max(_ENOUGH, _FEW * counts.sum(), 3 * counts[beside]):
            continue
        if values[at] > 0:
            first = table.index[table[column] == values[at]][0]
            yield Notice(
                f"{_counted_share(int(counts[at]), int(counts.sum()), parameter)} equal the {which} of all, "
                f"{values[at]:g}: the end of the knob? Such a value says only that the adjustment lies {way} "
                f'it, and the spread is too small. [sessions] exclude = [{{ column = "{column}", {way} '
                f'= {float(values[beside])!r}, why = "end of the knob" }}] leaves them out and logs them.',
                column=column,
                **place(first),
            )


def _pooled(table: pd.DataFrame, column: str) -> Iterator[Notice]:
    """Say what becomes of groups that the analysis does not tell apart."""
    levels = table.groupby(column, sort=False)["subject"].nunique()
    if len(levels) < 2:
        return
    sizes = ", ".join(f"{shown([str(name)])} {counted(int(n), 'subject')}" for name, n in levels.items())
    text = f"{len(levels)} groups ({sizes}) are pooled: "
    if (table.groupby("subject", sort=False)[column].nunique() > 1).any():
        text += "a subject's trials of every group count as repeats of one another. "
        text += f'[study] factor = "{column}" contrasts them.'
    else:
        text += "every interval is of one population that holds them all. "
        text += f'"percept compare FILE --by {column}" compares them.'
    yield Notice(text, column=column)


def _never_moved(table: pd.DataFrame, parameter: str) -> Iterator[Notice]:
    column = f"{parameter}_adj"
    known = table[table[column].notna()]
    same = known[column] == known[f"{parameter}_ref"]
    told = same.groupby(known["subject"], sort=False).agg(["all", "size"])
    names = [str(name) for name in told.index[told["all"] & (told["size"] > 1)]]
    if names:
        who = f"{'subject' if len(names) == 1 else 'subjects'} {shown(names)}"
        text = f"{who} left {parameter} at the reference in every trial"
        yield Notice(f"{text}: was what they set recorded?", column=column)


def _not_tried(table: pd.DataFrame) -> Iterator[Notice]:
    tried = set(map(tuple, table[["subject", "environment"]].drop_duplicates().to_numpy().tolist()))
    subjects, environments = (table[c].unique() for c in ("subject", "environment"))
    lacking = [f"{s} at {e}" for s in subjects for e in environments if (s, e) not in tried]
    if lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Notice(f"{counted(len(lacking), 'cell')} {has} no trial: {shown(lacking)}")
