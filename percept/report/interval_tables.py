"""The section on intervals: a matrix per quantity, tables of every family, and what each interval covers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from percept.report.numbers import digits_of
from percept.report.select import (
    KINDS,
    METHODS,
    Record,
    Section,
    distinct,
    families_of,
    first,
    matching,
    ordered,
    pointed,
    quantities_of,
)
from percept.sessions.quantities import Quantity

_COLUMNS = (
    ("classical", "normal"),
    ("classical", "lognormal"),
    ("bayesian", "lognormal"),
    ("bayesian", "normal"),
)


def intervals(document: Record) -> Section | None:
    """Return a matrix per quantity in the study's family, and everything else in tables to open."""
    tables = interval_tables(document)
    if not tables:
        return None
    rows = pointed(document["intervals"], "/intervals")
    marginal = matching(rows, joint="marginal")
    values = {
        "matrices": [
            _matrix(matching(marginal, parameter=name), families_of(document), quantities_of(document)[name])
            for name in distinct(marginal, "parameter")
        ],
        "panels": [f"intervals_{name}" for name in distinct(marginal, "parameter")],
        "tables": tables,
        "widened": any(table["joint"] != "marginal" for table in tables),
        "sentences": _sentences(rows),
    }
    return Section("intervals", "Intervals of the adjustments", values)


def _matrix(rows: list[Record], families: Sequence[str], quantity: Quantity) -> dict[str, Any]:
    """Return a row per environment and a column per kind and method, in the first family each has."""
    columns = [
        {"kind": kind, "method": method}
        for kind in KINDS
        for method in METHODS
        if matching(rows, kind=kind, method=method)
    ]
    shown = [
        (
            environment,
            [first(matching(rows, environment=environment, **column), family=families) for column in columns],
        )
        for environment in distinct(rows, "environment")
    ]
    used = {cell["family"] for _, cells in shown for cell in cells if cell}
    return {
        "title": quantity.head,
        "parameter": rows[0]["parameter"],
        "unit": rows[0]["unit"],
        "family": ", else ".join(family for family in families if family in used),
        "columns": columns,
        "rows": [
            {
                "environment": environment,
                "reference": next(f"{cell['pointer']}/reference" for cell in cells if cell),
                "cells": [
                    cell
                    and {
                        "pointer": cell["pointer"],
                        "digits": [
                            digits_of(cell[end], cell["lower"], cell["upper"]) for end in ("lower", "upper")
                        ],
                    }
                    for cell in cells
                ],
            }
            for environment, cells in shown
        ],
    }


def interval_tables(document: Record) -> list[dict[str, Any]]:
    """Return one table per joint treatment and parameter: rows of environment and kind, columns of method."""
    rows = pointed(document["intervals"], "/intervals")
    return [
        _interval_table(cell_rows, quantities_of(document)[parameter])
        for joint in distinct(rows, "joint")
        for parameter in distinct(rows, "parameter")
        if (cell_rows := matching(rows, parameter=parameter, joint=joint))
    ]


def _interval_table(rows: list[Record], quantity: Quantity) -> dict[str, Any]:
    present = {(row["method"], row["family"]) for row in rows}
    columns = [column for column in _COLUMNS if column in present]
    pointers = {(r["environment"], r["kind"], r["method"], r["family"]): r["pointer"] for r in rows}
    reference = {row["environment"]: f"{row['pointer']}/reference" for row in reversed(rows)}
    return {
        "title": quantity.head,
        "parameter": rows[0]["parameter"],
        "joint": rows[0]["joint"],
        "unit": rows[0]["unit"],
        "columns": [{"method": method, "family": family} for method, family in columns],
        "rows": [
            {
                "environment": environment,
                "kind": kind,
                "reference": reference[environment],
                "cells": [pointers.get((environment, kind, *column)) for column in columns],
            }
            for environment in distinct(rows, "environment")
            for kind in ordered(KINDS, rows, "kind")
        ],
    }


def _sentences(rows: Sequence[Record]) -> list[dict[str, Any]]:
    """Return what each kind and method covers, each sentence once, with what it holds for."""
    found = []
    for kind in KINDS:
        for method in METHODS:
            same = matching(rows, kind=kind, method=method)
            for covers in distinct(same, "covers"):
                carried = matching(same, covers=covers)
                where = {f"{row['parameter']} of {row['environment']}": None for row in carried}
                alike = {row["covers"] for row in same if row["family"] == carried[0]["family"]}
                found.append(
                    {
                        "kind": kind,
                        "method": method,
                        "families": sorted(distinct(carried, "family"), reverse=True),
                        "where": list(where) if len(alike) > 1 else [],
                        "covers": covers,
                    }
                )
    return found
