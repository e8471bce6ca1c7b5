"""Checks over a whole study: references, duplicates, units, published tables, and the full grid."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, MASS, Notice, Problems, shown
from percept.sessions.tables import Log

#: What tells a trial from others.
TRIAL = [*IDS, "trial"]
#: From this ratio of adjustments to references on, either way, a unit is doubted.
_OTHER_UNIT = 100.0
#: What N/mm is in N/m: the slip of units there is.
_THOUSAND = 1000.0
#: A file is off by a thousand where its ratio to the others is within this factor of it.
_ABOUT = 3.0


def settle_references(table: pd.DataFrame, parameters: Iterable[str], log: Log) -> None:
    """Fill references from the scene or earlier rows, and hold an environment to one reference.

    Trials may keep references that they have of their own; of what is not matched they are zero.
    """
    zeros = {f"{p}_ref": 0.0 for p, q in log.options.quantities.items() if not q.is_matched}
    environments = log.options.environments
    declared = {name: environments.get(name, {}) | zeros for name in table["environment"].unique()}
    place = log.places(table)
    columns = [f"{p}_ref" for p in parameters]
    if MASS in table:
        columns.append(MASS)
    groups = table.groupby("environment", sort=False)
    codes = groups.ngroup().to_numpy()
    without: dict[str, list[str]] = {}  # References that lack, by environment
    firsts = groups[columns].first()
    for column in columns:
        given = {e: own[column] for e, own in declared.items() if column in own}
        of_environment = pd.Series(given, dtype=float).reindex(firsts.index)
        own_of_trial = log.options.trial_references and column != MASS
        if not own_of_trial:
            of_environment = of_environment.fillna(firsts[column])
        expected = of_environment.to_numpy(dtype=float)[codes]
        values = table[column].to_numpy(dtype=float)
        if own_of_trial:
            expected = np.where(np.isnan(values), expected, values)
        wrong = np.flatnonzero(~np.isnan(values) & (values != expected))
        for row in _first_of_each(wrong, codes):
            name = table["environment"].iloc[row]
            source = "the scene" if name in given else "an earlier row"
            message = f"environment {shown([name])} has the reference {expected[row]!s} in {source}"
            same = int((codes[wrong] == codes[row]).sum())
            if same > 1:
                message += f"; {same} rows have another, here the first"
            hint = (
                "An environment has one reference. Correct it, or tell the environments apart by"
                ' further columns: environment = ["…", "…"] in [columns]. If references differ by'
                ' trial, set [model] bias = "reference".'
            )
            value = float(values[row])
            log.problems.add(f"{message}.", column=column, value=value, hint=hint, **place(row))
        if column == MASS:
            table[MASS] = np.nan_to_num(expected)
            continue
        adjusted = table[column.replace("_ref", "_adj")].notna().to_numpy()
        lacking = np.flatnonzero(np.isnan(expected) & adjusted)
        for row in _first_of_each(lacking, codes):
            without.setdefault(str(table["environment"].iloc[row]), []).append(column)
        table[column] = expected
    if without:
        _ask_for_references(without, declared, log.problems)


def _ask_for_references(
    without: Mapping[str, Sequence[str]],
    declared: Mapping[str, Mapping[str, float]],
    problems: Problems,
) -> None:
    """Refuse environments without a reference, with the lines that a scene needs."""
    lines = ["[environments]"]
    for name, columns in without.items():
        values = [f"{column} = {value!r}" for column, value in declared.get(name, {}).items()]
        values += [f'{column} = "?"' for column in columns]
        lines.append(f"{json.dumps(name, ensure_ascii=False)} = {{ {', '.join(values)} }}")
    names = shown(list(without))
    if len(without) == 1:
        message = f"environment {names} has no reference."
    else:
        message = f"{len(without)} environments have no reference: {names}."
    hint = "Write these lines in the scene, with a number in the place of each ?:\n"
    column = next(iter(without.values()))[0]
    problems.add(message, column=column, hint=hint + "\n".join(lines))


def _first_of_each(rows: npt.NDArray[np.intp], codes: npt.NDArray[Any]) -> list[int]:
    """Return the first of the rows in each environment."""
    _, first = np.unique(codes[rows], return_index=True)
    return [int(row) for row in rows[first]]


def in_order(references: pd.DataFrame, listed: Iterable[str]) -> tuple[str, ...]:
    """Order environments as the scene lists them, and the rest by references."""
    ranks = {name: rank for rank, name in enumerate(listed)}
    rank = [ranks.get(str(name), len(ranks)) for name in references.index]
    ranked = references.assign(_rank=rank)
    by = ["_rank", *references.columns]
    return tuple(str(name) for name in ranked.sort_values(by, kind="stable").index)


def refuse_repeats(table: pd.DataFrame, cell: list[str], log: Log, telling: Sequence[str]) -> None:
    """Refuse rows that repeat what tells trials apart; there are some.

    Each of the columns `telling` would tell all of them apart.
    """
    place = log.places(table)
    numbered = log.numbered
    again = np.flatnonzero(table.duplicated(cell).to_numpy()).tolist()
    count = len(again)
    first = table.iloc[again[0]]
    origin = place(int(np.argmax((table[cell] == first[cell]).all(axis=1))))
    names = ", ".join(f"{column} {shown([str(first[column])])}" for column in IDS)
    where = f"{origin.get('file')}:{origin.get('row')}"
    text = f"{names}, trial {first['trial']} is already in {where}."
    if count > 1 or not numbered:
        what = "trial" if numbered else "environment, and no column numbers their trials"
        share = f"{count:,} of {len(table):,} rows ({count / len(table):.1%})"
        text = f"{share} repeat a subject, session and {what}. The first: {text}"
    # Without numbers it would keep one trial per cell, and drop the repeats.
    event = f"keep {len(table) - count:,} rows" if numbered else "need a column of trials"
    hints = [
        'Number the trials by the order of their rows: [sessions] trial = "order".',
        f'If rows are events of a trial, [sessions] keep = "last" would {event}.',
        _conditions(telling),
    ]
    if numbered:
        hints.insert(0, "Remove one row, or name the column of trial numbers in [columns].")
    log.problems.add(text, hint=" ".join(hints), **place(again[0]))


def _conditions(telling: Sequence[str]) -> str:
    """Say how rows become conditions, by a column that tells them apart where there is one."""
    if not telling:
        return 'If they are conditions of one subject, name their column: [study] factor = "…".'
    columns = f"column {shown(telling)} tells"
    if len(telling) > 1:
        columns = f"each of the columns {shown(telling)} tells"
    return f'For conditions of one subject, {columns} them apart: [study] factor = "{telling[0]}".'


def repeats_over_sessions(table: pd.DataFrame) -> list[Notice]:
    """Notice cells whose trials are from several sessions."""
    counts = table.groupby(["subject", "environment"], sort=False)["session"].nunique()
    several = int((counts > 1).sum())
    text = (
        f"{several} of {counts.size} cells (a subject in an environment) have trials of several"
        " sessions. All count as repeats: changes between sessions are part of the scatter of"
        " trials"
    )
    return [Notice(text)] if several else []


def _typical_ratio(values: npt.NDArray[np.float64], reference: npt.NDArray[np.float64]) -> float:
    """Median ratio of positive values to their references; 1 without any."""
    if not len(values):
        return 1.0
    return float(np.exp(np.median(np.log(values) - np.log(reference))))


def check_plausible(table: pd.DataFrame, quantities: Iterable[Quantity], log: Log) -> None:
    """Refuse median ratios of adjustments to references beyond 100, and files off by a thousand.

    Where the units of both columns are declared a notice says so instead.
    """
    place = log.places(table)
    for quantity in quantities:
        adj = f"{quantity.name}_adj"
        ref = f"{quantity.name}_ref"
        for slip in _slips(table, adj, ref):
            if {adj, ref} <= log.declared_units:
                log.notices.append(Notice(slip.text, column=adj))
                continue
            # A slip makes numbers too small where the larger unit was meant. One declared unit is
            # as likely to be the slip as the other column: it settles nothing.
            column = adj if slip.ratio < 1 else ref
            unit = quantity.unit.replace("/m", "/mm") or "…"
            hint = (
                f"Convert the file, or declare the units of both {adj} and {ref} in [columns],"
                f' such as {column} = {{ name = "…", unit = "{unit}" }}.'
            )
            value = float(table[adj].iloc[slip.row])
            log.problems.add(slip.text, column=adj, value=value, hint=hint, **place(slip.row))


@dataclass(frozen=True)
class _Slip:
    """A unit that seems wrong: the first row, the study's ratio, and what is wrong."""

    row: int
    ratio: float
    text: str


