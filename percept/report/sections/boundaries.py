"""Boundaries of abs(Z_h), environment by environment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import KINDS, METHODS, array, distinct, each_by_itself

_SHAPES = {
    "corner": "both lower limits of k and b together, and both upper limits together, as in the paper (Eqs "
    "16 and 17); the two curves can cross",
    "envelope": "the exact smallest and largest |Z_h| that any k and b within their limits can give",
    "pointwise": "quantiles of draws of |Z_h|, at each ω for itself",
}


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the figures and a table of values for each environment, and the curves for the page's script."""
    records = document["boundaries"]
    if not records:
        return None
    names = distinct(records, "environment")
    errors = {_labels(record): f"/boundaries/{rank}/error" for rank, record in enumerate(records)}
    shapes = [shape for shape in _SHAPES if any(record["shape"] == shape for record in records)]
    return Part(
        "boundaries",
        "Realistic performance boundaries",
        {
            "environments": [
                _environment(document, errors, index, name) for index, name in enumerate(names, start=1)
            ],
            "shapes": [{"name": shape, "meaning": _SHAPES[shape]} for shape in shapes],
            "curves": _curves(document, names),
            "methods": [method for method in METHODS if any(r["method"] == method for r in records)],
            "kinds": [kind for kind in KINDS if any(r["kind"] == kind for r in records)],
            "coupled": any(record.get("coupled") is not None for record in records),
            "worst": worst_curve(records),
        },
    )


def worst_curve(records: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Name the curve through draws with the largest typical Monte Carlo error; None without such curves."""
    known = [rank for rank, record in enumerate(records) if record.get("error") is not None]
    if not known:
        return None
    rank = max(known, key=lambda rank: float(records[rank]["error"]))
    what = {name: records[rank][name] for name in ("environment", "kind", "method", "family")}
    return what | {"place": f"/boundaries/{rank}/error"}


def _labels(record: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(record[name] for name in ("environment", "kind", "method", "family", "joint", "shape"))


def _environment(
    document: Mapping[str, Any], errors: Mapping[tuple[str, ...], str], index: int, name: str
) -> dict[str, Any]:
    rows = [
        {
            **{field: record[field] for field in ("kind", "method", "family", "shape")},
            "place": f"/readings/{place}",
            "inside": _inside(record),
            "error": errors[_labels(record)],
        }
        for place, record in enumerate(document["readings"])
        if record["environment"] == name
    ]
    rows.sort(key=lambda row: (KINDS.index(row["kind"]), METHODS.index(row["method"])))
    return {
        "name": name,
        "figures": [f"boundary_{index}_{view}" for view in ("range", "zoom")],
        "wide": f"boundary_{index}_ratio",
        "rows": rows,
    }


def _inside(record: Mapping[str, Any]) -> dict[str, bool | None]:
    """Say whether the reference and the coupled reference lie between the two limits."""
    low, high = sorted(float(record[side][0]) for side in ("lower", "upper"))
    return {
        name: None if record.get(name) is None else low <= float(record[name][0]) <= high
        for name in ("reference", "coupled")
    }


def _curves(document: Mapping[str, Any], names: list[str]) -> list[dict[str, Any]]:
    """Return the curves the script draws, to seven digits; a grid or curve that is shared stands once."""
    found = []
    for name in names:
        records = [
            record
            for record in document["boundaries"]
            if record["environment"] == name and each_by_itself(record)
        ]
        if not records:
            continue
        grids = [list(grid) for grid in dict.fromkeys(tuple(record["omega"]) for record in records)]
        first = records[0]
        found.append(
            {
                "name": name,
                "zoom": document["zoom"].get(name),
                "grids": [_short(grid) for grid in grids],
                "reference": _short(first["reference"]),
                "coupled": None if first.get("coupled") is None else _short(first["coupled"]),
                "limits": [
                    {field: record[field] for field in ("kind", "method", "family", "shape")}
                    | {"grid": grids.index(record["omega"])}
                    | {side: _short(record[side]) for side in ("lower", "upper")}
                    for record in records
                ],
            }
        )
    return found


def _short(values: list[Any]) -> list[float | None]:
    """Round to seven digits; what is not finite is not drawn."""
    numbers = array(values).tolist()
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in numbers]
