"""A table with a row per subject: its columns hold the adjustments to one environment each."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from percept.sessions.evidence import Column
from percept.sessions.roles import MOST_QUANTITIES, NOT_ADJUSTED, is_order

__all__ = ["Wide", "wide_quantities"]

#: Ratio of medians from which on columns of numbers are not of one scale.
_OTHER_SCALE = 10.0


@dataclass(frozen=True)
class Wide:
    """Columns that each hold the adjustments to one environment, in a row per subject."""

    pattern: str  # Of their names
    columns: Mapping[str, Column]  # By environment


def wide_quantities(free: Iterable[Column]) -> dict[str, Wide]:
    """Find the quantities of a wide table among columns without a part; empty if it is none."""
    columns = _columns_of_numbers(free)
    if len(columns) < 2:
        return {}
    quantities = {}
    for stem, by_environment in _by_stem(columns).items():
        name = stem.casefold()
        if re.fullmatch("[a-z][a-z0-9]*(_[a-z0-9]+)*", name):
            first = next(iter(by_environment.values()))
            quantities[name] = Wide(f"{_stem(first)}{{environment}}", by_environment)
    if not quantities and _is_of_one_scale(columns):
        quantities["response"] = _one_quantity(columns)
    return quantities


def _one_quantity(columns: Sequence[Column]) -> Wide:
    """Take all columns for one quantity, each for an environment."""
    names = [column.name for column in columns]
    shared = os.path.commonprefix(names)  # noqa: RUF071 (no paths)
    # A prefix ends at a separator: "in" of "india" and "indonesia" is part of both names.
    prefix = re.sub(r"[^_. -]*$", "", shared)
    environments = {column.name.removeprefix(prefix): column for column in columns}
    return Wide(f"{prefix}{{environment}}", environments)


def _columns_of_numbers(columns: Iterable[Column]) -> list[Column]:
    """Give the columns of numbers that may each hold the adjustments to one environment."""
    columns = [column for column in columns if column.is_numeric]
    columns = [column for column in columns if not NOT_ADJUSTED & set(column.words)]
    stems = [_stem(column) for column in columns]
    kept = []
    for column, stem in zip(columns, stems, strict=True):
        # Few adjustments may rise by chance; a name of the same series goes before.
        if stems.count(stem) > 1 or not is_order(column):
            kept.append(column)
    return kept


def _stem(column: Column) -> str:
    """Name of a column without the number at its end."""
    return re.sub(r"(?<=[a-zA-Z_. -])\d+$", "", column.name)


def _is_of_one_scale(columns: Sequence[Column]) -> bool:
    """Whether columns of numbers may hold one quantity: their medians are of one size."""
    sizes = np.array([np.nanmedian(np.abs(column.numbers)) for column in columns])
    sizes = sizes[sizes > 0]
    return not len(sizes) or float(sizes.max() / sizes.min()) < _OTHER_SCALE


def _by_stem(columns: Sequence[Column]) -> dict[str, dict[str, Column]]:
    """Part columns such as "wl1", "wl2", "se1", "se2" by stem, then by number.

    Empty unless each stem has the same numbers and values apart from the others' values.
    """
    stems: dict[str, dict[str, Column]] = {}
    for column in columns:
        parts = re.fullmatch(r"(\w*[a-zA-Z])[_. -]?(\d+)", column.name)
        if parts is None:
            return {}
        stems.setdefault(parts[1], {})[parts[2]] = column
    numbers = {tuple(by_number) for by_number in stems.values()}
    if len(numbers) > 1 or not 2 <= len(stems) <= MOST_QUANTITIES:
        return {}
    ranges = []
    for by_number in stems.values():
        values = np.concatenate([column.numbers for column in by_number.values()])
        ranges.append((np.nanmin(values), np.nanmax(values)))
    ranges.sort()
    # Values that overlap are of one quantity, and the stems are conditions.
    if any(lower[1] >= higher[0] for lower, higher in pairwise(ranges)):
        return {}
    return stems