def _slips(table: pd.DataFrame, adj: str, ref: str) -> Iterator[_Slip]:
    """Find ratios of a quantity that a wrong unit would explain, over all files and in each."""
    rows = np.flatnonzero((table[adj] > 0) & (table[ref] > 0))
    both = table.iloc[rows]
    adjusted = both[adj].to_numpy()
    reference = both[ref].to_numpy()
    ratio = _typical_ratio(adjusted, reference)
    if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        text = f"{adj} is {ratio:.3g} times {ref} at the median: their units seem to differ."
        yield _Slip(int(rows[0]), ratio, text)
    for column in ("file", "subject"):
        found = False
        for own in both.groupby(column, sort=False).indices.values():
            of_part = _typical_ratio(adjusted[own], reference[own])
            factor = max(of_part / ratio, ratio / of_part)
            if not _THOUSAND / _ABOUT < factor < _THOUSAND * _ABOUT:
                continue
            found = True
            where = "this file"
            if column == "subject":
                where = f"subject {shown([str(both[column].iloc[own[0]])])}"
            text = (
                f"{adj} is {of_part:.3g} times {ref} at the median of {where}, and"
                f" {ratio:.3g} times over all {column}s: the units of the {column} seem to differ"
                " by a thousand."
            )
            yield _Slip(int(rows[own[0]]), ratio, text)
        if found:
            return


