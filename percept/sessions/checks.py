"""Checks over a whole study: references, duplicates, ids, units, the full grid, and what is seldom meant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions.records import IDS, MASS, Exclusion, Notice, Place, Problems, shown

#: What tells a trial from others.
TRIAL = [*IDS, "trial"]
#: From this ratio of adjustments to references on, either way, a unit is doubted.
_OTHER_UNIT = 100.0
#: A value as many times the median of its environment, or as small a part of it, is hardly ever a person's.
_GROSS = 30.0
#: Subjects an environment needs for its median to say anything of one of them.
_FEWEST = 3
#: Gross errors of a parameter that are named one by one.
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
        for row in problems.first(np.flatnonzero(~np.isnan(values) & (values != expected))):
            source = "an earlier row" if np.isnan(given[codes[row]]) else "the scene"
            problems.add(
                f"environment {shown([names[codes[row]]])} has the reference {expected[row]!s} in {source}.",
                column=column,
                value=float(values[row]),
                hint="An environment has one reference; correct it, or name the environments apart.",
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
    """Order environments as the scene lists them, and the rest by reference, first by that of stiffness."""
    ranks = {name: at for at, name in enumerate(listed)}
    keys = {
        name: (ranks.get(name, len(ranks)), *(np.inf if v != v else v for v in row))
        for name, row in zip(environments, references.to_numpy(dtype=float).tolist(), strict=True)
    }
    return tuple(sorted(environments, key=keys.__getitem__))


def check_duplicates(table: pd.DataFrame, place: Place, problems: Problems) -> None:
    """Find rows that stand twice for one subject, session, environment and trial."""
    again = table.duplicated(TRIAL).to_numpy()
    if not again.any():
        return
    first = table.drop_duplicates(TRIAL)[TRIAL].assign(at=lambda t: t.index).set_index(TRIAL)["at"]
    for at in problems.first(np.flatnonzero(again)):
        trial = tuple(table[c].iloc[at] for c in TRIAL)
        origin = place(int(first.loc[trial]))
        add_duplicate(trial, f"{origin.get('file')}:{origin.get('row')}", place(int(at)), problems)


def add_duplicate(
    trial: Sequence[object], where: str, place: Mapping[str, object], problems: Problems
) -> None:
    """Record a trial that stands twice, and where it stands already."""
    subject, session, environment = (shown([str(name)]) for name in trial[:3])
    problems.add(
        f"subject {subject}, session {session}, environment {environment}, trial {trial[3]} stands already "
        f"in {where}.",
        hint='Name the trial column in [columns]; for a row per event declare [sessions] keep = "last"; else '
        "remove one row.",
        **place,
    )


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
    text = (
        f"in {several} of {counts.size} cells (a subject in an environment) trials are from several sessions;"
        " all count as repeats, so that changes of a subject between sessions are part of the scatter of "
        "trials"
    )
    return [Notice(text)] if several else []


def typical_ratio(values: npt.NDArray[np.float64], reference: npt.NDArray[np.float64]) -> float:
    """Median ratio of positive values to their references."""
    return float(np.exp(np.median(np.log(values) - np.log(reference))))


def units_differ(ratio: float) -> bool:
    """Whether a typical ratio of values to their references speaks for two units."""
    return not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT


def check_units(
    parameter: str,
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
    adjusted, reference = f"{parameter}_adj", f"{parameter}_ref"
    text = f"{adjusted} is {ratio:.3g} times {reference} at the median: their units seem to differ."
    settled = {adjusted, reference} & declared
    if len(settled) == 2:
        return [Notice(text, column=adjusted)]
    # One declared unit is as likely to be the slip as the other column: it settles nothing.
    hint = f"Correct the unit in [columns], or declare the units of both {adjusted} and {reference}."
    if not settled:
        # A slip makes numbers too small where the larger unit was meant.
        column, unit = adjusted if ratio < 1 else reference, "N/mm" if parameter == "k" else "N·s/mm"
        hint = f'Declare the unit: [columns] {column} = {{ name = "…", unit = "{unit}" }}.'
    problems.add(text, column=adjusted, value=value, hint=hint, **place)
    return []


def check_plausible(
    table: pd.DataFrame, parameters: Iterable[str], declared: Set[str], place: Place, problems: Problems
) -> list[Notice]:
    """Refuse adjustments whose median ratio to their references is at least 100, or at most 1/100."""
    notices: list[Notice] = []
    for p in parameters:
        adjusted, reference = (table[f"{p}_{kind}"].to_numpy(dtype=float) for kind in ("adj", "ref"))
        known = np.flatnonzero((adjusted > 0) & (reference > 0))
        if len(known):
            at, value = int(known[0]), float(adjusted[known[0]])
            ratio = typical_ratio(adjusted[known], reference[known])
            notices += check_units(p, ratio, declared, place(at), problems, value=value)
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


def screen(table: pd.DataFrame, parameters: Iterable[str], place: Place) -> Iterator[Notice]:
    """Warn of what is seldom meant. Nothing is left out: that is for the analyst to declare."""
    for p in parameters:
        yield from _gross_errors(table, p, place)
        yield from _without_logarithm(table, p, place)
        yield from _never_moved(table, p)
    yield from _not_tried(table)


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
    low = table.index[table[column] <= 0]
    if len(low):
        what = f"{counted(len(low), 'value')} of {parameter} {'is' if len(low) == 1 else 'are'}"
        text = f"{what} zero or negative, here the first: the lognormal family, the default, takes none"
        yield Notice(text, column=column, **place(low[0]))


def _never_moved(table: pd.DataFrame, parameter: str) -> Iterator[Notice]:
    column = f"{parameter}_adj"
    known = table[table[column].notna()]
    same = known[column] == known[f"{parameter}_ref"]
    told = same.groupby(known["subject"], sort=False).agg(["all", "size"])
    names = [str(name) for name in told.index[told["all"] & (told["size"] > 1)]]
    if names:
        who = "subject" if len(names) == 1 else "subjects"
        text = f"{who} {shown(names)} left {parameter} at the reference in every trial"
        yield Notice(f"{text}: was what they set recorded?", column=column)


def _not_tried(table: pd.DataFrame) -> Iterator[Notice]:
    tried = set(map(tuple, table[["subject", "environment"]].drop_duplicates().to_numpy().tolist()))
    subjects, environments = (table[c].unique() for c in ("subject", "environment"))
    lacking = [f"{s} at {e}" for s in subjects for e in environments if (s, e) not in tried]
    if lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Notice(f"{counted(len(lacking), 'cell')} {has} no trial: {shown(lacking)}")
