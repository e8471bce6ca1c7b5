"""Intervals of both methods beside each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import KINDS, distinct

_COLUMNS = (
    ("classical", "normal"),
    ("classical", "lognormal"),
    ("bayesian", "lognormal"),
    ("bayesian", "normal"),
)
_PARAMETERS = {"k": "Stiffness k", "b": "Damping b"}


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the tables of intervals, with the sentence each kind and method carries."""
    tables = interval_tables(document)
    if not tables:
        return None
    return Part("intervals", "Intervals of the adjustments", {"tables": tables})


def interval_tables(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return one table per joint treatment and parameter: rows of environment and kind, columns of method."""
    places = list(enumerate(document["intervals"]))
    tables = []
    for joint in distinct(document["intervals"], "joint"):
        for parameter in distinct(document["intervals"], "parameter"):
            rows = [(i, r) for i, r in places if r["parameter"] == parameter and r["joint"] == joint]
            if rows:
                tables.append(_table(parameter, joint, rows))
    return tables


def _table(parameter: str, joint: str, rows: list[tuple[int, Any]]) -> dict[str, Any]:
    columns = [c for c in _COLUMNS if any((r["method"], r["family"]) == c for _, r in rows)]
    place = {(r["environment"], r["kind"], r["method"], r["family"]): f"/intervals/{i}" for i, r in rows}
    reference = {r["environment"]: f"/intervals/{i}/reference" for i, r in reversed(rows)}
    kinds = [kind for kind in KINDS if any(r["kind"] == kind for _, r in rows)]
    return {
        "title": _PARAMETERS[parameter],
        "parameter": parameter,
        "joint": joint,
        "unit": rows[0][1]["unit"],
        "columns": [{"method": method, "family": family} for method, family in columns],
        "rows": [
            {
                "environment": environment,
                "kind": kind,
                "reference": reference[environment],
                "cells": [place.get((environment, kind, *column)) for column in columns],
            }
            for environment in distinct((r for _, r in rows), "environment")
            for kind in kinds
        ],
        "sentences": _sentences(rows),
    }


def _sentences(rows: list[tuple[int, Any]]) -> list[dict[str, Any]]:
    """Return what each kind and method covers, each sentence once, with the families that carry it."""
    found: dict[tuple[str, str], dict[str, list[Any]]] = {}
    for _, row in rows:
        sentences = found.setdefault((row["kind"], row["method"]), {})
        sentences.setdefault(row["covers"], []).append(row)
    ordered = sorted(found.items(), key=lambda item: (KINDS.index(item[0][0]), item[0][1] != "classical"))
    return [
        {
            "kind": kind,
            "method": method,
            "families": sorted(distinct(carried, "family"), reverse=True),
            "environments": _told_apart(list(sentences.values()), carried),
            "covers": covers,
        }
        for (kind, method), sentences in ordered
        for covers, carried in sentences.items()
    ]


def _told_apart(all_carried: list[list[Any]], own: list[Any]) -> list[str]:
    """Environments of a sentence, where others of the same families have another one."""
    families = {row["family"] for row in own}
    shared = [rows for rows in all_carried if families & {row["family"] for row in rows}]
    return distinct(own, "environment") if len(shared) > 1 else []
