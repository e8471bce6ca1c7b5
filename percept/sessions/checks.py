"""Checks over a whole study: references, duplicates, units, published tables, and the full grid."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.sessions.options import ReadOptions
from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, MASS, Notice, Places, Problems, shown

#: What tells a trial from others.
TRIAL = [*IDS, "trial"]
#: From this ratio of adjustments to references on, either way, a unit is doubted.
_OTHER_UNIT = 100.0
#: What N/mm is in N/m: the slip of units there is.
_THOUSAND = 1000.0


def settle_references(
    table: pd.DataFrame,
    declared: Mapping[str, Mapping[str, float]],
    known: dict[str, dict[str, float]],
    parameters: Iterable[str],
    place: Places,
    problems: Problems,
) -> None:
    """Fill references from the scene or earlier rows, and hold every row of an environment to one reference.

    `known` holds the references of earlier blocks, by column and environment; this one's are added.
    """
    columns = [*(f"{p}_ref" for p in parameters), *((MASS,) if MASS in table else ())]
    groups = table.groupby("environment", sort=False)
    codes, firsts = groups.ngroup().to_numpy(), groups[columns].first()
    for column in columns:
        given = {e: own[column] for e, own in declared.items() if column in own}
        earlier = known.setdefault(column, {})
        here = {str(e): float(v) for e, v in firsts[column].items() if v == v}
        earlier.update(here | earlier | given)
        values = table[column].to_numpy(dtype=float)
        expected = np.array([earlier.get(str(e), np.nan) for e in firsts.index])[codes]
        wrong = np.flatnonzero(~np.isnan(values) & (values != expected))
        for row in wrong[np.unique(codes[wrong], return_index=True)[1]].tolist():
            name = table["environment"].iloc[row]
            source = "the scene" if name in given else "an earlier row"
            others = int((codes[wrong] == codes[row]).sum())
            rows = f"; {others} rows have another, here the first" if others > 1 else ""
            message = (
                f"environment {shown([name])} has the reference {expected[row]!s} in"
                f" {source}{rows}."
            )
            hint = (
                "An environment has one reference; correct it, or name the environments apart, as "
            )
            hint += 'environment = ["…", "…"] in [columns] does.'
            problems.add(message, column=column, value=float(values[row]), hint=hint, **place(row))
        if column == MASS:
            table[MASS] = np.nan_to_num(expected)
            continue
        adjusted = table[column.replace("_ref", "_adj")].notna().to_numpy()
        lacking = np.flatnonzero(np.isnan(expected) & adjusted)
        for row in lacking[np.unique(codes[lacking], return_index=True)[1]].tolist():
            message = f"environment {shown([table['environment'].iloc[row]])} has no reference."
            hint = f'Fill in {column}, or declare it in the scene: [environments."…"] {column} = …'
            problems.add(message, column=column, hint=hint, **place(row))
        table[column] = expected


def in_order(references: pd.DataFrame, listed: Iterable[str]) -> tuple[str, ...]:
    """Order environments as the scene lists them, and the rest by references, the first quantity first."""
    ranks = {name: at for at, name in enumerate(listed)}
    ranked = references.assign(
        _rank=[ranks.get(str(name), len(ranks)) for name in references.index]
    )
    by = ["_rank", *references.columns]
    return tuple(map(str, ranked.sort_values(by, kind="stable").index))


def check_duplicates(
    table: pd.DataFrame,
    place: Places,
    problems: Problems,
    *,
    numbered: bool,
    split: Sequence[str] = (),
) -> None:
    """Find rows that stand twice for one subject, session, environment, group told apart and trial."""
    cell = [*dict.fromkeys((*TRIAL, *split))]
    again = np.flatnonzero(table.duplicated(cell).to_numpy()).tolist()
    if again:
        origin = place(int(np.argmax((table[cell] == table[cell].iloc[again[0]]).all(axis=1))))
        where = f"{origin.get('file')}:{origin.get('row')}"
        tell_duplicates(table, again, where, place, problems, numbered=numbered)


def tell_duplicates(
    table: pd.DataFrame,
    again: Sequence[int],
    where: str,
    place: Places,
    problems: Problems,
    *,
    numbered: bool,
) -> None:
    """Record trials that stand twice as one problem: how many there are, and where the first stands."""
    names = ", ".join(f"{c} {shown([str(table[c].iloc[again[0]])])}" for c in IDS)
    text = f"{names}, trial {table['trial'].iloc[again[0]]} stands already in {where}."
    if len(again) > 1 or not numbered:
        what = "trial" if numbered else "environment, and no column numbers their trials"
        share = f"{len(again):,} of {len(table):,} rows ({len(again) / len(table):.1%})"
        text = f"{share} repeat a subject, session and {what}. The first: {text}"
    hint = 'Number the trials by the order of their rows: [sessions] trial = "order".'
    if numbered:
        hint = "Remove one row, or name the column that numbers the trials in [columns]. " + hint
    # Of trials without numbers it would keep one a cell, and drop the repeats that were asked
    # about.
    event = f"keep {len(table) - len(again):,} rows" if numbered else "need a column of trials"
    hint += f' If rows are events of a trial, [sessions] keep = "last" would {event}.'
    hint += ' If they are conditions of one subject, name their column: [study] factor = "…".'
    problems.add(text, hint=hint, **place(again[0]))


def repeats_over_sessions(table: pd.DataFrame) -> list[Notice]:
    """Notice cells whose trials are from several sessions."""
    counts = table.groupby(["subject", "environment"], sort=False)["session"].nunique()
    several = int((counts > 1).sum())
    text = (
        f"in {several} of {counts.size} cells (a subject in an environment) trials are from"
        " several "
    )
    text += (
        "sessions; all count as repeats, so that changes of a subject between sessions are part of"
        " the "
    )
    return [Notice(f"{text}scatter of trials")] if several else []


def _typical_ratio(values: npt.NDArray[np.float64], reference: npt.NDArray[np.float64]) -> float:
    """Median ratio of positive values to their references; 1 without any."""
    return float(np.exp(np.median(np.log(values) - np.log(reference)))) if len(values) else 1.0


def check_plausible(
    table: pd.DataFrame,
    quantities: Iterable[Quantity],
    declared: Set[str],
    place: Places,
    problems: Problems,
) -> list[Notice]:
    """Refuse median ratios of adjustments to references beyond 100, and files a thousand times the others.

    Where the units of both columns are `declared` a notice says so instead.
    """
    notices: list[Notice] = []
    for quantity in quantities:
        adj, ref = f"{quantity.name}_adj", f"{quantity.name}_ref"
        rows = np.flatnonzero((table[adj] > 0) & (table[ref] > 0))
        both = table.iloc[rows]
        ratio = _typical_ratio(both[adj].to_numpy(), both[ref].to_numpy())
        # A slip makes numbers too small where the larger unit was meant. One declared unit is as
        # likely to be the slip as the other column: it settles nothing.
        slip, unit = adj if ratio < 1 else ref, quantity.unit.replace("/m", "/mm") or "…"
        hint = (
            f"Convert the file, or declare the units of both {adj} and {ref} in [columns], such as "
        )
        hint += f'{slip} = {{ name = "…", unit = "{unit}" }}.'
        found: list[tuple[int, str]] = []  # Row, what is wrong
        if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
            text = f"{adj} is {ratio:.3g} times {ref} at the median: their units seem to differ."
            found.append((rows[0], text))
        files = both.groupby("file").indices.values()
        for own in files if len(files) > 1 else ():
            of_file = _typical_ratio(both[adj].to_numpy()[own], both[ref].to_numpy()[own])
            if _THOUSAND / 3 < max(of_file / ratio, ratio / of_file) < _THOUSAND * 3:
                text = (
                    f"{adj} is {of_file:.3g} times {ref} at the median of this file, and"
                    f" {ratio:.3g} "
                )
                text += "times over all files: the units of the file seem to differ by a thousand."
                found.append((rows[own[0]], text))
        for row, text in found:
            if {adj, ref} <= declared:
                notices.append(Notice(text, column=adj))
            else:
                problems.add(
                    text, column=adj, value=float(table[adj].iloc[row]), hint=hint, **place(row)
                )
    return notices


def check_summary(
    table: pd.DataFrame, options: ReadOptions, place: Places, problems: Problems
) -> None:
    """Check a published table: parameter, order of limits, n, level, units, and one row for each interval."""
    quantities = options.quantities
    n, level, again = table["n"], table["level"], table.duplicated(["environment", "parameter"])
    names = " or ".join(f'"{name}"' for name in quantities)
    whole = (n >= 2) & (n < 2.0**53) & (n == np.round(n))
    for column, message, wrong in (
        ("parameter", f"must be {names}.", ~table["parameter"].isin(list(quantities))),
        ("environment", "is empty.", table["environment"].str.strip() == ""),
        ("upper", "is below the lower limit.", table["upper"] < table["lower"]),
        ("n", "must be a whole number of at least 2, and below 2^53.", ~whole),
        ("level", "must lie between 0 and 1, as in 0.99.", (level <= 0) | (level >= 1)),
        ("environment", "a second row for this environment and parameter.", again),
    ):
        for at in np.flatnonzero(wrong).tolist():
            value = table[column].tolist()[at]
            problems.add(
                message, column=column, value=value, hint="Correct or remove it.", **place(at)
            )
    _check_declared(table, options.environments, place, problems)
    # Of what the limits hold, the nearest to the reference: wide limits are no sign of another
    # unit.
    near = table["reference"].clip(table["lower"], table["upper"])
    for p, quantity in quantities.items():
        own = np.flatnonzero((table["parameter"] == p) & (near > 0) & (table["reference"] > 0))
        reference = table["reference"].to_numpy()[own]
        ratio = _typical_ratio(near.to_numpy()[own], reference)
        if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
            text = (
                f"limits of {p} are typically {ratio:.3g} times the reference: their units seem to"
                " differ."
            )
            hint, row = (
                f"Write references and limits in {quantity.unit or 'one unit'}.",
                place(int(own[0])),
            )
            problems.add(text, column="reference", value=float(reference[0]), hint=hint, **row)


def _check_declared(
    table: pd.DataFrame,
    declared: Mapping[str, Mapping[str, float]],
    place: Places,
    problems: Problems,
) -> None:
    """Hold the references of a published table to those of the scene."""
    cells = zip(table["environment"], table["parameter"], table["reference"], strict=True)
    for at, (environment, parameter, reference) in enumerate(cells):
        expected = declared.get(environment, {}).get(f"{parameter}_ref", reference)
        if reference != expected:
            message = f"[environments] gives {shown([environment])} the reference {expected:g}."
            hint = "Correct the table or the scene."
            problems.add(message, column="reference", value=reference, hint=hint, **place(at))


def count_grid(table: pd.DataFrame, rows: pd.Series[int]) -> dict[str, int]:
    """Count observations, and the holes of the subject × environment × trial grid."""
    filled = rows.groupby([table["subject"], table["environment"]], sort=False).sum().to_numpy()
    subjects, environments = table["subject"].nunique(), table["environment"].nunique()
    return {
        "observations": int(filled.sum()),
        "subjects": subjects,
        "environments": environments,
        "empty cells (subject × environment)": subjects * environments - len(filled),
        "missing repeats": int((filled.max() - filled).sum()),
    }
