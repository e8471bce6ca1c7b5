"""Classical against Bayesian, with the reasons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]


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
    return Part("comparison", "Why the methods differ", {"columns": columns, "rows": rows, "texts": texts})
