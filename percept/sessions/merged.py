"""The trials of all files as one table, step by step: names, references, responses, limits.

The table has a column `file`, the index of a source, and `row`, the physical line.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, MASS, Exclusion, Found, Notice, clip, shown
from percept.sessions.tables import Log
from percept.sessions.values import fold

#: Environments that a sentence lists.
_LISTED = 8


def settle_names(table: pd.DataFrame, groups: Iterable[str], log: Log) -> None:
    """Write names that differ in spaces or Unicode form alone in the scene's or first spelling."""
    for column in (*IDS, *groups):
        names = table[column].dropna().unique()
        first: dict[str, str] = {}
        for name in [*log.options.environments, *names] if column == "environment" else names:
            first.setdefault(fold(name), name)
        spelled = {name: first[fold(name)] for name in names if first[fold(name)] != name}
        for name, spelling in spelled.items():
            file, row = log.place(table, (table[column] == name).idxmax())
            text = (
                f"{column} {spelling!r} is one name with another spelling in {file}:{row}: they"
                " differ in spaces, zero-width characters or Unicode form only"
            )
            log.notices.append(Notice(text))
        if spelled:
            table[column] = table[column].replace(spelled)


def settle_references(table: pd.DataFrame, parameters: Iterable[str], log: Log) -> None:
    """Fill references from the scene or earlier rows, and hold an environment to one reference.

    Trials may keep references that they have of their own; of what is not matched they are zero.
    """
    options = log.options
    zeros = {f"{p}_ref": 0.0 for p, q in options.quantities.items() if not q.is_matched}
    environments = table["environment"]
    known = {name: options.environments.get(name, {}) | zeros for name in environments.unique()}
    without: dict[str, list[str]] = {}  # References that lack, by environment
    columns = [f"{p}_ref" for p in parameters] + [MASS] * (MASS in table)
    for column in columns:
        values = table[column]
        given = {
            name: references[column] for name, references in known.items() if column in references
        }
        expected = environments.map(given).astype(float)
        if options.trial_references and column != MASS:
            expected = values.fillna(expected)
        else:
            first = values.groupby(environments, sort=False).transform("first")
            expected = expected.fillna(first)
        differs = values.notna() & (values != expected)
        for name, rows in _by_environment(table, differs):
            source = "the scene" if name in given else "an earlier row"
            message = (
                f"environment {shown([name])} has the reference {expected[rows[0]]!s} in {source}"
            )
            if len(rows) > 1:
                message += f"; {len(rows)} rows have another, here the first"
            hint = (
                "An environment has one reference. Correct it, or tell the environments apart by"
                ' further columns: environment = ["…", "…"] in [columns]. If references differ by'
                ' trial, set [model] bias = "reference".'
            )
            value = float(values[rows[0]])
            log.refuse(table, [Found(f"{message}.", column, rows[0], value, hint)])
        if column == MASS:
            table[column] = expected.fillna(0.0)
            continue
        table[column] = expected
        lacking = expected.isna() & table[column.replace("_ref", "_adj")].notna()
        for name, _ in _by_environment(table, lacking):
            without.setdefault(name, []).append(column)
    if without:
        _ask_for_references(without, known, log)


def _by_environment(
    table: pd.DataFrame, chosen: pd.Series[bool]
) -> Iterator[tuple[str, pd.Index[Any]]]:
    """Give the environments of chosen rows, each with these, in the table's order."""
    rows = table["environment"][chosen]
    if len(rows):
        for name in table["environment"].unique():
            if (chosen_rows := rows.index[rows == name]).size:
                yield name, chosen_rows


def _ask_for_references(
    without: Mapping[str, Sequence[str]], known: Mapping[str, Mapping[str, float]], log: Log
) -> None:
    """Refuse environments without a reference, with the lines that a scene needs."""
    lines = ["[environments]"]
    for name, columns in without.items():
        values = [f"{column} = {value!r}" for column, value in known[name].items()]
        values += [f'{column} = "?"' for column in columns]
        lines.append(f"{json.dumps(name, ensure_ascii=False)} = {{ {', '.join(values)} }}")
    names = shown(list(without))
    message = f"{len(without)} environments have no reference: {names}."
    if len(without) == 1:
        message = f"environment {names} has no reference."
    hint = "Write these lines in the scene, with a number in the place of each ?:\n"
    column = next(iter(without.values()))[0]
    log.problems.add(message, column=column, hint=hint + "\n".join(lines))


