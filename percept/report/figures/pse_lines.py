"""Points of subjective equality over the reference: environments, and the line they lie about."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from percept.errors import counted
from percept.inference.record import percent
from percept.report.figures.canvas import (
    COLOURS,
    MARKERS,
    REFERENCE_DASHES,
    WIDE,
    Drawing,
    Frame,
    common_range,
    legend,
    log_scale,
    mark,
    outer_labels,
    panels,
    row_labels,
)
from percept.report.figures.intervals import tick_steps
from percept.report.select import MOST_OPEN, distinct, matching, words_of
from percept.results import PseLineRow, PsychophysicsRow, Results
from percept.sessions.quantities import Quantity

__all__ = ["line_drawings"]

#: mm, half a page, for one condition; several share the whole width.
_WIDTH = 86.0
#: mm, for the first row of conditions.
_HEIGHT = 66.0
#: mm, for a further row.
_ROW_HEIGHT = 50.0
_COLUMNS = 3
#: mm, for the name of a condition above its panel.
_TITLE = 44.0
#: Room at both ends of the references, a factor.
_ROOM = 1.15
#: Span from which on powers of ten are labelled alone, as powers.
_LONG_SPAN = 1e3
#: Opacity of what lies between the limits: points and grid show through.
_FILL = 0.22


def line_drawings(results: Results) -> list[Drawing]:
    """Return a figure per quantity, with a panel for each condition."""
    drawings = []
    for parameter in distinct(results.pse_lines, "parameter"):
        rows = matching(results.pse_lines, parameter=parameter)
        every = distinct(rows, "condition")
        conditions = every[:MOST_OPEN]
        columns = min(_COLUMNS, len(conditions))
        further_rows = (len(conditions) - 1) // columns
        label = results.data.quantities[parameter].label
        drawing = Drawing(
            name=f"pse_{parameter}",
            title=f"Point of subjective equality of {label} over its reference",
            description=_caption(results, len(every) - len(conditions)),
            size=(_WIDTH if columns == 1 else WIDE, _HEIGHT + _ROW_HEIGHT * further_rows),
            draw=_draw_with(results, rows, conditions),
        )
        drawings.append(drawing)
    return drawings


def _draw_with(
    results: Results, rows: Sequence[PseLineRow], conditions: Sequence[str]
) -> Callable[[Figure], None]:
    """Return what draws the lines of a quantity on a figure."""
    parameter = rows[0].parameter
    quantity = results.data.quantities[parameter]
    cells = matching(results.data.cells, parameter=parameter)
    references = {cell.environment: cell.reference for cell in cells}
    of_quantity = matching(results.psychophysics, parameter=parameter)
    points = matching(of_quantity, measure="pse", method="bayesian")
    columns = min(_COLUMNS, len(conditions))
    titles = row_labels(conditions, most=_TITLE)
    ends = _ends(rows, points, references)

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(conditions), columns=columns, frame=Frame(bottom=18.0))
        for condition, title, ax in zip(conditions, titles, axes, strict=True):
            line = matching(rows, condition=condition)
            _draw_axes(ax, quantity, line, ends)
            _draw_line(ax, line)
            for point in points:
                # A cell's name ends with its condition.
                if str(point.environment).endswith(f" ({condition})" if condition else ""):
                    _draw_point(ax, point, references[str(point.environment)])
            ax.set_title(title or quantity.head, loc="left")
        outer_labels(axes, columns)
        legend(axes[0], ncols=2)

    return draw


def _ends(
    rows: Sequence[PseLineRow],
    points: Sequence[PsychophysicsRow],
    references: Mapping[str, float],
) -> tuple[float, float]:
    """Return the ends of the axis that all panels share: nothing far out flattens the rest."""
    lows = [row.lower_together / row.reference for row in rows]
    highs = [row.upper_together / row.reference for row in rows]
    for point in points:
        reference = references[str(point.environment)]
        lows.append(point.lower / reference)
        highs.append(point.upper / reference)
    return common_range(lows, highs, log=rows[0].family == "lognormal")


def _draw_line(ax: Axes, rows: Sequence[PseLineRow]) -> None:
    """Draw a line with both of its bands, over the reference."""
    reference = np.array([row.reference for row in rows])
    curves = {}
    for name in ("estimate", "lower", "upper", "lower_together", "upper_together"):
        curves[name] = np.array([getattr(row, name) for row in rows]) / reference
    colour = COLOURS["bayesian"]
    level = percent(rows[0].level)
    together = ax.fill_between(
        reference,
        curves["lower_together"],
        curves["upper_together"],
        color=colour,
        alpha=_FILL,
        linewidth=0.0,
        label=f"whole line, {level}",
    )
    drawn: list[Artist] = [together]
    for name in ("lower", "upper"):
        label = f"each reference, {level}"
        drawn += ax.plot(reference, curves[name], color=colour, linewidth=0.7, label=label)
    drawn += ax.plot(reference, curves["estimate"], color=colour, linewidth=1.6, label="line")
    mark(ax, drawn, "bayesian", "mean")


def _draw_point(ax: Axes, point: PsychophysicsRow, reference: float) -> None:
    """Draw an environment's estimate with its interval."""
    ends = np.array([point.lower, point.upper]) / reference
    bar = ax.plot([reference, reference], ends, color=COLOURS["ink"], linewidth=0.9)
    estimate = ax.plot(
        [reference],
        [point.estimate / reference],
        MARKERS["bayesian"],
        markersize=3.6,
        markerfacecolor=COLOURS["paper"],
        markeredgecolor=COLOURS["ink"],
    )
    mark(ax, [*bar, *estimate], "bayesian", "mean")


def _draw_axes(
    ax: Axes, quantity: Quantity, rows: Sequence[PseLineRow], ends: tuple[float, float]
) -> None:
    """Label the axes; on the dashed line a value seems what it is."""
    first = rows[0].reference
    last = rows[-1].reference
    span = last / first
    log_scale(ax, "x", plain=span < _LONG_SPAN)
    ax.xaxis.set_major_locator(LogLocator(subs=tick_steps(span)))
    ax.set_xlim(first / _ROOM, last * _ROOM)
    if rows[0].family == "lognormal":
        log_scale(ax, "y", plain=True)
        ax.yaxis.set_major_locator(LogLocator(subs=tick_steps(ends[1] / ends[0])))
    ax.set_ylim(ends)
    ax.axhline(1.0, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8)
    unit = f" ({quantity.unit})" if quantity.unit else ""
    ax.set_xlabel(f"reference{unit}")
    ax.set_ylabel("PSE / reference")


def _caption(results: Results, left_out: int) -> str:
    """Say what line, bands and marks stand for, and which conditions are not drawn."""
    words = words_of(results)
    said = (
        f"Line: where the {words.environments} lie on average, with limits at each reference and"
        " limits that hold the whole line. Marks with bars: the point of subjective equality of"
        f" each {words.environment}. Dashed: it equals the reference. All Bayesian."
    )
    if left_out:
        said += f" {counted(left_out, 'condition')} more in the table."
    return said
