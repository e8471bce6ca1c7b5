"""The trials of all files as one table, step by step: references, responses, ends of controls.

The table has a column `file`, the index of a source, and `row`, the physical line.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions.quantities import Quantity
from percept.sessions.records import MASS, Exclusion, Found, Notice, clip, shown
from percept.sessions.tables import Log

#: Environments that a sentence lists.
_LISTED = 8


def settle_references(table: pd.DataFrame, parameters: Iterable[str], log: Log) -> None:
    """Fill references from the scene or earlier rows, and hold an environment to one reference.

    Trials may keep references that they have of their own; of what is not matched they are zero.
    """
    zeros = {f"{p}_ref": 0.0 for p, q in log.options.quantities.items() if not q.is_matched}
    environments = table["environment"]
    known = {
        name: {**log.options.environments.get(name, {}), **zeros} for name in environments.unique()
    }
    without: dict[str, list[str]] = {}  # References that lack, by environment
    columns = [f"{p}_ref" for p in parameters]
    if MASS in table:
        columns.append(MASS)
    for column in columns:
        values = table[column]
        given = {name: own[column] for name, own in known.items() if column in own}
        declared = environments.map(given).astype(float)
        if log.options.trial_references and column != MASS:
            expected = values.fillna(declared)
        else:
            first = values.groupby(environments, sort=False).transform("first")
            expected = declared.fillna(first)
        for name, row, count in _firsts(environments, values.notna() & (values != expected)):
            source = "the scene" if name in given else "an earlier row"
            message = f"environment {shown([name])} has the reference {expected[row]!s} in {source}"
            if count > 1:
                message += f"; {count} rows have another, here the first"
            hint = (
                "An environment has one reference. Correct it, or tell the environments apart by"
                ' further columns: environment = ["…", "…"] in [columns]. If references differ by'
                ' trial, set [model] bias = "reference".'
            )
            log.refuse(table, [Found(f"{message}.", column, row, float(values[row]), hint)])
        table[column] = expected
        if column == MASS:
            table[column] = expected.fillna(0.0)
            continue
        lacking = expected.isna() & table[column.replace("_ref", "_adj")].notna()
        for name, *_ in _firsts(environments, lacking):
            without.setdefault(name, []).append(column)
    if without:
        _ask_for_references(without, known, log)


def _firsts(environments: pd.Series[str], chosen: pd.Series[bool]) -> list[tuple[str, int, int]]:
    """Name the environments of chosen rows, with the first of these rows and their number."""
    if not chosen.any():
        return []
    counts = environments[chosen].value_counts()
    order = [name for name in environments.unique() if name in counts]
    return [
        (name, int(np.argmax(chosen & (environments == name))), int(counts[name])) for name in order
    ]


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
        adjusted = f"{p}_adj"
        rule = log.options.columns.get(adjusted)
        response = rule.response if rule else None
        if response == "ratio":
            table[adjusted] *= table[f"{p}_ref"]
        elif response == "difference":
            table[adjusted] += table[f"{p}_ref"]


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


def _log_ends(table: pd.DataFrame, quantity: Quantity, at_end: pd.Series[bool], log: Log) -> None:
    """Log each adjustment at an end of a control, and say how many there are."""
    why = f"{quantity.label} at a limit of its control"
    column = f"{quantity.name}_adj"
    place = log.places(table)
    rows = table[at_end]
    for row, subject, environment in zip(
        rows.index, rows["subject"], rows["environment"], strict=True
    ):
        what = f"{quantity.name} in environment {environment}"
        log.exclusions.append(Exclusion(subject, what, why, **place(row)))
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
    for p in parameters:
        counts[f"rows without {p}"] = int(table[f"{p}_adj"].isna().sum())
    return counts
