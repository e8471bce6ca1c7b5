"""Every figure of a document, in the order of the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.figures.canvas import Drawing
from percept.report.figures.from_band import band_drawings
from percept.report.figures.from_boundaries import boundary_drawings
from percept.report.figures.from_coupling import coupling_drawings
from percept.report.figures.from_intervals import interval_drawings


def drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return every figure the document has data for; nothing is drawn yet."""
    return [
        *interval_drawings(document),
        *boundary_drawings(document),
        *coupling_drawings(document),
        *band_drawings(document),
    ]
