"""Classical against Bayesian, with the reasons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import METHOD_NAMES

__all__ = ["build"]

_HEADS = {
    "width_ratio": "width, Bayesian / classical",
    "shift": "shift of the estimate",
    **{
        f"{limit}_{method}": f"{name} {limit}"
        for limit in ("lower", "upper", "estimate")
        for method, name in METHOD_NAMES.items()
    },
}


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the rows of the comparison.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    rows = document["comparison"]
    if not rows:
        return None
    columns = list(rows[0])
    texts = {column: any(isinstance(row[column], str) for row in rows) for column in columns}
    heads = {column: _HEADS.get(column, column.replace("_", " ")) for column in columns}
    return Part(
        "comparison",
        "Why the methods differ",
        {"columns": columns, "heads": heads, "rows": rows, "texts": texts},
    )
