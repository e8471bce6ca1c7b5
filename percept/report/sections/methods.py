"""The methods paragraph, ready to paste, and what it cites."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.references import bibtex, cited
from percept.report.sections.part import Part
from percept.report.select import KINDS, family_of

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
    intervals = document["intervals"]
    used = {row["method"] for row in intervals}
    references = cited(document)
    return Part(
        "methods",
        "Methods, ready to paste",
        {
            "data": document["data"],
            "scene": scene,
            "family": family_of(document),
            "kinds": [kind for kind in KINDS if any(row["kind"] == kind for row in intervals)],
            "classical": "classical" in used,
            "bayesian": "bayesian" in used,
            "pooled": scene.get("model", {}).get("pooling", "partial") == "partial",
            "subjects": max((row["n"] for row in intervals), default=0),
            "diagnostics": document["diagnostics"],
            "version": document["provenance"]["versions"]["percept"],
            "references": references,
            "numbers": {reference.key: rank for rank, reference in enumerate(references, start=1)},
            "bibtex": bibtex(document),
        },
    )
