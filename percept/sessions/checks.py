"""What makes a study unreadable though each of its files can be read.

Each check gives what it finds in the table; `Log.refuse` takes it up with its file and line.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd

from percept.sessions.options import ReadOptions
from percept.sessions.quantities import Quantity
from percept.sessions.records import IDS, Found, Notice, shown
from percept.sessions.tables import Log

#: What tells a trial from others.
TRIAL = [*IDS, "trial"]
#: From this ratio of adjustments to references on, either way, a unit is doubted.
_OTHER_UNIT = 100.0
#: What N/mm is in N/m: the slip of units there is. A median of a subject or file within a factor of
#: three of it is one.
_THOUSAND = 1000.0
_ABOUT = 3.0
#: A whole turn in units of angles.
_TURNS = {"deg": 360.0, "°": 360.0, "degree": 360.0, "degrees": 360.0}
_TURNS |= dict.fromkeys(("rad", "radian", "radians"), 2 * np.pi)


def angles(table: pd.DataFrame, parameters: Iterable[str], options: ReadOptions) -> Iterator[Found]:
    """Refuse angles beyond half a turn, which have no mean: 350 and 10 deg lie beside each other.

    Differences from the references within half a turn are none.
    """
    for p in parameters:
        quantity = options.quantities[p]
        turn = _TURNS.get(quantity.unit.casefold())
        if turn is None:
            continue
        rule = options.columns.get(f"{p}_adj")
        if rule is not None and rule.response == "difference":
            yield from _far_differences(table, quantity, turn / 2)
        else:
            yield from _whole_turns(table, quantity, turn / 2)


def _whole_turns(table: pd.DataFrame, quantity: Quantity, half: float) -> Iterator[Found]:
    """Find references, or adjustments about them, that reach beyond half a turn."""
    name = f"{quantity.name}_adj"
    pairs = table[[f"{quantity.name}_ref", name]].dropna().to_numpy(dtype=float)
    if not len(pairs):
        return
    references = pairs[:, 0]
    which = "adjustments lie"
    if max(np.ptp(references), np.abs(references).max()) > half:
        which = "references reach"
    elif np.abs(pairs[:, 1] - references).max() <= half:
        return
    message = (
        f"{quantity.label} in {quantity.unit} wraps: {which} beyond half a turn,"
        f" {half:.4g} {quantity.unit}."
    )
    hint = (
        f"Give {name} a column of adjusted − reference, within half a turn:"
        f' {name} = {{ name = "…", response = "difference" }} in [columns].'
        " If the knob can turn more than once its angle does not wrap: give it in turns,"
        ' unit = "turn".'
    )
    yield Found(message, name, hint=hint)


def _far_differences(table: pd.DataFrame, quantity: Quantity, half: float) -> Iterator[Found]:
    """Find the first difference that goes the long way round."""
    column = f"{quantity.name}_adj"
    far = table[column][table[column].abs() > half]
    if len(far):
        unit = quantity.unit
        message = f"a difference of more than half a turn, {half:.4g} {unit}; {len(far)} in all."
        hint = f"Add or subtract {2 * half:.4g} {unit}."
        yield Found(message, column, int(far.index[0]), float(far.iloc[0]), hint)


def repeats(table: pd.DataFrame, cell: list[str], log: Log, telling: Sequence[str]) -> Found:
    """Say that rows repeat what tells trials apart; there are some.

    Each of the columns `telling` would tell all of them apart.
    """
    again = table.index[table.duplicated(cell)]
    count = len(again)
    first = table.loc[again[0]]
    origin = log.places(table)(int(np.argmax((table[cell] == first[cell]).all(axis=1))))
    names = ", ".join(f"{column} {shown([str(first[column])])}" for column in IDS)
    where = f"{origin.get('file')}:{origin.get('row')}"
    text = f"{names}, trial {first['trial']} is already in {where}."
    if count > 1 or not log.numbered:
        what = "trial" if log.numbered else "environment, and no column numbers their trials"
        share = f"{count:,} of {len(table):,} rows ({count / len(table):.1%})"
        text = f"{share} repeat a subject, session and {what}. The first: {text}"
    # Without numbers it would keep one trial per cell, and drop the repeats.
    event = f"keep {len(table) - count:,} rows" if log.numbered else "need a column of trials"
    conditions = 'If they are conditions of one subject, name their column: [study] factor = "…".'
    if telling:
        several = "each of the columns" if len(telling) > 1 else "column"
        conditions = (
            f"For conditions of one subject, {several} {shown(telling)} tells them apart:"
            f' [study] factor = "{telling[0]}".'
        )
    hints = [
        "Remove one row, or name the column of trial numbers in [columns].",
        'Number the trials by the order of their rows: [sessions] trial = "order".',
        f'If rows are events of a trial, [sessions] keep = "last" would {event}.',
        conditions,
    ]
    return Found(text, row=again[0], hint=" ".join(hints[not log.numbered :]))


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
    """Median of ratios; 1 without any."""
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
        for name, own in off.items():
            where = "this file" if column == "file" else f"subject {shown([str(name)])}"
            text = (
                f"{adj} is {own:.3g} times {ref} at the median of {where}, and"
                f" {ratio:.3g} times over all {column}s: the units of the {column} seem to differ"
                " by a thousand."
            )
            yield int(both.index[both[column] == name][0]), own, text
        if len(off):
            return


def summary(table: pd.DataFrame, options: ReadOptions) -> Iterator[Found]:
    """Refuse parameters, limits, n, levels and units that a published table cannot have."""
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
        for row in table.index[wrong]:
            yield Found(message, column, row, table[column].tolist()[row], "Correct or remove it.")
    cells = zip(table["environment"], table["parameter"], table["reference"], strict=True)
    for row, (environment, parameter, reference) in enumerate(cells):
        own = options.environments.get(environment, {})
        expected = own.get(f"{parameter}_ref", reference)
        if reference != expected:
            message = f"[environments] gives {shown([environment])} the reference {expected:g}."
            yield Found(message, "reference", row, reference, "Correct the table or the scene.")
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
            row = int(references.index[0])
            yield Found(message, "reference", row, float(references[row]), hint)
