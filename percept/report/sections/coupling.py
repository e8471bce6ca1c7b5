"""The virtual coupling: stability, and whether it feels real."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the verdict, the margin and the rows of realism.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    coupling = document["coupling"]
    if not coupling:
        return None
    design = document["design"]
    couplings = []
    if design:
        places = [
            (one["name"], one, f"/design/environments/{index}")
            for index, one in enumerate(design["environments"])
        ]
        places.append(("all together", design["common"], "/design/common"))
        couplings = [
            {"name": name, "place": place, "found": one["largest"] is not None} for name, one, place in places
        ]
    return Part(
        "coupling",
        "The virtual coupling",
        {
            "coupling": coupling,
            "scene": document["provenance"]["scene"]["coupling"],
            "realism": _placed(coupling, "realism"),
            "passivity": _placed(coupling, "passivity"),
            "effective": list({row["environment"]: row for row in _placed(coupling, "realism")}.values()),
            "design": design,
            "couplings": couplings,
        },
    )


def _placed(coupling: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    rows = coupling.get(name) or ()
    return [{**row, "place": f"/coupling/{name}/{index}"} for index, row in enumerate(rows)]
