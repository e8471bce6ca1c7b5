"""Checks across all files of a study: references, duplicates, look-alike ids, plausibility, the full grid."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions.options import IDS
from percept.sessions.problems import Problems, shown
from percept.sessions.records import Exclusion, Notice, Source

Place = Callable[[int], Mapping[str, object]]
_CELL = [*IDS, "trial"]
_FAR = 100.0


def settle_references(
    table: pd.DataFrame,
    declared: Mapping[str, Mapping[str, float]],
    parameters: Iterable[str],
    place: Place,
    problems: Problems,
) -> None:
    """Fill references from the scene, and hold every row of an environment to one reference."""
    codes, names = pd.factorize(table["environment"])
    for p in parameters:
        column = f"{p}_ref"
        given = np.array([declared.get(str(name), {}).get(column, np.nan) for name in names])
        values = table[column].to_numpy(dtype=float).copy()
        first = np.full(len(names), np.nan)
        at = np.flatnonzero(~np.isnan(values))[::-1]
        first[codes[at]] = values[at]
        expected = np.where(np.isnan(given), first, given)[codes]
        differ = ~np.isnan(values) & (values != expected)
        for at_row in problems.first(np.flatnonzero(differ)):
            source = "the scene" if not np.isnan(given[codes[at_row]]) else "an earlier row"
            problems.add(
                f"environment {shown([names[codes[at_row]]])} has the reference {expected[at_row]!s} "
                f"in {source}.",
                column=column,
                value=float(values[at_row]),
                hint="An environment has one reference; correct it, or name the environments apart.",
                **place(int(at_row)),
            )
        lacking = np.isnan(expected) & ~table[f"{p}_adj"].isna().to_numpy()
        for code in np.unique(codes[lacking]):
            at_row = int(np.flatnonzero(lacking & (codes == code))[0])
            problems.add(
                f"environment {shown([names[code]])} has no reference.",
                column=column,
                hint=f'Fill in {column}, or declare it in the scene: [environments."…"] {column} = …',
                **place(at_row),
            )
        table[column] = expected


def refuse_twin(sources: Iterable[Source], name: str, sha256: str) -> None:
    """Refuse a file that was read already, under whatever name."""
    twin = next((source.name for source in sources if source.sha256 == sha256), None)
    if twin is not None:
        raise UsageError(f"byte for byte the same file as {twin}.", file=name, hint="Leave one of them out.")


def check_duplicates(table: pd.DataFrame, place: Place, problems: Problems) -> None:
    """Find rows that stand twice for one subject, session, environment and trial."""
    again = table.duplicated(_CELL).to_numpy()
    if not again.any():
        return
    first = table.drop_duplicates(_CELL)[_CELL].assign(at=lambda t: t.index).set_index(_CELL)["at"]
    for at in problems.first(np.flatnonzero(again)):
        subject, session, environment, trial = (table[c].iloc[at] for c in _CELL)
        origin = place(int(first.loc[(subject, session, environment, trial)]))
        problems.add(
            f"subject {shown([subject])}, session {shown([session])}, environment {shown([environment])}, "
            f"trial {trial} stands already in {origin.get('file')}:{origin.get('row')}.",
            hint='Name the trial column in [columns]; for a row per event declare [sessions] keep = "last"; '
            "else remove one row.",
            **place(int(at)),
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
    notices = [
        Notice(f"{what}s {shown(names)} look alike and are kept apart")
        for names in same.values()
        if len(names) > 1
    ]
    if padded:
        notices.append(Notice(f"{what}s {shown(padded)} begin or end with space, which is kept"))
    return notices


def repeats_over_sessions(sessions: npt.ArrayLike) -> list[Notice]:
    """Notice cells whose trials are from several sessions."""
    counts = np.asarray(sessions)
    several = int((counts > 1).sum())
    if not several:
        return []
    return [
        Notice(
            f"in {several} of {counts.size} cells (a subject in an environment) trials are from several "
            "sessions; all count as repeats, so that changes of a subject between sessions are part of the "
            "scatter of trials"
        )
    ]


def check_plausible(
    table: pd.DataFrame,
    parameters: Iterable[str],
    declared_units: set[str],
    place: Place,
    problems: Problems,
) -> list[Notice]:
    """Refuse adjustments whose median ratio to their references is at least 100, or at most 1/100."""
    notices: list[Notice] = []
    for p in parameters:
        adjusted = table[f"{p}_adj"].to_numpy(dtype=float)
        reference = table[f"{p}_ref"].to_numpy(dtype=float)
        known = (adjusted > 0) & (reference > 0)
        if not known.any():
            continue
        doubt = unit_doubt(p, _typical_ratio(adjusted[known], reference[known]), declared_units)
        if doubt is None:
            continue
        if doubt.hint is None:
            notices.append(Notice(doubt.text, column=f"{p}_adj"))
            continue
        at = int(np.flatnonzero(known)[0])
        problems.add(doubt.text, column=f"{p}_adj", value=float(adjusted[at]), hint=doubt.hint, **place(at))
    return notices


class UnitDoubt(NamedTuple):
    """What makes a unit doubtful, and what to do; both units declared leave nothing to do."""

    text: str
    hint: str | None


def unit_doubt(parameter: str, ratio: float, declared_units: Set[str]) -> UnitDoubt | None:
    """Say that units seem to differ, where adjustments are at the median `ratio` times their references."""
    if 1 / _FAR < ratio < _FAR:
        return None
    adjusted, reference = f"{parameter}_adj", f"{parameter}_ref"
    text = f"{adjusted} is {ratio:.3g} times {reference} at the median: their units seem to differ."
    declared = {adjusted, reference} & declared_units
    if len(declared) == 2:
        return UnitDoubt(text, None)
    if declared:
        # One declared unit is as likely to be the slip as the other column: it settles nothing.
        hint = f"Correct the unit in [columns], or declare the units of both {adjusted} and {reference}."
        return UnitDoubt(text, hint)
    # A slip makes numbers too small where the larger unit was meant.
    column, unit = adjusted if ratio < 1 else reference, "N/mm" if parameter == "k" else "N·s/mm"
    return UnitDoubt(text, f'Declare the unit: [columns] {column} = {{ name = "…", unit = "{unit}" }}.')


def units_of_scene(environments: Mapping[str, Mapping[str, float]]) -> set[str]:
    """Name the references that stand in the scene's [environments], whose unit is percept's own."""
    return {name for references in environments.values() for name in references}


def _typical_ratio(values: npt.NDArray[np.float64], reference: npt.NDArray[np.float64]) -> float:
    return float(np.exp(np.median(np.log(values) - np.log(reference))))


def drop_unfinished(table: pd.DataFrame) -> tuple[pd.DataFrame, list[Exclusion]]:
    """Leave out subjects who lack an environment that others have."""
    environments = list(table["environment"].unique())
    seen = table.groupby("subject", sort=False)["environment"].unique()
    lacking = {s: [e for e in environments if e not in set(have)] for s, have in seen.items()}
    exclusions = [
        Exclusion(str(subject), f"all rows (no {shown(missing)})", "unfinished")
        for subject, missing in lacking.items()
        if missing
    ]
    kept = table[~table["subject"].isin([e.who for e in exclusions])]
    if not len(kept):
        raise UsageError(
            "every subject lacks an environment that others have.",
            key="sessions.unfinished",
            hint='Leave out unfinished = "exclude".',
        )
    return kept, exclusions


def count_grid(table: pd.DataFrame, parameters: Sequence[str]) -> Counter[str]:
    """Count the observations and the holes of the full subject × environment × trial grid."""
    counts: Counter[str] = Counter({"observations": len(table)})
    if not len(table):
        return counts
    s, subjects = pd.factorize(table["subject"])
    e, environments = pd.factorize(table["environment"])
    filled = np.bincount(s * len(environments) + e, minlength=len(subjects) * len(environments))
    counts["subjects"] = len(subjects)
    counts["environments"] = len(environments)
    counts["empty cells (subject × environment)"] = int((filled == 0).sum())
    counts["missing repeats"] = int((filled.max() - filled[filled > 0]).sum())
    for p in parameters:
        counts[f"rows without {p}"] = int(table[f"{p}_adj"].isna().sum())
    return counts


def check_summary(table: pd.DataFrame, place: Place, problems: Problems) -> None:
    """Check a published table: parameter, order of limits, n, level, units, and one row for each interval."""
    rules = (
        ("parameter", ~table["parameter"].isin(["k", "b"]), 'must be "k" or "b".'),
        ("environment", table["environment"].str.strip() == "", "is empty."),
        ("upper", table["upper"] < table["lower"], "is below the lower limit."),
        (
            "n",
            (table["n"] < 2) | (table["n"] >= 2.0**53) | (table["n"] != np.round(table["n"])),
            "must be a whole number of at least 2, and below 2^53.",
        ),
        ("level", (table["level"] <= 0) | (table["level"] >= 1), "must lie between 0 and 1, as in 0.99."),
    )
    for column, wrong, message in rules:
        values = table[column].tolist()
        for at in np.flatnonzero(np.asarray(wrong)):
            problems.add(message, column=column, value=values[at], hint="Correct it.", **place(int(at)))
    _check_units(table, place, problems)
    for at in np.flatnonzero(table.duplicated(["environment", "parameter"]).to_numpy()):
        problems.add(
            "a second row for this environment and parameter.",
            column="environment",
            value=table["environment"].iloc[at],
            hint="Remove one of them.",
            **place(int(at)),
        )


def _check_units(table: pd.DataFrame, place: Place, problems: Problems) -> None:
    """Compare published limits with their references, as `check_plausible` compares adjustments."""
    values, lower, upper = (table[c].to_numpy(dtype=float) for c in ("reference", "lower", "upper"))
    # Of what the limits hold, the nearest to the reference: wide limits are no sign of another unit.
    nearest = np.clip(values, lower, upper)
    for p, unit in (("k", "N/m"), ("b", "N·s/m")):
        known = np.flatnonzero((table["parameter"] == p).to_numpy() & (nearest > 0) & (values > 0))
        ratio = _typical_ratio(nearest[known], values[known]) if len(known) else 1.0
        if not 1 / _FAR < ratio < _FAR:
            problems.add(
                f"limits of {p} are typically {ratio:.3g} times the reference: their units seem to differ.",
                column="reference",
                value=float(values[known[0]]),
                hint=f"Write references and limits in {unit}.",
                **place(int(known[0])),
            )
