"""The summary: a few sentences to quote."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import KINDS, family_of, first, matching
from percept.study.units import NAMES


def build(document: Mapping[str, Any]) -> Part:
    """Return what the summary's sentences need, as places of the document."""
    gate = (document["diagnostics"] or {}).get("gate")
    scene = document["provenance"]["scene"]
    return Part(
        "summary",
        "Summary",
        {
            "data": document["data"],
            "parameters": [NAMES[name] for name in document["data"]["parameters"]],
            "references": _references(document),
            "widths": _widths(document),
            "coupling": document["coupling"],
            "scene": scene,
            "law": _law(document),
            "cautions": document["summary"]["cautions"],
            "gate": gate,
            "missing": [kind for kind in KINDS if kind not in {r["kind"] for r in document["intervals"]}],
        },
    )


def _widths(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return, per parameter, the widths of one kind and method: the next user's, Bayesian if there is one."""
    rows = [
        {**row, "place": f"/summary/widths/{index}", "name": NAMES[row["parameter"]]}
        for index, row in enumerate(document["summary"]["widths"])
    ]
    chosen = (
        first(
            [row for row in rows if row["parameter"] == parameter],
            kind=("user", "mean", "share"),
            method=("bayesian", "classical"),
            family=(family_of(document), "lognormal", "normal"),
        )
        for parameter in NAMES
    )
    return [dict(row) for row in chosen if row is not None]


def _references(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the counts of references inside their intervals; families that agree share a sentence."""
    found: dict[Any, dict[str, Any]] = {}
    for index, row in enumerate(document["summary"]["references"]):
        names = tuple((one["environment"], one["parameter"]) for one in row["outside"])
        shared = found.setdefault(
            (row["method"], row["level"], row["inside"], row["of"], names),
            {**row, "place": f"/summary/references/{index}", "families": []},
        )
        shared["families"].append(row["family"])
    return list(found.values())


def _law(document: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the law to quote: the best predictor for the average user, Bayesian if there is one."""
    laws = (document["band"] or {}).get("laws") or ()
    chosen = first(
        laws,
        kind=KINDS,
        method=("bayesian", "classical"),
        family=(family_of(document), "lognormal", "normal"),
    )
    if chosen is None:
        return None
    alike = matching(laws, **{name: chosen[name] for name in ("kind", "method", "family")})
    return min(alike, key=lambda law: (law["left_out_error"] is None, law["left_out_error"]))
