"""The band law: how wide the boundaries are against the impedance of the environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]

_NAMES = {"weber": "Weber, w·|Z|", "offset": "Weber with offset, c + w·|Z|", "power": "power law, w·|Z|^p"}
_MEANINGS = {"c": "c, offset (N·s/m)", "w": "w, slope", "p": "p, exponent"}


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the widths, absolute and relative, and the laws with their parameters.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    band = document["band"]
    if not band or not band.get("rows"):
        return None
    rows = [{**row, "place": f"/band/rows/{index}"} for index, row in enumerate(band["rows"])]
    laws = [
        {
            **law,
            "name": _NAMES.get(law["model"], law["model"]),
            "values": [
                {
                    "meaning": _MEANINGS.get(name, name),
                    "place": f"/band/laws/{index}/parameters/{name}",
                }
                for name in law["parameters"]
            ],
        }
        for index, law in enumerate(band.get("laws") or ())
    ]
    return Part("band", "Band against impedance", {"rows": rows, "laws": laws})
