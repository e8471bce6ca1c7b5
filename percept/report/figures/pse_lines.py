"""Points of subjective equality over the reference: environments, and the line they lie about."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

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
from percept.report.select import choice_said, chosen, distinct, matching, words_of
from percept.results import PseLineRow, PsychophysicsRow, Results
from percept.sessions.quantities import Quantity

__all__ = ["line_drawings"]

FloatArray = NDArray[np.float64]

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
#: Span of the references from which on powers of ten alone are labelled: more labels touch.
_LONG_SPAN = 100.0
#: Opacity of what lies between the limits: points and grid show through.
_FILL = 0.22


def line_drawings(results: Results) -> list[Drawing]:
    """Return a figure per quantity, with a panel for each condition."""
    words = words_of(results)
    said = (
        f"Line: where the {words.environments} lie on average. Band: its limits at each reference."
        f" Marks with bars: the point of subjective equality of each {words.environment}. Dashed:"
        " it equals the reference. All Bayesian."
    )
    drawings = []
    for parameter in distinct(results.pse_lines, "parameter"):
        conditions = distinct(matching(results.pse_lines, parameter=parameter), "condition")
        shown = chosen(conditions)
        columns = min(_COLUMNS, len(shown))
        further_rows = (len(shown) - 1) // columns
        drawing = Drawing(
            name=f"pse_{parameter}",
            title="Points of subjective equality over the reference",
            description=said + choice_said(conditions, "conditions"),
            size=(_WIDTH if columns == 1 else WIDE, _HEIGHT + _ROW_HEIGHT * further_rows),
            draw=_draw_with(results, parameter, shown),
        )
        drawings.append(drawing)
    return drawings


def _draw_with(
    results: Results, parameter: str, conditions: Sequence[str]
) -> Callable[[Figure], None]:
    """Return what draws the lines of a quantity on a figure."""
    quantity = results.data.quantities[parameter]
    rows = matching(results.pse_lines, parameter=parameter)
    # Published limits have no cells of values; every environment has intervals.
    intervals = matching(results.intervals, parameter=parameter)
    references = {row.environment: row.reference for row in intervals if row.reference is not None}
    of_quantity = matching(results.psychophysics, parameter=parameter, method="bayesian")
    points = matching(of_quantity, measure="pse")
    columns = min(_COLUMNS, len(conditions))
    titles = row_labels(conditions, most=_TITLE)

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(conditions), columns=columns, frame=Frame(bottom=18.0))
        lows = []
        highs = []
        for condition, title, ax in zip(conditions, titles, axes, strict=True):
            line = matching(rows, condition=condition)
            # A cell's name ends with its condition.
            ending = f" ({condition})" if condition else ""
            own = [point for point in points if str(point.environment).endswith(ending)]
            band = _draw_line(ax, line)
            bars = _draw_points(ax, own, [references[str(point.environment)] for point in own])
            lows += [*band[0], *bars[0]]
            highs += [*band[1], *bars[1]]
            ax.set_title(title or quantity.head, loc="left")
        ends = common_range(lows, highs, log=rows[0].family == "lognormal")
        for ax in axes:
            _draw_axes(ax, quantity, rows, ends)
        outer_labels(axes, columns)
        legend(axes[0], ncols=2)

    return draw


def _draw_line(ax: Axes, rows: Sequence[PseLineRow]) -> FloatArray:
    """Draw a line with its band; return the limits of the band, (2, n)."""
    reference = np.array([row.reference for row in rows])
    band = np.array([(row.lower, row.upper) for row in rows]).T / reference
    estimate = np.array([row.estimate for row in rows]) / reference
    colour = COLOURS["bayesian"]
    label = f"each reference, {percent(rows[0].level)}"
    drawn = ax.fill_between(reference, *band, color=colour, alpha=_FILL, linewidth=0.0, label=label)
    line = ax.plot(reference, estimate, color=colour, linewidth=1.6, label="line")
    mark(ax, [drawn, *line], "bayesian", "mean")
    return band


def _draw_points(
    ax: Axes, points: Sequence[PsychophysicsRow], references: Sequence[float]
) -> FloatArray:
    """Draw what each environment has of its own; return the ends of the bars, (2, n)."""
    limits = np.array([(point.lower, point.upper) for point in points]).T / references
    estimates = np.array([point.estimate for point in points]) / references
    drawn = ax.errorbar(
        references,
        estimates,
        np.abs(limits - estimates),
        fmt=MARKERS["bayesian"],
        color=COLOURS["ink"],
        markersize=3.6,
        markerfacecolor=COLOURS["paper"],
        linewidth=0.9,
    )
    mark(ax, drawn.get_children(), "bayesian", "mean")
    return limits


def _draw_axes(
    ax: Axes, quantity: Quantity, rows: Sequence[PseLineRow], ends: tuple[float, float]
) -> None:
    """Label the axes; on the dashed line a value seems what it is."""
    first = rows[0].reference
    last = rows[-1].reference
    span = last / first
    short = span < _LONG_SPAN
    log_scale(ax, "x", plain=short)
    ax.xaxis.set_major_locator(LogLocator(subs=tick_steps(span) if short else (1,)))
    ax.set_xlim(first / _ROOM, last * _ROOM)
    if rows[0].family == "lognormal":
        log_scale(ax, "y", plain=True)
        ax.yaxis.set_major_locator(LogLocator(subs=tick_steps(ends[1] / ends[0])))
    ax.set_ylim(ends)
    ax.axhline(1.0, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8)
    unit = f" ({quantity.unit})" if quantity.unit else ""
    ax.set_xlabel(f"reference {quantity.words}{unit}")
    ax.set_ylabel("PSE / reference")
