"""The virtual coupling: stability, and whether it feels real."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the verdict, the margin and the rows of realism.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    coupling = document["coupling"]
    if not coupling:
        return None
    return Part("coupling", "The virtual coupling", {"coupling": coupling})
