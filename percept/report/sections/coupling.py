"""The virtual coupling: stability, and whether it feels real."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import KINDS, METHODS, each_by_itself, family_of


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the verdict, the margin and the rows of realism."""
    coupling = document["coupling"]
    if not coupling:
        return None
    return Part(
        "coupling",
        "The virtual coupling",
        {
            "coupling": coupling,
            "scene": document["provenance"]["scene"]["coupling"],
            "realism": _realism(document),
            "effective": list({row["environment"]: row for row in _placed(coupling, "realism")}.values()),
            "probability": _placed(coupling, "probability"),
            "summary": document["data"]["form"] == "summary",
        },
    )


def _realism(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return a row per environment and kind, a place per method: exact envelope, the study's family."""
    family = family_of(document)
    found: dict[tuple[str, str], dict[str, str]] = {}
    for row in _placed(document["coupling"], "realism"):
        if row["shape"] == "envelope" and row["family"] == family and each_by_itself(row):
            found.setdefault((row["environment"], row["kind"]), {})[row["method"]] = row["place"]
    if not found:
        return None
    names = list(dict.fromkeys(name for name, _ in found))
    lines = sorted(found.items(), key=lambda line: (names.index(line[0][0]), KINDS.index(line[0][1])))
    return {
        "family": family,
        "methods": [method for method in METHODS if any(method in places for _, places in lines)],
        "rows": [
            {"environment": environment, "kind": kind, "places": places}
            for (environment, kind), places in lines
        ],
    }


def _placed(coupling: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    rows = coupling.get(name) or ()
    return [{**row, "place": f"/coupling/{name}/{index}"} for index, row in enumerate(rows)]
