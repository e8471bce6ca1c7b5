"""The methods paragraph, ready to paste, and what it cites."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.references import bibtex, cited
from percept.report.sections.boundaries import worst_curve
from percept.report.sections.part import Part
from percept.report.select import KINDS, family_of
from percept.study.units import NAMES

_CLASSICAL = {
    "mean": "t-intervals of the mean",
    "user": "prediction intervals of the next user",
    "share": "exact two-sided tolerance intervals",
}
_LEVEL, _SHARE = (f"/provenance/scene/inference/{name}" for name in ("level", "share"))


def build(document: Mapping[str, Any]) -> Part:
    """Return what the methods paragraph depends on."""
    scene = document["provenance"]["scene"]
    intervals = document["intervals"]
    used = {row["method"] for row in intervals}
    references = cited(document)
    gate = (document["diagnostics"] or {}).get("gate", {})
    return Part(
        "methods",
        "Methods, ready to paste",
        {
            "data": document["data"],
            "parameters": [NAMES[name] for name in document["data"]["parameters"]],
            "boundaries": bool(document["boundaries"]),
            "worst": worst_curve(document["boundaries"]),
            "missed": gate.get("tolerance_met") is False,
            "device": scene.get("device"),
            "coupling": scene.get("coupling") if document["coupling"] else None,
            "family": family_of(document),
            "kinds": [kind for kind in KINDS if any(row["kind"] == kind for row in intervals)],
            "classical": "classical" in used,
            "classical_kinds": _listed(
                [_CLASSICAL[kind] for kind in KINDS if any(row["kind"] == kind for row in intervals)]
            ),
            "share_place": _SHARE if "share" in scene["inference"] else _LEVEL,
            "bayesian": "bayesian" in used,
            "model": _model(document),
            "pooled": scene.get("model", {}).get("pooling", "partial") == "partial",
            "subjects": max((row["n"] for row in intervals), default=0),
            "version": document["provenance"]["versions"]["percept"],
            "references": references,
            "numbers": {reference.key: rank for rank, reference in enumerate(references, start=1)},
            "bibtex": bibtex(document),
        },
    )


def _model(document: Mapping[str, Any]) -> str:
    """Say what the hierarchical model is made of; data and scene leave parts of it out."""
    data, asked = document["data"], document["provenance"]["scene"].get("model", {})
    pair = len({row["parameter"] for row in document["intervals"]}) == 2
    sessions, several = data["form"] == "trials", len(data["environments"]) > 1
    parts = []
    if several:
        parts.append(
            "a regression of bias on the logarithm of the reference with a deviation for each environment"
        )
    else:
        parts.append("a bias")
    if sessions and several and asked.get("subject_effect", True):
        both = " and correlated between stiffness and damping" if pair else ""
        parts.append(f"subject effects shared by all environments{both}")
    scatter = "between-subject scatter"
    if several:
        scatter += " alike in all environments" if asked.get("common_spread") else " within each environment"
    if several and asked.get("weber"):
        scatter += ", in proportion to the reference but for each environment’s own deviation"
    parts.append(scatter)
    by_itself = " (stiffness and damping each by itself)" if pair and not sessions else ""
    return ", ".join(parts[:-1]) + f", and {parts[-1]}" + by_itself


def _listed(parts: list[str]) -> str:
    return " and ".join(part for part in (", ".join(parts[:-1]), *parts[-1:]) if part)
