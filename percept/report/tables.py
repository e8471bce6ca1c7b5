"""Tables of a report as CSV: every digit, units in the header."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from percept.report.plain import Digits
from percept.report.select import distinct, matching
from percept.sessions.read import neutralised
from percept.sessions.values import UNITS

_INTERVAL = ("environment", "kind", "method", "family", "joint", "level", "share", "confidence")


def csv_tables(document: Mapping[str, Any], *, digits: Digits | None = None) -> dict[str, str]:
    """Return the tables of a document."""
    tables = {}
    for parameter in distinct(document["intervals"], "parameter"):
        rows = matching(document["intervals"], parameter=parameter)
        unit = UNITS[parameter]
        limits = {name: f"{name} ({unit})" for name in ("lower", "upper", "estimate", "reference")}
        heads = {name: name for name in _INTERVAL} | limits | {"n": "n", "covers": "covers"}
        tables[f"intervals_{parameter}.csv"] = _table(heads, rows)
    if document["boundaries"]:
        tables["boundaries.csv"] = _boundaries(document["boundaries"], Digits() if digits is None else digits)
    cells = document["data"]["cells"]
    for parameter in distinct(cells, "parameter"):
        unit = UNITS[parameter]
        heads = {"environment": "environment", "n": "n"}
        heads |= {name: f"{name} ({unit})" for name in ("reference", "mean", "sd")}
        tables[f"data_{parameter}.csv"] = _table(heads, matching(cells, parameter=parameter))
    band = document["band"] or {}
    if band.get("rows"):
        heads = {name: name for name in ("environment", "method", "kind", "family")}
        heads |= {"impedance": "impedance (N·s/m)", "band": "band (N·s/m)", "relative": "relative"}
        tables["band.csv"] = _table(heads, band["rows"])
    for name, place in (("comparison", "comparison"), ("comparison_curves", "curve_comparison")):
        if document[place]:
            rows = document[place]
            tables[f"{name}.csv"] = _table({head: head for head in rows[0]}, rows)
    return tables


def _boundaries(records: Sequence[Mapping[str, Any]], digits: Digits) -> str:
    labels = ("environment", "kind", "method", "family", "joint", "shape", "level")
    curves = {
        "omega": "omega (rad/s)",
        "lower": "lower (N·s/m)",
        "upper": "upper (N·s/m)",
        "reference": "reference (N·s/m)",
        "coupled": "coupled (N·s/m)",
    }
    parts = [_line([*labels, *curves.values()])]
    for record in records:
        # The labels of a curve are quoted once; hundreds of points follow, in which nothing needs quotes.
        head = _line([_cell(record[name]) for name in labels]).rstrip("\n") + ","
        columns = [_column(record.get(name) or [None] * len(record["omega"]), digits) for name in curves]
        parts += [f"{head}{','.join(point)}\n" for point in zip(*columns, strict=True)]
    return "".join(parts)


def _column(values: list[Any], digits: Digits) -> Iterable[str]:
    return digits.of(values) if set(map(type, values)) == {float} else map(_cell, values)


def _table(heads: Mapping[str, str], rows: Iterable[Mapping[str, Any]]) -> str:
    lines = [_line(heads.values())]
    lines += [_line(_cell(row.get(name)) for name in heads) for row in rows]
    return "".join(lines)


def _line(cells: Iterable[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def _cell(value: Any) -> str:
    if type(value) is float:
        return repr(value)
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    text = str(value)
    if text in ("inf", "-inf"):
        return text
    return neutralised(text)
