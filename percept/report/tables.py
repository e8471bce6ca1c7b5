"""The tables of a report as CSV: all digits, units in the heads, and nothing that runs."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Sequence

import numpy as np

from percept.boundary.feels_real import CENTRALS
from percept.files import inert
from percept.report.select import matching
from percept.results import BandPair, Boundary, Confidences, PosteriorEvidence, Results, Verdict

__all__ = ["csv_tables"]

_INTERVAL = (
    "environment", "kind", "method", "family", "joint", "level", "share", "confidence", "lower",
    "upper", "estimate", "reference", "n", "left_out", "covers",
)  # fmt: skip
_DATA = ("environment", "n", "reference", "mean", "sd")
_BAND = ("environment", "method", "family")
_REFERENCE_BAND = (*_BAND, "reference", "band", "relative")
_IMPEDANCE_BAND = (*_BAND, "impedance", "band", "relative")
_CURVE = ("environment", "kind", "method", "family", "joint", "shape", "level")
_IMPEDANCE_UNIT = "N·s/m"
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
    bands = results.band.rows if results.band else ()
    memberships = results.coupling.memberships if results.coupling else ()
    for name, quantity in results.data.quantities.items():
        unit = quantity.unit
        intervals = matching(results.intervals, parameter=name)
        cells = matching(results.data.cells, parameter=name)
        widths = matching(bands, parameter=name)
        matched = quantity.is_matched
        tables[f"intervals_{name}"] = _table(intervals, _about(_INTERVAL, matched), unit)
        tables[f"data_{name}"] = _table(cells, _about(_DATA, matched), unit)
        tables[f"band_{name}"] = _table(widths, _REFERENCE_BAND, unit)
    impedances = matching(bands, parameter=None)
    tables["band"] = _table(impedances, _IMPEDANCE_BAND, _IMPEDANCE_UNIT)
    tables["subjects"] = _all_fields(results.data.people)
    tables["boundaries"] = _curves(results.boundaries)
    tables["psychophysics"] = _all_fields(results.psychophysics)
    tables["pse_lines"] = _all_fields(results.pse_lines)
    tables["equivalence"] = _all_fields(results.equivalence)
    tables["contrast"] = _all_fields(results.contrast)
    tables["anova"] = _all_fields(results.anova)
    tables["band_pairs"] = _band_pairs(results.band_pairs or ())
    tables["memberships"] = _all_fields(memberships)
    tables["verdicts"] = _verdicts(results.verdicts)
    return {f"{name}.csv": text for name, text in tables.items() if text}


def _about(columns: Sequence[str], is_matched: bool) -> list[str]:
    """Leave out the reference of what was not matched."""
    return [column for column in columns if is_matched or column != "reference"]


def _all_fields(records: Sequence[object]) -> str:
    """Write every field of records; empty without records."""
    if not records:
        return ""
    return _table(records, list(vars(records[0])))


def _band_pairs(pairs: Sequence[BandPair]) -> str:
    """Write a row per pair of bands, each measure in columns of its name."""
    rows = []
    for pair in pairs:
        row = dict(vars(pair))
        for measure in ("place", "width"):
            difference = row.pop(measure)
            for name, value in vars(difference).items():
                row[f"{measure}_{name}"] = value
        rows.append(row)
    if not rows:
        return ""
    return _csv(list(rows[0]), [list(row.values()) for row in rows])


def _verdicts(verdicts: Sequence[Verdict]) -> str:
    """Write a row per verdict, what each method found in columns of its name."""
    rows = []
    for verdict in verdicts:
        row = dict(vars(verdict))
        del row["leaning"]
        more = row.pop("more")
        row["more_subjects"] = None if more is None else more.subjects
        for method, record in (("bayesian", PosteriorEvidence), ("classical", Confidences)):
            evidence = row.pop(method)
            for field in dataclasses.fields(record):
                row[f"{method}_{field.name}"] = getattr(evidence, field.name, None)
        others = row.pop("bayesian_by_central") or ()
        by_central = {other.central: other.probability for other in others}
        for central in CENTRALS:
            row[f"bayesian_central_{central:g}"] = by_central.get(central)
        rows.append(row)
    if not rows:
        return ""
    return _csv(list(rows[0]), [list(row.values()) for row in rows])


def _table(records: Sequence[object], names: Sequence[str], unit: str = "") -> str:
    """Write fields of records, a record a row; empty without records."""
    if not records:
        return ""
    rows = []
    for record in records:
        rows.append([getattr(record, name) for name in names])
    return _csv(_heads(names, unit), rows)


def _curves(boundaries: Sequence[Boundary]) -> str:
    """Write a row per curve and frequency; empty without boundaries."""
    if not boundaries:
        return ""
    heads = _heads(("lower", "upper", "reference", "coupled"), _IMPEDANCE_UNIT)
    lines = [_csv([*_CURVE, "omega (rad/s)", *heads], [])]
    for boundary in boundaries:
        labels = _csv([_cell(getattr(boundary, name)) for name in _CURVE], []).rstrip("\n")
        columns = [boundary.omega, boundary.lower, boundary.upper, boundary.reference]
        if boundary.coupled is None:
            columns.append(np.full_like(boundary.omega, np.nan))
        else:
            columns.append(boundary.coupled)
        for point in np.column_stack(columns).tolist():
            numbers = ",".join(map(_number, point))
            lines.append(f"{labels},{numbers}\n")
    return "".join(lines)


def _number(value: float) -> str:
    """Write a double with every digit; empty for one that is missing."""
    return "" if math.isnan(value) else repr(value)


def _heads(names: Sequence[str], unit: str) -> list[str]:
    """Name columns, with the unit of those that have one."""
    return [f"{name} ({unit})" if unit and name in _IN_UNIT else name for name in names]


def _csv(heads: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    for row in rows:
        writer.writerow([_cell(value) for value in row])
    return text.getvalue()


def _cell(value: object) -> object:
    """Write a value: nothing for None and NaN, and what a spreadsheet would run as text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, tuple):
        value = "; ".join(map(str, value))
    return inert(value) if isinstance(value, str) else value
