"""The trials of all files as one table: settled step by step, and checked as a whole.

The table has a column `file`, the index of a source, and `row`, the physical line. Each check gives
what it finds; `Log.refuse` takes it up with its file and line.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions.options import DataTables
from percept.sessions.quantities import Quantity
from percept.sessions.records import (
    IDS,
    MASS,
    SUMMARY_COLUMNS,
    Exclusion,
    Found,
    Notice,
    clip,
    shown,
)
from percept.sessions.tables import Log
from percept.sessions.values import fold, is_missing

#: Environments that a sentence lists.
_LISTED = 8
#: What tells a trial from others.
_TRIAL = [*IDS, "trial"]
#: Decades between adjustments and references from which on, either way, a unit is doubted.
_OTHER_UNIT = 2.0
#: What N/mm is in N/m, in decades: the slip of units there is. A median of a subject or file within
#: a factor of three of it is one.
_THOUSAND = 3.0
_ABOUT = float(np.log10(3.0))


def settle_names(table: pd.DataFrame, groups: Iterable[str], log: Log) -> None:
    """Write names that differ in spaces or Unicode form alone in the scene's or first spelling."""
    for column in (*IDS, *groups):
        names = table[column].unique()
        first: dict[str, str] = {}
        for name in [*log.options.environments, *names] if column == "environment" else names:
            first.setdefault(fold(name), name)
        spelled = {name: first[fold(name)] for name in names}
        for name, spelling in spelled.items():
            if name == spelling:
                continue
            file, row = log.place(table, (table[column] == name).idxmax())
            text = (
                f"{column} {spelling!r} is one name with another spelling in {file}:{row}: they"
                " differ in spaces, zero-width characters or Unicode form only"
            )
            log.notices.append(Notice(text))
        table[column] = table[column].map(spelled)


def settle_references(table: pd.DataFrame, quantities: Iterable[Quantity], log: Log) -> None:
    """Fill references from the scene or earlier rows, and hold an environment to one reference.

    Trials may keep references that they have of their own; of what is not matched they are zero.
    """
    options = log.options
    zeros = {f"{p}_ref": 0.0 for p, q in options.quantities.items() if not q.is_matched}
    environments = table["environment"]
    known = {name: options.environments.get(name, {}) | zeros for name in environments.unique()}
    without: dict[str, list[str]] = {}  # References that lack, by environment
    for column in [f"{quantity.name}_ref" for quantity in quantities] + [MASS] * (MASS in table):
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
        for name, rows in table[differs].groupby("environment", sort=False):
            source = "the scene" if name in given else "an earlier row"
            message = (
                f"environment {shown([str(name)])} has the reference {expected[rows.index[0]]!s} in"
                f" {source}, and another in {counted(len(rows), 'row')}, here the first."
            )
            hint = (
                "An environment has one reference. Correct it, or name the column that tells the"
                ' environments apart: environment = "…" in [columns]. If references differ by'
                ' trial, set [model] bias = "reference".'
            )
            value = float(rows[column].iloc[0])
            log.refuse(table, [Found(message, column, rows.index[0], value, hint)])
        if column == MASS:
            table[column] = expected.fillna(0.0)
            continue
        table[column] = expected
        lacking = expected.isna() & table[column.replace("_ref", "_adj")].notna()
        for name in environments[lacking].unique():
            without.setdefault(name, []).append(column)
    if without:
        _ask_for_references(without, known, log)


def _ask_for_references(
    without: Mapping[str, Sequence[str]], known: Mapping[str, Mapping[str, float]], log: Log
) -> None:
    """Refuse environments without a reference, with the lines that a scene needs."""
    lines = ["[environments]"]
    for name, columns in without.items():
        values = [f"{column} = {value!r}" for column, value in known[name].items()]
        values += [f'{column} = "?"' for column in columns]
        lines.append(f"{json.dumps(name, ensure_ascii=False)} = {{ {', '.join(values)} }}")
    message = f"{counted(len(without), 'environment')} without a reference: {shown(list(without))}."
    hint = "Write these lines in the scene, with a number in the place of each ?:\n"
    column = next(iter(without.values()))[0]
    log.add(message, column=column, hint=hint + "\n".join(lines))


