"""The band law: how wide the boundaries are against the impedance of the environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the widths, absolute and relative, and the sentences of the laws.

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
    rows = [
        {**{name: row[name] for name in ("environment", "method", "kind")}, "place": f"/band/rows/{index}"}
        for index, row in enumerate(band["rows"])
    ]
    return Part("band", "Band against impedance", {"rows": rows, "laws": band.get("laws") or []})
