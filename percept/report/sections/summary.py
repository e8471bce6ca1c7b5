"""The summary: a few sentences to quote."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import KINDS, family_of, first

__all__ = ["build"]

_PARAMETERS = {"k": "stiffness", "b": "damping"}


def build(document: Mapping[str, Any]) -> Part:
    """Return what the summary's sentences need, as places of the document.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part
    """
    summary = document["summary"]
    references = [
        {**row, "place": f"/summary/references/{index}"}
        for index, row in enumerate(summary["references"])
        if row["method"] == "classical" or row["family"] == family_of(document)
    ]
    gate = (document["diagnostics"] or {}).get("gate")
    scene = document["provenance"]["scene"]
    return Part(
        "summary",
        "Summary",
        {
            "data": document["data"],
            "parameters": [_PARAMETERS[name] for name in document["data"]["parameters"]],
            "references": references,
            "widths": _widths(document),
            "coupling": document["coupling"],
            "scene": scene,
            "laws": (document["band"] or {}).get("laws") or [],
            "gate": gate,
            "missing": [kind for kind in KINDS if kind not in {r["kind"] for r in document["intervals"]}],
        },
    )


def _widths(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return, per parameter, the widths of one kind and method: the next user's, Bayesian if there is one."""
    rows = [
        {**row, "place": f"/summary/widths/{index}", "name": _PARAMETERS[row["parameter"]]}
        for index, row in enumerate(document["summary"]["widths"])
    ]
    chosen = (
        first(
            [row for row in rows if row["parameter"] == parameter],
            kind=("user", "mean", "share"),
            method=("bayesian", "classical"),
            family=(family_of(document), "lognormal", "normal"),
        )
        for parameter in _PARAMETERS
    )
    return [dict(row) for row in chosen if row is not None]