def check_summary(table: pd.DataFrame, log: Log) -> None:
    """Check the parameters, limits, n, levels and units of a published table."""
    options = log.options
    problems = log.problems
    place = log.places(table)
    names = " or ".join(f'"{name}"' for name in options.quantities)
    n = table["n"]
    level = table["level"]
    whole = (n >= 2) & (n < 2.0**53) & (n == np.round(n))
    again = table.duplicated(["environment", "parameter"])
    rules = [
        ("parameter", f"must be {names}.", ~table["parameter"].isin(list(options.quantities))),
        ("environment", "is empty.", table["environment"].str.strip() == ""),
        ("upper", "is below the lower limit.", table["upper"] < table["lower"]),
        ("n", "must be a whole number of at least 2, and below 2^53.", ~whole),
        ("level", "must lie between 0 and 1, as in 0.99.", (level <= 0) | (level >= 1)),
        ("environment", "a second row for this environment and parameter.", again),
    ]
    for column, message, wrong in rules:
        values = table[column].tolist()
        for row in np.flatnonzero(wrong).tolist():
            hint = "Correct or remove it."
            problems.add(message, column=column, value=values[row], hint=hint, **place(row))
    # References of the scene.
    cells = zip(table["environment"], table["parameter"], table["reference"], strict=True)
    for row, (environment, parameter, reference) in enumerate(cells):
        own = options.environments.get(environment, {})
        expected = own.get(f"{parameter}_ref", reference)
        if reference != expected:
            message = f"[environments] gives {shown([environment])} the reference {expected:g}."
            hint = "Correct the table or the scene."
            problems.add(message, column="reference", value=reference, hint=hint, **place(row))
    # Of what the limits hold, the nearest to the reference: wide limits are no sign of another
    # unit.
    near = table["reference"].clip(table["lower"], table["upper"])
    for name, quantity in options.quantities.items():
        positive = (near > 0) & (table["reference"] > 0)
        rows = np.flatnonzero((table["parameter"] == name) & positive)
        reference = table["reference"].to_numpy()[rows]
        ratio = _typical_ratio(near.to_numpy()[rows], reference)
        if 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
            continue
        message = (
            f"limits of {name} are typically {ratio:.3g} times the reference: their units seem to"
            " differ."
        )
        hint = f"Write references and limits in {quantity.unit or 'one unit'}."
        value = float(reference[0])
        problems.add(message, column="reference", value=value, hint=hint, **place(int(rows[0])))


def count_grid(table: pd.DataFrame) -> dict[str, int]:
    """Count observations, and the holes of the subject × environment × trial grid."""
    filled = table.groupby(["subject", "environment"], sort=False).size().to_numpy()
    subjects = table["subject"].nunique()
    environments = table["environment"].nunique()
    return {
        "observations": len(table),
        "subjects": subjects,
        "environments": environments,
        "empty cells (subject × environment)": subjects * environments - len(filled),
        "missing repeats": int((filled.max() - filled).sum()),
    }
