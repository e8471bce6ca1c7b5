"""Every figure that results have something for, in the order of the page."""

from __future__ import annotations

from percept.report.figures.boundaries import band_drawings, curve_drawings
from percept.report.figures.canvas import Drawing
from percept.report.figures.couplings import design_drawings, stability_drawings
from percept.report.figures.intervals import level_drawings, overview_drawings
from percept.results import Results


def drawings(results: Results) -> list[Drawing]:
    """Return the figures of results in the order of the page; nothing is drawn yet."""
    return [
        *level_drawings(results),
        *overview_drawings(results),
        *curve_drawings(results),
        *stability_drawings(results.zwidth, results.coupling),
        *design_drawings(results),
        *band_drawings(results),
    ]
