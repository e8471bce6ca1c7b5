"""Where the numbers come from: versions, seed, files, scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part


def build(document: Mapping[str, Any]) -> Part:
    """Return versions, seed, hashes and every setting of the scene."""
    provenance = document["provenance"]
    settings = [
        {"table": table, "key": key, "value": value}
        for table, entries in provenance["scene"].items()
        if isinstance(entries, Mapping)
        for key, value in entries.items()
    ]
    return Part("provenance", "Provenance", {"provenance": provenance, "settings": settings})
