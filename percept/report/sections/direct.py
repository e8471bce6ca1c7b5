"""References rendered without a coupling: what damping passivity asks of the device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part


def build(document: Mapping[str, Any]) -> Part | None:
    """Return a row per environment."""
    rows = document["passivity"]
    if not rows:
        return None
    placed = [{**row, "place": f"/passivity/{index}"} for index, row in enumerate(rows)]
    return Part("direct", "Rendered without a coupling", {"passivity": placed})