def make_absolute(table: pd.DataFrame, quantities: Iterable[Quantity], log: Log) -> None:
    """Make adjustments of ratios to their references, and of differences from them."""
    for quantity in quantities:
        column = f"{quantity.name}_adj"
        rule = log.options.columns.get(column)
        if rule and rule.response == "ratio":
            table[column] *= table[f"{quantity.name}_ref"]
        elif rule and rule.response == "difference":
            table[column] += table[f"{quantity.name}_ref"]


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
        if not at_end.any():
            continue
        why = f"{quantity.label} at a limit of its control"
        rows = table[at_end]
        row: Any
        for row in rows.itertuples():
            what = f"{quantity.name} in environment {row.environment}"
            file = log.sources[row.file].name
            log.exclusions.append(Exclusion(row.subject, what, why, file, row.row))
        text = (
            f"{counted(len(rows), 'value')} of {table[column].notna().sum()} at the limits of the"
            f" control, {quantity.amount(lowest, highest)}, are left out:"
            f" {by_environment(table, at_end)}. Every interval describes the other values only"
        )
        log.notices.append(Notice(text, column=column))
        log.counts[f"left out: {why}"] = len(rows)
        log.at_limits.append(rows.assign(parameter=quantity.name))
        table = table.assign(**{column: table[column].mask(at_end)})
    if log.at_limits:
        adjusted = [f"{quantity.name}_adj" for quantity in quantities]
        table = table.dropna(subset=adjusted, how="all").reset_index(drop=True)
    if table.empty:
        hint = "Correct limits in [quantities]."
        raise UsageError("every adjustment lies at a limit of its control.", hint=hint)
    return table


def by_environment(table: pd.DataFrame, chosen: Any) -> str:
    """Count chosen trials per environment, such as "5 of 12 in 'hard' (3 subjects)"."""
    trials = table["environment"].value_counts()
    texts = []
    for name, rows in table[chosen].groupby("environment", sort=False):
        subjects = counted(rows["subject"].nunique(), "subject")
        texts.append(f"{len(rows)} of {trials[name]} in {clip(str(name))!r} ({subjects})")
    more = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return ", ".join(texts[:_LISTED]) + more


def count_grid(table: pd.DataFrame, quantities: Iterable[Quantity]) -> dict[str, int]:
    """Count observations, and the holes of the subject × environment × trial grid."""
    grid = table.groupby(["subject", "environment"], sort=False).size().unstack(fill_value=0)
    filled = grid.to_numpy()[grid > 0]
    counts = {
        "observations": len(table),
        "subjects": len(grid),
        "environments": len(grid.columns),
        "empty cells (subject × environment)": grid.size - len(filled),
        "missing repeats": int((filled.max() - filled).sum()),
    }
    for quantity in quantities:
        missing = table[f"{quantity.name}_adj"].isna()
        counts[f"rows without {quantity.name}"] = int(missing.sum())
    return counts


def repeats(table: pd.DataFrame, log: Log) -> Iterator[Found]:
    """Refuse rows that repeat what tells trials apart."""
    split = [name for name in log.options.split if name in table and name not in _TRIAL]
    cell = [*_TRIAL, *split]
    again = table.index[table.duplicated(cell)]
    if again.empty:
        return
    first = table.loc[again[0]]
    file, row = log.place(table, (table[cell] == first[cell]).all(axis=1).idxmax())
    names = ", ".join(f"{column} {shown([str(first[column])])}" for column in _TRIAL)
    text = (
        f"rows repeat a subject, session, environment and trial: {len(again):,} of {len(table):,}"
        f" ({len(again) / len(table):.1%}). The first: {names} is already in {file}:{row}."
    )
    hint = (
        "Remove it, or name the column of trial numbers in [columns]. Number the trials by the"
        ' order of their rows: [sessions] trial = "order". If rows are events of a trial,'
        f' [sessions] keep = "last" would keep {len(table) - len(again):,} rows. If they are'
        ' conditions of one subject, name their column: [study] factor = "…".'
    )
    yield Found(text, row=again[0], hint=hint)


def units(table: pd.DataFrame, quantities: Iterable[Quantity], log: Log) -> Iterator[Found]:
    """Refuse median ratios of adjustments to references beyond 100, and parts off by a thousand.

    Where the units of both columns are declared a notice says so instead.
    """
    for quantity in quantities:
        adj = f"{quantity.name}_adj"
        ref = f"{quantity.name}_ref"
        for row, decades, text in _other_units(table, adj, ref):
            if {adj, ref} <= log.declared_units:
                log.notices.append(Notice(text, column=adj))
                continue
            # A slip makes numbers too small where the larger unit was meant. One declared unit is
            # as likely to be the slip as the other column: it settles nothing.
            column = adj if decades < 0 else ref
            unit = quantity.unit.replace("/m", "/mm") or "…"
            hint = (
                f"Convert the file, or declare the units of both {adj} and {ref} in [columns],"
                f' such as {column} = {{ name = "…", unit = "{unit}" }}. If the numbers are right,'
                f" declare unit = {json.dumps(quantity.unit, ensure_ascii=False)} for both."
            )
            yield Found(text, adj, row, float(table[adj][row]), hint)


def _decades(numbers: pd.Series[float], references: pd.Series[float]) -> pd.Series[float]:
    """Ratios of numbers to their references in decades, where both are above zero."""
    both = (numbers > 0) & (references > 0)
    return numbers[both].transform(np.log10) - references[both].transform(np.log10)


