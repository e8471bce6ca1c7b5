"""Tables of a report as CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from percept.report.select import Record, matching, quantities_of

_INTERVAL = (
    "environment", "kind", "method", "family", "joint", "level", "share", "confidence", "lower", "upper",
    "estimate", "reference", "n", "covers",
)  # fmt: skip
_DATA = ("environment", "n", "reference", "mean", "sd")
_BAND = ("environment", "method", "kind", "family")
_CURVE = ("environment", "kind", "method", "family", "joint", "shape", "level")
#: Beginnings of what a spreadsheet runs.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
#: Columns in the unit of their table; heads name it.
_IN_UNIT = (
    "lower", "upper", "estimate", "reference", "mean", "sd", "coupled", "impedance", "band",
)  # fmt: skip


def csv_tables(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the tables of a document as CSV, by file name."""
    band, tables = (document["band"] or {"rows": ()})["rows"], {}
    for name, quantity in quantities_of(document).items():
        for kind, records, columns in (
            ("intervals", document["intervals"], _INTERVAL),
            ("data", document["data"]["cells"], _DATA),
            ("band", band, (*_BAND, "reference", "band", "relative")),
        ):
            if rows := matching(records, parameter=name):
                tables[f"{kind}_{name}"] = _csv(rows, columns, quantity.unit)
    if rows := matching(band, parameter=None):
        tables["band"] = _csv(rows, (*_BAND, "impedance", "band", "relative"), "N·s/m")
    if document["boundaries"]:
        tables["boundaries"] = _curves(document["boundaries"])
    records = {
        "contrast": document["contrast"],
        "comparison": document["comparison"],
        "realism": (document["coupling"] or {}).get("realism"),
    }
    tables |= {name: _csv(rows, tuple(rows[0])) for name, rows in records.items() if rows}
    return {f"{name}.csv": text for name, text in tables.items()}


def _csv(rows: Iterable[Record], columns: Iterable[str], unit: str = "") -> str:
    """Write columns of records with every digit of a double, and nothing for None."""
    heads = [f"{name} ({unit})" if unit and name in _IN_UNIT else name for name in columns]
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    return pd.DataFrame(cells, columns=heads, dtype=object).to_csv(index=False, lineterminator="\n")


def _curves(records: Iterable[Record]) -> str:
    """Write a row per curve and frequency."""
    columns = ("omega (rad/s)", "lower", "upper", "reference", "coupled")
    rows = []
    for record in records:
        labels = {label: record[label] for label in _CURVE}
        none = [None] * len(record["omega"])
        curves = (record.get(name.removesuffix(" (rad/s)")) or none for name in columns)
        rows += [labels | dict(zip(columns, point, strict=True)) for point in zip(*curves, strict=True)]
    return _csv(rows, (*_CURVE, *columns), "N·s/m")


def _cell(value: Any) -> Any:
    """Make what a spreadsheet would run as a formula text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        value = "; ".join(map(str, value))
    text = isinstance(value, str) and value not in ("inf", "-inf")
    return f"'{value}" if text and value.startswith(_FORMULA) else value
