"""Boundaries of abs(Z_h), environment by environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import distinct

__all__ = ["build"]


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the figures of each environment, and what shapes there are.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    records = document["boundaries"]
    if not records:
        return None
    environments = [
        {"name": name, "figures": [f"boundary_{index}_{view}" for view in ("range", "zoom", "ratio")]}
        for index, name in enumerate(distinct(records, "environment"), start=1)
    ]
    return Part(
        "boundaries",
        "Realistic performance boundaries",
        {"environments": environments, "shapes": distinct(records, "shape")},
    )