def _other_units(table: pd.DataFrame, adj: str, ref: str) -> Iterator[tuple[int, float, str]]:
    """Find ratios that a wrong unit would explain, over all and by file or subject.

    Gives the first row, the ratio in decades, and what is wrong.
    """
    decades = _decades(table[adj], table[ref])
    both = table.loc[decades.index]
    typical = decades.median()
    if abs(typical) >= _OTHER_UNIT:
        text = f"{adj} is {10**typical:.3g} times {ref} at the median: their units seem to differ."
        yield int(both.index[0]), typical, text
    for column in ("file", "subject"):
        medians = decades.groupby(both[column], sort=False).median()
        off = medians[((medians - typical).abs() - _THOUSAND).abs() < _ABOUT]
        for name, median in off.items():
            where = "this file" if column == "file" else f"subject {shown([str(name)])}"
            text = (
                f"{adj} is {10**median:.3g} times {ref} at the median of {where}, and"
                f" {10**typical:.3g} times over all {column}s: the units of the {column} seem to"
                " differ by a thousand."
            )
            yield int(both.index[both[column] == name][0]), median, text
        if len(off):
            return


def remarks(table: pd.DataFrame, log: Log) -> Iterator[str]:
    """Name ids that look alike, or like a missing value."""
    for column in IDS:
        first = table[column].drop_duplicates()
        for name in filter(is_missing, first):
            placed = _placed(table, first, name, log)
            yield f"{column} {placed} is taken as a name: is it a missing value?"
        alike: dict[str, list[str]] = {}
        for name in first:
            alike.setdefault(_look(name), []).append(name)
        for names in alike.values():
            if len(names) > 1:
                listed = ", ".join(_placed(table, first, name, log) for name in names)
                yield (
                    f"{column}s {listed} look alike and are kept apart: if they are one, write them"
                    " alike in the files"
                )


def _placed(table: pd.DataFrame, first: pd.Series[str], name: str, log: Log) -> str:
    """Write a name with the file and row where it stands first."""
    file, row = log.place(table, first.index[first == name][0])
    return f"{clip(name)!r} ({file}:{row})"


def _look(name: str) -> str:
    """Reduce a name to its looks: "P_01" and "p1" are alike."""
    plain = unicodedata.normalize("NFKC", fold(name)).casefold()
    try:
        return f"{float(plain):.15g}"
    except ValueError:
        joined = re.sub(r"(?<=[^\W\d_])[\s_.-]+(?=\d)", "", plain)
        return re.sub(r"(?<!\d)0+(?=\d)", "", joined)


def summary(table: pd.DataFrame, options: DataTables) -> Iterator[Found]:
    """Refuse parameters, limits, n, levels and units that a published table cannot have."""
    names = " or ".join(f'"{name}"' for name in options.quantities)
    n = table["n"]
    level = table["level"]
    again = table.duplicated(["environment", "parameter"])
    rules: list[tuple[str, str, pd.Series[bool]]] = [
        ("parameter", f"must be {names}.", ~table["parameter"].isin(list(options.quantities))),
        ("environment", "is empty.", table["environment"].str.strip() == ""),
        (
            "upper",
            "is below the lower limit, or the SD is negative.",
            table["upper"] < table["lower"],
        ),
        (
            "n",
            "must be a whole number of at least 2, and below 2^53.",
            (n < 2) | (n >= 2.0**53) | (n % 1 > 0),
        ),
        ("level", "must lie between 0 and 1, as in 0.99.", (level <= 0) | (level >= 1)),
        ("environment", "a second row for this environment and parameter.", again),
    ]
    for column in SUMMARY_COLUMNS[2:]:
        rules.append((column, "a published table has no empty cells.", table[column].isna()))
    for column, message, wrong in rules:
        for row, value in table[column][wrong].items():
            shown_value = None if value != value else value
            yield Found(message, column, row, shown_value, "Correct or remove it.")
    cells: Any
    for cells in table.itertuples():
        references = options.environments.get(cells.environment, {})
        expected = references.get(f"{cells.parameter}_ref", cells.reference)
        if cells.reference != expected:
            message = (
                f"[environments] gives {shown([cells.environment])} the reference {expected:g}."
            )
            hint = "Correct the table or the scene."
            yield Found(message, "reference", cells.Index, cells.reference, hint)
    # Of what the limits hold, the nearest to the reference: wide limits are no sign of another
    # unit.
    near = table["reference"].clip(table["lower"], table["upper"])
    for name, rows in _decades(near, table["reference"]).groupby(table["parameter"], sort=False):
        decades = rows.median()
        if name in options.quantities and abs(decades) >= _OTHER_UNIT:
            message = (
                f"limits of {name} are typically {10**decades:.3g} times the reference: their units"
                " seem to differ."
            )
            hint = f"Write references and limits in {options.quantities[name].unit or 'one unit'}."
            first = rows.index[0]
            yield Found(message, "reference", first, float(table["reference"][first]), hint)
