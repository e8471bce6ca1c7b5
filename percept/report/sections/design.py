"""The couplings that would do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the stiffest and the softest coupling of each environment, and of all together."""
    design = document["design"]
    if not design:
        return None
    couplings = [
        {
            "name": one["name"],
            "method": found["method"],
            "place": f"/design/maps/{rank}/environments/{index}",
            "found": one["largest"] is not None,
        }
        for rank, found in enumerate(design["maps"])
        for index, one in enumerate(found["environments"])
    ]
    return Part("design", "Couplings that would do", {"family": design["family"], "couplings": couplings})
