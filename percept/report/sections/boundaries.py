"""Boundaries of abs(Z_h), environment by environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from percept.report.sections.part import Part
from percept.report.select import KINDS, METHODS, array, distinct, each_by_itself

__all__ = ["build"]

_SHAPES = {
    "corner": "both lower limits of k and b together, and both upper limits together, as in the paper (Eqs "
    "16 and 17); the two curves can cross",
    "envelope": "the exact smallest and largest |Z_h| that any k and b within their limits can give",
    "pointwise": "quantiles of the posterior draws of |Z_h|, at each ω for itself",
    "simultaneous": "a band whose level holds for the whole curve at once",
}
_LOOK_AT = 10.0


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the figures and a table of values for each environment, and the curves for the page's script.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    records = document["boundaries"]
    if not records:
        return None
    names = distinct(records, "environment")
    shapes = [shape for shape in _SHAPES if any(record["shape"] == shape for record in records)]
    return Part(
        "boundaries",
        "Realistic performance boundaries",
        {
            "environments": [
                _environment(document, index, name) for index, name in enumerate(names, start=1)
            ],
            "shapes": [{"name": shape, "meaning": _SHAPES[shape]} for shape in shapes],
            "curves": _curves(document, names),
            "methods": [method for method in METHODS if any(r["method"] == method for r in records)],
            "kinds": [kind for kind in KINDS if any(r["kind"] == kind for r in records)],
            "coupled": any(record.get("coupled") is not None for record in records),
        },
    )


def _environment(document: Mapping[str, Any], index: int, name: str) -> dict[str, Any]:
    chosen = [
        (place, record)
        for place, record in enumerate(document["boundaries"])
        if record["environment"] == name and each_by_itself(record)
    ]
    at = int(np.abs(np.log(array(chosen[0][1]["omega"]) / _LOOK_AT)).argmin()) if chosen else 0
    rows = [
        {
            **{field: record[field] for field in ("kind", "method", "family", "shape")},
            "place": f"/boundaries/{place}",
            "inside": _inside(record, at),
        }
        for place, record in chosen
    ]
    rows.sort(key=lambda row: (KINDS.index(row["kind"]), METHODS.index(row["method"])))
    return {
        "name": name,
        "figures": [f"boundary_{index}_{view}" for view in ("range", "zoom")],
        "wide": f"boundary_{index}_ratio",
        "at": at,
        "rows": rows,
    }


def _inside(record: Mapping[str, Any], at: int) -> dict[str, bool | None]:
    """Say whether the reference and the coupled reference lie between the two curves."""
    ends = sorted(float(record[side][at]) for side in ("lower", "upper"))
    return {
        name: None if record.get(name) is None else ends[0] <= float(record[name][at]) <= ends[1]
        for name in ("reference", "coupled")
    }


def _curves(document: Mapping[str, Any], names: list[str]) -> list[dict[str, Any]]:
    """Return the curves the script draws, to seven digits; what an environment shares stands once."""
    found = []
    for name in names:
        records = [
            record
            for record in document["boundaries"]
            if record["environment"] == name and each_by_itself(record)
        ]
        if not records:
            continue
        coupled = records[0].get("coupled")
        found.append(
            {
                "name": name,
                "zoom": document["zoom"][name],
                "omega": _short(records[0]["omega"]),
                "reference": _short(records[0]["reference"]),
                "coupled": None if coupled is None else _short(coupled),
                "limits": [
                    {field: record[field] for field in ("kind", "method", "family", "shape")}
                    | {side: _short(record[side]) for side in ("lower", "upper")}
                    for record in records
                ],
            }
        )
    return found


def _short(values: list[Any]) -> list[float | None]:
    """Round to seven digits; what is not finite is not drawn."""
    return [float(f"{value:.7g}") if np.isfinite(value) else None for value in array(values)]
