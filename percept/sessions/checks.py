"""What makes a study unreadable though each of its files can be read, and what is said of names.

Each check gives what it finds in the table; `Log.refuse` takes it up with its file and line.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd

from percept.sessions.options import ReadOptions
from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, Found, Notice, clip, shown
from percept.sessions.tables import Log
from percept.sessions.values import fold, is_missing

#: What tells a trial from others.
_TRIAL = [*IDS, "trial"]
#: From this ratio of adjustments to references on, either way, a unit is doubted.
_OTHER_UNIT = 100.0
#: What N/mm is in N/m: the slip of units there is. A median of a subject or file within a factor of
#: three of it is one.
_THOUSAND = 1000.0
_ABOUT = 3.0
#: A whole turn in units of angles.
_TURNS = dict.fromkeys(("deg", "°", "degree", "degrees"), 360.0)
_TURNS |= dict.fromkeys(("rad", "radian", "radians"), 2 * np.pi)


def angles(
    table: pd.DataFrame, quantities: Iterable[Quantity], options: ReadOptions
) -> Iterator[Found]:
    """Refuse angles beyond half a turn, which have no mean: 350 and 10 deg lie beside each other.

    Differences from the references within half a turn are none.
    """
    for quantity in quantities:
        name = f"{quantity.name}_adj"
        unit = quantity.unit
        half = _TURNS.get(unit.casefold(), np.inf) / 2
        adjusted = table[name]
        rule = options.columns.get(name)
        if rule is not None and rule.response == "difference":
            far = adjusted[adjusted.abs() > half]
            if len(far):
                message = f"a difference of more than half a turn, {half:.4g} {unit}"
                message += f"; {len(far)} in all."
                hint = f"Add or subtract {2 * half:.4g} {unit}."
                yield Found(message, name, far.index[0], float(far.iloc[0]), hint)
            continue
        references = table[f"{quantity.name}_ref"][adjusted.notna()].dropna()
        if references.empty:
            continue
        which = "adjustments lie"
        if max(np.ptp(references), references.abs().max()) > half:
            which = "references reach"
        elif (adjusted - references).abs().max() <= half:
            continue
        message = (
            f"{quantity.label} in {unit} wraps: {which} beyond half a turn, {half:.4g} {unit}."
        )
        hint = (
            f"Give {name} a column of adjusted − reference, within half a turn:"
            f' {name} = {{ name = "…", response = "difference" }} in [columns].'
            " If the knob can turn more than once its angle does not wrap: give it in turns,"
            ' unit = "turn".'
        )
        yield Found(message, name, hint=hint)


def repeats(table: pd.DataFrame, log: Log) -> Iterator[Found]:
    """Refuse rows that repeat what tells trials apart."""
    split = [name for name in log.options.split if name in table and name not in _TRIAL]
    cell = [*_TRIAL, *split]
    again = table.index[table.duplicated(cell)]
    count = len(again)
    if not count:
        return
    first = table.loc[again[0]]
    file, row = log.place(table, (table[cell] == first[cell]).all(axis=1).idxmax())
    names = ", ".join(f"{column} {shown([str(first[column])])}" for column in IDS)
    text = f"{names}, trial {first['trial']} is already in {file}:{row}."
    if count > 1 or not log.numbered:
        what = "trial" if log.numbered else "environment, and no column numbers their trials"
        share = f"{count:,} of {len(table):,} rows ({count / len(table):.1%})"
        text = f"{share} repeat a subject, session and {what}. The first: {text}"
    # Without numbers it would keep one trial per cell, and drop the repeats.
    event = f"keep {len(table) - count:,} rows" if log.numbered else "need a column of trials"
    hints = [
        "Remove one row, or name the column of trial numbers in [columns].",
        'Number the trials by the order of their rows: [sessions] trial = "order".',
        f'If rows are events of a trial, [sessions] keep = "last" would {event}.',
        'If they are conditions of one subject, name their column: [study] factor = "…".',
    ]
    yield Found(text, row=again[0], hint=" ".join(hints[not log.numbered :]))


def units(table: pd.DataFrame, quantities: Iterable[Quantity], log: Log) -> Iterator[Found]:
    """Refuse median ratios of adjustments to references beyond 100, and parts off by a thousand.

    Where the units of both columns are declared a notice says so instead.
    """
    for quantity in quantities:
        adj = f"{quantity.name}_adj"
        ref = f"{quantity.name}_ref"
        for row, ratio, text in _other_units(table, adj, ref):
            if {adj, ref} <= log.declared_units:
                log.notices.append(Notice(text, column=adj))
                continue
            # A slip makes numbers too small where the larger unit was meant. One declared unit is
            # as likely to be the slip as the other column: it settles nothing.
            column = adj if ratio < 1 else ref
            unit = quantity.unit.replace("/m", "/mm") or "…"
            hint = (
                f"Convert the file, or declare the units of both {adj} and {ref} in [columns],"
                f' such as {column} = {{ name = "…", unit = "{unit}" }}. If the numbers are right,'
                f" declare unit = {json.dumps(quantity.unit, ensure_ascii=False)} for both."
            )
            yield Found(text, adj, row, float(table[adj][row]), hint)


def _typical(ratios: pd.Series[float]) -> float:
    """Median of ratios from their logarithms; 1 without any."""
    return float(np.exp(ratios.median())) if len(ratios) else 1.0


def _other_units(table: pd.DataFrame, adj: str, ref: str) -> Iterator[tuple[int, float, str]]:
    """Find ratios that a wrong unit would explain, over all and by file or subject.

    Gives the first row, the ratio, and what is wrong.
    """
    both = table[(table[adj] > 0) & (table[ref] > 0)]
    ratios = np.log(both[adj]) - np.log(both[ref])
    ratio = _typical(ratios)
    if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        text = f"{adj} is {ratio:.3g} times {ref} at the median: their units seem to differ."
        yield int(both.index[0]), ratio, text
    for column in ("file", "subject"):
        medians = np.exp(ratios.groupby(both[column], sort=False).median())
        factors = np.maximum(medians / ratio, ratio / medians)
        off = medians[(factors > _THOUSAND / _ABOUT) & (factors < _THOUSAND * _ABOUT)]
        for name, median in off.items():
            where = "this file" if column == "file" else f"subject {shown([str(name)])}"
            text = (
                f"{adj} is {median:.3g} times {ref} at the median of {where}, and"
                f" {ratio:.3g} times over all {column}s: the units of the {column} seem to differ"
                " by a thousand."
            )
            yield int(both.index[both[column] == name][0]), median, text
        if len(off):
            return


def remarks(table: pd.DataFrame, log: Log) -> Iterator[str]:
    """Name ids that look alike or like a missing value, and cells of several sessions."""
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
    counts = table.groupby(["subject", "environment"], sort=False)["session"].nunique()
    several = int((counts > 1).sum())
    if several:
        yield (
            f"{several} of {counts.size} cells (a subject in an environment) have trials of several"
            " sessions. All count as repeats: changes between sessions are part of the scatter of"
            " trials"
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


def summary(table: pd.DataFrame, options: ReadOptions) -> Iterator[Found]:
    """Refuse parameters, limits, n, levels and units that a published table cannot have."""
    names = " or ".join(f'"{name}"' for name in options.quantities)
    n = table["n"]
    level = table["level"]
    whole = (n >= 2) & (n < 2.0**53) & (n == np.round(n))
    again = table.duplicated(["environment", "parameter"])
    rules: Sequence[tuple[str, str, pd.Series[bool]]] = [
        ("parameter", f"must be {names}.", ~table["parameter"].isin(list(options.quantities))),
        ("environment", "is empty.", table["environment"].str.strip() == ""),
        ("upper", "is below the lower limit.", table["upper"] < table["lower"]),
        ("n", "must be a whole number of at least 2, and below 2^53.", ~whole),
        ("level", "must lie between 0 and 1, as in 0.99.", (level <= 0) | (level >= 1)),
        ("environment", "a second row for this environment and parameter.", again),
    ]
    for column, message, wrong in rules:
        for row, value in table[column][wrong].items():
            yield Found(message, column, row, value, "Correct or remove it.")
    cells = zip(table["environment"], table["parameter"], table["reference"], strict=True)
    for index, (environment, parameter, reference) in enumerate(cells):
        in_scene = options.environments.get(environment, {})
        expected = in_scene.get(f"{parameter}_ref", reference)
        if reference != expected:
            message = f"[environments] gives {shown([environment])} the reference {expected:g}."
            yield Found(message, "reference", index, reference, "Correct the table or the scene.")
    # Of what the limits hold, the nearest to the reference: wide limits are no sign of another
    # unit.
    near = table["reference"].clip(table["lower"], table["upper"])
    for name, quantity in options.quantities.items():
        rows = (table["parameter"] == name) & (near > 0) & (table["reference"] > 0)
        references = table["reference"][rows]
        ratio = _typical(np.log(near[rows]) - np.log(references))
        if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
            message = (
                f"limits of {name} are typically {ratio:.3g} times the reference: their units seem"
                " to differ."
            )
            hint = f"Write references and limits in {quantity.unit or 'one unit'}."
            value = float(references.iloc[0])
            yield Found(message, "reference", references.index[0], value, hint)
