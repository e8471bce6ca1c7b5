"""How the verdicts move with the device's mass and damping."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the table of devices: a row per damping, a column per mass."""
    found = document["sensitivity"]
    if not found:
        return None
    return Part(
        "device",
        "If the device were another",
        {
            "sensitivity": found,
            "kinds": list(found["inside"]),
            "rows": range(len(found["damping"])),
            "columns": range(len(found["mass"])),
            "own": list(found["own"]),
        },
    )
