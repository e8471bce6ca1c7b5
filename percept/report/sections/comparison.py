"""Classical against Bayesian, with what sets them apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import METHODS, distinct

__all__ = ["build"]

_LABELS = ("environment", "parameter", "kind", "family")
_MEASURES = {"width_ratio": "width, Bayesian / classical", "shift": "shift of the estimate"}
# Estimates are in the table of the figure and in report.json; limits and their ratio say it here.
_PAIRED = tuple(f"{limit}_{method}" for method in METHODS for limit in ("lower", "upper"))
_LEFT_OUT = tuple(f"estimate_{method}" for method in METHODS)


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the pairs of intervals, the measures between them, and whatever else a pair carries.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    rows = document["comparison"]
    if not rows:
        return None
    families = distinct(rows, "family")
    known = {*_LABELS, *_PAIRED, *_LEFT_OUT}
    further = [name for name in rows[0] if name not in known]
    return Part(
        "comparison",
        "Classical against Bayesian",
        {
            "labels": [name for name in _LABELS if name != "family" or len(families) > 1],
            "families": families,
            "methods": METHODS,
            "further": [
                {
                    "name": name,
                    "head": _MEASURES.get(name, name.replace("_", " ")),
                    "text": any(isinstance(row[name], str) for row in rows),
                }
                for name in further
            ],
            "rows": rows,
        },
    )
