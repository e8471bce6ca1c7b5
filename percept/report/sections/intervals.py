"""Intervals of both methods beside each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import distinct

__all__ = ["build"]

_KINDS = ("mean", "user", "share")
_COLUMNS = (
    ("classical", "normal"),
    ("classical", "lognormal"),
    ("bayesian", "lognormal"),
    ("bayesian", "normal"),
)
_PARAMETERS = {"k": "Stiffness k", "b": "Damping b"}


def build(document: Mapping[str, Any]) -> Part | None:
    """Return one table per parameter and joint treatment: rows of environment and kind, columns of method.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    places = list(enumerate(document["intervals"]))
    if not places:
        return None
    tables = []
    for joint in distinct(document["intervals"], "joint"):
        for parameter in distinct(document["intervals"], "parameter"):
            rows = [(i, r) for i, r in places if r["parameter"] == parameter and r["joint"] == joint]
            if rows:
                tables.append(_table(parameter, joint, rows))
    return Part("intervals", "Intervals of the adjustments", {"tables": tables})


def _table(parameter: str, joint: str, rows: list[tuple[int, Any]]) -> dict[str, Any]:
    columns = [c for c in _COLUMNS if any((r["method"], r["family"]) == c for _, r in rows)]
    place = {(r["environment"], r["kind"], r["method"], r["family"]): f"/intervals/{i}" for i, r in rows}
    environments = distinct((r for _, r in rows), "environment")
    kinds = [kind for kind in _KINDS if any(r["kind"] == kind for _, r in rows)]
    groups = []
    for environment in environments:
        found = next(i for i, r in rows if r["environment"] == environment)
        lines = [
            {"kind": kind, "cells": [place.get((environment, kind, *column)) for column in columns]}
            for kind in kinds
        ]
        groups.append(
            {"environment": environment, "reference": f"/intervals/{found}/reference", "lines": lines}
        )
    return {
        "title": _PARAMETERS[parameter],
        "parameter": parameter,
        "joint": joint,
        "unit": rows[0][1]["unit"],
        "columns": [{"method": method, "family": family} for method, family in columns],
        "groups": groups,
        "sentences": _sentences(rows),
    }


def _sentences(rows: list[tuple[int, Any]]) -> list[dict[str, Any]]:
    """Return what each kind covers, each sentence once, with whom it holds for."""
    found: dict[tuple[str, str], dict[str, list[str]]] = {}
    for _, row in rows:
        sentences = found.setdefault((row["kind"], row["method"]), {})
        sentences.setdefault(row["covers"], []).append(row["family"])
    ordered = sorted(found.items(), key=lambda item: (_KINDS.index(item[0][0]), item[0][1] != "classical"))
    return [
        {"kind": kind, "method": method, "families": sorted(set(families), reverse=True), "covers": covers}
        for (kind, method), sentences in ordered
        for covers, families in sentences.items()
    ]
