"""What was left out of the analysis, and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the skipped parts."""
    skipped = document["skipped"]
    return Part("skipped", "Not computed", {"skipped": skipped}) if skipped else None
