"""What was left out of the analysis, and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the skipped parts.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    skipped = document["skipped"]
    return Part("skipped", "Not computed", {"skipped": skipped}) if skipped else None