def make_absolute(table: pd.DataFrame, parameters: Sequence[str], log: Log) -> None:
    """Make adjustments of ratios to their references, and of differences from them."""
    for p in parameters:
        rule = log.options.columns.get(f"{p}_adj")
        response = rule.response if rule else None
        if response == "ratio":
            table[f"{p}_adj"] *= table[f"{p}_ref"]
        elif response == "difference":
            table[f"{p}_adj"] += table[f"{p}_ref"]


def without_ends(table: pd.DataFrame, quantities: Sequence[Quantity], log: Log) -> pd.DataFrame:
    """Leave out adjustments at the limits of their quantities; a row without any goes.

    They say only that the setting meant lies beyond. The intervals then describe the others only.

    Raises
    ------
    UsageError
        Nothing is left.
    """
    for quantity in quantities:
        column = f"{quantity.name}_adj"
        lowest, highest = quantity.limits or (-np.inf, np.inf)
        at_end = (table[column] <= lowest) | (table[column] >= highest)
        if at_end.any():
            _log_ends(table, quantity, at_end, log)
            table = table.assign(**{column: table[column].mask(at_end)})
    if log.at_limits:
        adjusted = [f"{quantity.name}_adj" for quantity in quantities]
        table = table.dropna(subset=adjusted, how="all").reset_index(drop=True)
    if table.empty:
        hint = "Correct limits in [quantities]."
        raise UsageError("every adjustment lies at a limit of its control.", hint=hint)
    return table


def _log_ends(
    table: pd.DataFrame,
    quantity: Quantity,
    at_end: pd.Series[bool],
    log: Log,
) -> None:
    """Log each adjustment at an end of a control, and say how many there are."""
    why = f"{quantity.label} at a limit of its control"
    column = f"{quantity.name}_adj"
    rows = table[at_end]
    columns = rows[["subject", "environment", "file", "row"]]
    for subject, environment, file, row in columns.itertuples(index=False, name=None):
        what = f"{quantity.name} in environment {environment}"
        log.exclusions.append(Exclusion(subject, what, why, log.sources[file].name, row))
    text = (
        f"{counted(len(rows), 'value')} of {table[column].notna().sum()} at the limits of the"
        f" control, {quantity.amounts(quantity.limits or ())}, are left out:"
        f" {by_environment(table, at_end)}. Every interval describes the other values only"
    )
    log.notices.append(Notice(text, column=column))
    log.counts[f"left out: {why}"] = len(rows)
    log.at_limits.append(rows.assign(parameter=quantity.name))


def by_environment(table: pd.DataFrame, chosen: Any) -> str:
    """Count chosen trials per environment, such as "5 of 12 in 'hard' (3 subjects)"."""
    trials = table["environment"].value_counts()
    texts = []
    for name, rows in table[chosen].groupby("environment", sort=False):
        subjects = counted(rows["subject"].nunique(), "subject")
        texts.append(f"{len(rows)} of {trials[name]} in {clip(str(name))!r} ({subjects})")
    more = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return ", ".join(texts[:_LISTED]) + more


def count_grid(table: pd.DataFrame, parameters: Iterable[str]) -> dict[str, int]:
    """Count observations, and the holes of the subject × environment × trial grid."""
    filled = table.groupby(["subject", "environment"], sort=False).size()
    subjects = table["subject"].nunique()
    environments = table["environment"].nunique()
    counts = {
        "observations": len(table),
        "subjects": subjects,
        "environments": environments,
        "empty cells (subject × environment)": subjects * environments - len(filled),
        "missing repeats": int((filled.max() - filled).sum()),
    }
    return counts | {f"rows without {p}": int(table[f"{p}_adj"].isna().sum()) for p in parameters}
