"""What a table holds by mistake: codes for missing values, and subjects that stand in it twice.

Each check looks at the trials of a study and gives notices, with the rule that leaves rows out.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd

from percept.errors import counted
from percept.sessions.quantities import Quantity
from percept.sessions.records import Notice, Places, shown

__all__ = ["faults", "missing_codes"]

#: Numbers that stand for a missing value: -999, 9999 and others of nines, in any unit.
_CODE = re.compile(r"99+0*")
#: Equal settings, and different ones among them, from which on two subjects are hardly two people.
_EQUAL = 4
_DIFFERENT = 3


def faults(table: pd.DataFrame, quantities: Sequence[Quantity], place: Places) -> Iterator[Notice]:
    """Give what each check finds in a table of trials."""
    for check in _CHECKS:
        yield from check(table, quantities, place)


def missing_codes(values: pd.Series[float]) -> list[float]:
    """Give the numbers, at either end of all values, that seem to stand for a missing one."""
    codes = []
    for code in (values.min(), values.max()):
        others = values[values != code]
        if others.empty or not _CODE.fullmatch(f"{abs(code):.12g}"):
            continue
        reach = others.max() - others.min()
        alone_below = code < 0 <= others.min()
        if alone_below or not others.min() - reach <= code <= others.max() + reach:
            codes.append(float(code))
    return codes


def _codes(table: pd.DataFrame, quantities: Sequence[Quantity], place: Places) -> Iterator[Notice]:
    """Ask whether a number is a code for a missing value."""
    for quantity in quantities:
        column = f"{quantity.name}_adj"
        for code in missing_codes(table[column].dropna()):
            rows = table.index[table[column] == code]
            limit = f"below = {code + 0.5!r}" if code < 0 else f"above = {code - 0.5!r}"
            rule = f'{{ column = "{column}", {limit}, why = "missing" }}'
            verb = "is" if len(rows) == 1 else "are"
            text = (
                f"{counted(len(rows), 'value')} of {quantity.name} {verb} {code:g}: a code for a"
                f" missing value? Then [sessions] exclude = [{rule}] leaves such rows out."
            )
            yield Notice(text, column=column, **place(rows[0]))


def _copies(table: pd.DataFrame, quantities: Sequence[Quantity], place: Places) -> Iterator[Notice]:
    """Name subjects whose settings are those of another subject, value by value."""
    columns = [f"{quantity.name}_adj" for quantity in quantities]
    ordered = table.sort_values(["environment", "session", "trial"], kind="stable")
    first_of: dict[tuple[object, ...], str] = {}
    for subject, rows in ordered.groupby("subject", sort=False):
        settings = rows[columns].to_numpy(dtype=float)
        known = settings[~np.isnan(settings)]
        if len(known) < _EQUAL or len(np.unique(known)) < _DIFFERENT:
            continue
        first = first_of.setdefault((*rows["environment"], settings.tobytes()), str(subject))
        if first == subject:
            continue
        name = json.dumps(str(subject), ensure_ascii=False)
        rule = f'{{ column = "subject", equals = {name}, why = "a copy" }}'
        text = (
            f"subjects {shown([first])} and {shown([str(subject)])} have the same {len(known)}"
            f" settings: a copy? Then [sessions] exclude = [{rule}] leaves it out."
        )
        yield Notice(text, column="subject", **place(rows.index.min()))


#: From trials, their quantities and the places of rows to notices.
_CHECKS: tuple[Callable[[pd.DataFrame, Sequence[Quantity], Places], Iterator[Notice]], ...] = (
    _codes,
    _copies,
)
