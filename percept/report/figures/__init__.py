"""Every figure that results have something for, in the order of the page."""

from __future__ import annotations

from percept.report.figures.band import band_drawings
from percept.report.figures.boundaries import boundary_drawings
from percept.report.figures.canvas import Drawing
from percept.report.figures.couplings import design_drawings, stability_drawings
from percept.report.figures.intervals import interval_drawings
from percept.report.figures.levels import level_drawings
from percept.report.figures.pse_lines import line_drawings
from percept.report.figures.zwidth import zwidth_drawings
from percept.results import Results

__all__ = ["drawings"]


def drawings(results: Results) -> list[Drawing]:
    """Return the figures of results in the order of the page; nothing is drawn yet."""
    return [
        *level_drawings(results),
        *interval_drawings(results),
        *line_drawings(results),
        *boundary_drawings(results),
        *zwidth_drawings(results.zwidth),
        *stability_drawings(results.coupling),
        *design_drawings(results),
        *band_drawings(results),
    ]
