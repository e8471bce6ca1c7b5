"""A tick per subject below the bars of each row; those beyond the axis are counted at its edge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS
from percept.report.select import compared_by_difference, first, matching
from percept.results import CellValues

__all__ = ["draw_subjects", "subjects_of"]

FloatArray = NDArray[np.float64]

# In rows, which stand one unit apart: ticks lie below the bars.
_CENTRE = -0.42
_HALF_HEIGHT = 0.11
#: Points from the edge of the axis to a count, past its arrow.
_OUTWARD = 4


def subjects_of(cells: Sequence[CellValues], environment: str, parameter: str) -> FloatArray:
    """Return what each subject adjusted, against the reference as the bars are."""
    of_parameter = matching(cells, parameter=parameter)
    cell = first(matching(of_parameter, environment=environment))
    if cell is None or cell.reference is None:
        return np.empty(0)
    values = np.array(cell.values, dtype=float)
    if parameter in compared_by_difference(of_parameter):
        return values - cell.reference
    return values / cell.reference


def draw_subjects(ax: Axes, values: Sequence[FloatArray], *, subject: str) -> None:
    """Draw each row's subjects on axes whose ends are set; `subject` is what one is called."""
    left, right = ax.get_xlim()
    ends = np.array([-_HALF_HEIGHT, _HALF_HEIGHT, np.nan])
    for index, of_row in enumerate(values):
        height = _CENTRE - index
        inside = of_row[(of_row >= left) & (of_row <= right)]
        # One path: a mark for each of hundreds of subjects makes a page of megabytes.
        ax.plot(
            np.repeat(inside, len(ends)),
            np.tile(height + ends, len(inside)),
            linewidth=1.0,
            color=COLOURS["quiet"],
            label=f"one {subject}" if len(of_row) else None,
        )
        # A logarithmic axis has no zero: who is there lies beyond its left end.
        _count(ax, (left, height), int((of_row < left).sum()), "left")
        _count(ax, (right, height), int((of_row > right).sum()), "right")


def _count(ax: Axes, edge: tuple[float, float], count: int, side: str) -> None:
    """Mark how many subjects lie beyond an edge, outside it: inside there may be ticks."""
    if not count:
        return
    outward = -_OUTWARD if side == "left" else _OUTWARD
    arrow = "<" if side == "left" else ">"
    ax.annotate(
        f"{count} more",
        edge,
        xytext=(outward, 0),
        textcoords="offset points",
        ha="right" if side == "left" else "left",
        va="center",
        fontsize=5.2,
    )
    ax.plot(*edge, marker=arrow, markersize=3, color=COLOURS["quiet"], clip_on=False)
