"""The sections of the page, in reading order: each takes the document and returns its part, or None."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections import (
    band,
    boundaries,
    checks,
    comparison,
    coupling,
    data,
    design,
    device,
    diagnostics,
    direct,
    intervals,
    methods,
    provenance,
    skipped,
    summary,
)
from percept.report.sections.part import Part

__all__ = ["Part", "build_parts"]

_ORDER = (
    summary,
    intervals,
    boundaries,
    direct,
    coupling,
    design,
    device,
    band,
    comparison,
    diagnostics,
    checks,
    data,
    methods,
    provenance,
    skipped,
)


def build_parts(document: Mapping[str, Any]) -> list[Part]:
    """Return the parts a document needs; what it has nothing for is absent."""
    return [part for section in _ORDER if (part := section.build(document)) is not None]
