"""The band law: how wide the boundaries are against the impedance of the environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import KINDS, METHODS, family_of

_NAMES = {"weber": "Weber, w·|Z|", "offset": "Weber with offset, c + w·|Z|", "power": "power law, w·|Z|^p"}
_MEANINGS = {"c": "c, offset (N·s/m)", "w": "w, slope", "p": "p, exponent"}


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the widths, absolute and relative, and the laws with their parameters."""
    band = document["band"]
    if not band or not band.get("rows"):
        return None
    family = family_of(document)
    places: dict[tuple[str, str], dict[str, str]] = {}
    for index, row in enumerate(band["rows"]):
        if row["family"] == family:
            places.setdefault((row["environment"], row["kind"]), {})[row["method"]] = f"/band/rows/{index}"
    rows = [
        {"environment": environment, "kind": kind, "places": found}
        for environment in dict.fromkeys(environment for environment, _ in places)
        for kind in KINDS
        if (found := places.get((environment, kind)))
    ]
    laws = [
        {
            **law,
            "name": _NAMES.get(law["model"], law["model"]),
            "place": f"/band/laws/{index}",
            "values": [
                {
                    "meaning": _MEANINGS.get(name, name),
                    "place": f"/band/laws/{index}/parameters/{name}",
                }
                for name in law["parameters"]
            ],
        }
        for index, law in enumerate(band.get("laws") or ())
        if law["family"] == family
    ]
    return Part(
        "band",
        "Band against impedance",
        {
            "rows": rows,
            "laws": laws,
            "family": family,
            "statements": [
                {**statement, "place": f"/band/statements/{index}"}
                for index, statement in enumerate(band.get("statements") or ())
                if statement["family"] == family
            ],
            "trend": [
                {**row, "place": f"/band/kappa/{index}"} for index, row in enumerate(band.get("kappa") or ())
            ],
            "methods": [method for method in METHODS if any(method in row["places"] for row in rows)],
        },
    )
