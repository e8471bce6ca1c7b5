"""The methods paragraph, ready to paste."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]


def build(document: Mapping[str, Any]) -> Part:
    """Return what the methods paragraph depends on.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part
    """
    scene = document["provenance"]["scene"]
    used = {row["method"] for row in document["intervals"]}
    return Part(
        "methods",
        "Methods, ready to paste",
        {
            "data": document["data"],
            "inference": scene.get("inference", {}),
            "model": scene.get("model", {}),
            "device": scene.get("device"),
            "coupling": scene.get("coupling"),
            "classical": "classical" in used,
            "bayesian": "bayesian" in used,
            "version": document["provenance"]["versions"]["percept"],
        },
    )
