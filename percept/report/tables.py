"""The tables of a report as CSV: records as report.json has them, with all their digits."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from percept.files import inert
from percept.results import Results


def csv_tables(results: Results) -> dict[str, str]:
    """Return the tables of a report by file name.

    Parameters
    ----------
    results : Results
        What the tables are of.

    Returns
    -------
    dict of str to str
        CSV with a row per record, or per frequency of a curve. Columns are called as the fields of
        report.json; a field of a record within a record as PART_FIELD. A table without rows is
        absent.
    """
    tables: dict[str, Sequence[object]] = {
        "intervals": results.intervals,
        "data": results.data.cells,
        "subjects": results.data.people,
        "boundaries": results.boundaries,
        "band": results.band.rows if results.band else (),
        "band_pairs": results.band_pairs or (),
        "psychophysics": results.psychophysics,
        "equivalence": results.equivalence,
        "contrast": results.contrast,
        "anova": results.anova,
        "memberships": results.coupling.memberships if results.coupling else (),
        "verdicts": results.verdicts,
        "rendering": results.rendering or (),
    }
    return {f"{name}.csv": _csv(records) for name, records in tables.items() if records}


def _csv(records: Sequence[object]) -> str:
    """Write records; columns that only some of them have stand where they first come."""
    rows = [dict(_flat(record)) for record in records]
    heads = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    for row in rows:
        curves = {name: one for name, one in row.items() if isinstance(one, np.ndarray)}
        if not curves:
            writer.writerow([_cell(row.get(name)) for name in heads])
            continue
        cells = {name: _cell(one) for name, one in row.items() if name not in curves}
        for point in zip(*(curve.tolist() for curve in curves.values()), strict=True):
            numbers = dict(zip(curves, map(_cell, point), strict=True))
            writer.writerow([(cells | numbers).get(name) for name in heads])
    return text.getvalue()


def _flat(record: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    """Give the fields of a record, and of records in it, by name."""
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        name = f"{before}{field.name}"
        if isinstance(value, np.ndarray) and value.ndim > 1:
            for index, curve in enumerate(value):
                yield f"{name}_{index}", curve
        elif dataclasses.is_dataclass(value):
            yield from _flat(value, f"{name}_")
        elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
            for index, part in enumerate(value):
                yield from _flat(part, f"{name}_{index}_")
        else:
            yield name, value


def _cell(value: object) -> object:
    """Write a value: nothing for None and NaN, and what a spreadsheet would run as text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, tuple):
        value = "; ".join(map(str, value))
    return inert(value) if isinstance(value, str) else value
