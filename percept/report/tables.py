"""The tables of a report as CSV: every digit of a double, units in the heads, and nothing that runs."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

from percept.report.select import METHODS, matching
from percept.results import Boundary, Confidences, PosteriorEvidence, Results, Verdict

__all__ = ["csv_tables"]

_INTERVAL = (
    "environment", "kind", "method", "family", "joint", "level", "share", "confidence", "lower",
    "upper", "estimate", "reference", "n", "covers",
)  # fmt: skip
_DATA = ("environment", "n", "reference", "mean", "sd")
_BAND = ("environment", "method", "kind", "family")
_REFERENCE_BAND = (*_BAND, "reference", "band", "relative")
_IMPEDANCE_BAND = (*_BAND, "impedance", "band", "relative")
_CURVE = ("environment", "kind", "method", "family", "joint", "shape", "level")
_IMPEDANCE_UNIT = "N·s/m"
#: Beginnings of what a spreadsheet runs, spaces before them passed over; some take wide forms too.
_FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")
#: Columns in the unit of their table; heads name it.
_IN_UNIT = ("lower", "upper", "estimate", "reference", "mean", "sd", "coupled", "impedance", "band")


def csv_tables(results: Results) -> dict[str, str]:
    """Return the tables of a report by file name.

    Parameters
    ----------
    results : Results
        What the tables are of.

    Returns
    -------
    dict of str to str
        CSV; a table without rows is absent.
    """
    tables: dict[str, str] = {}
    bands = results.band.rows if results.band is not None else ()
    for name, quantity in results.data.quantities.items():
        intervals = matching(results.intervals, parameter=name)
        cells = matching(results.data.cells, parameter=name)
        widths = matching(bands, parameter=name)
        tables[f"intervals_{name}"] = _table(intervals, _INTERVAL, quantity.unit)
        tables[f"data_{name}"] = _table(cells, _DATA, quantity.unit)
        tables[f"band_{name}"] = _table(widths, _REFERENCE_BAND, quantity.unit)
    impedances = matching(bands, parameter=None)
    tables["band"] = _table(impedances, _IMPEDANCE_BAND, _IMPEDANCE_UNIT)
    tables["boundaries"] = _curves(results.boundaries)
    tables["contrast"] = _all_fields(results.contrast)
    tables["comparison"] = _all_fields(results.comparison or ())
    tables["memberships"] = _all_fields(results.coupling.memberships if results.coupling else ())
    tables["verdicts"] = _verdicts(results.verdicts)
    return {f"{name}.csv": text for name, text in tables.items() if text}


def _all_fields(records: Sequence[Any]) -> str:
    """Write every field of records."""
    names = [field.name for field in dataclasses.fields(records[0])] if records else []
    return _table(records, names)


def _verdicts(verdicts: Sequence[Verdict]) -> str:
    """Write a row per verdict, what each method found in columns of its name."""
    own = [field.name for field in dataclasses.fields(Verdict)]
    own = [name for name in own if name not in METHODS]
    evidence = [field.name for field in dataclasses.fields(PosteriorEvidence)]
    confidences = [field.name for field in dataclasses.fields(Confidences)]
    heads = [*own, *(f"bayesian_{name}" for name in evidence)]
    heads += [f"classical_{name}" for name in confidences]
    rows = []
    for verdict in verdicts:
        row = [getattr(verdict, name) for name in own]
        row += [getattr(verdict.bayesian, name, None) for name in evidence]
        row += [getattr(verdict.classical, name, None) for name in confidences]
        rows.append(row)
    return _csv(heads, rows) if rows else ""


def _table(records: Sequence[Any], names: Sequence[str], unit: str = "") -> str:
    """Write fields of records, a record a row; empty without records."""
    rows = ([getattr(record, name) for name in names] for record in records)
    return _csv(_heads(names, unit), rows) if records else ""


def _curves(boundaries: Sequence[Boundary]) -> str:
    """Write a row per curve and frequency; empty without boundaries."""
    curves = ("lower", "upper", "reference", "coupled")
    rows: list[list[Any]] = []
    for boundary in boundaries:
        labels = [getattr(boundary, name) for name in _CURVE]
        columns = [boundary.omega.tolist()]
        for name in curves:
            curve = getattr(boundary, name)
            columns.append([None] * len(boundary.omega) if curve is None else curve.tolist())
        rows += [[*labels, *point] for point in zip(*columns, strict=True)]
    heads = [*_CURVE, "omega (rad/s)", *_heads(curves, _IMPEDANCE_UNIT)]
    return _csv(heads, rows) if rows else ""


def _heads(names: Sequence[str], unit: str) -> list[str]:
    """Name columns, with the unit of those that have one."""
    return [f"{name} ({unit})" if unit and name in _IN_UNIT else name for name in names]


def _csv(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    """Write a value: nothing for None and NaN, and what a spreadsheet would run as text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, tuple):
        value = "; ".join(map(str, value))
    if not isinstance(value, str):
        return value
    runs = value.lstrip().startswith(_FORMULA) or value.startswith(("\t", "\r"))
    return f"'{value}" if runs else value
