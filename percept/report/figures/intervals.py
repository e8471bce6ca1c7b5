"""The overview: in a row for each environment every subject, and what intervals cover."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.report.figures.canvas import (
    COLOURS,
    MARKERS,
    REFERENCE_DASHES,
    WIDE,
    Drawing,
    label_between,
    legend,
    log_scale,
    panels,
    unique_labels,
)
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    MOST_OPEN,
    choice_said,
    chosen,
    compared_by_difference,
    distinct,
    families_of,
    first,
    foremost,
    kind_names,
    matching,
    words_of,
)
from percept.results import CellValues, IntervalRow, OverviewRow, Results
from percept.sessions.quantities import Quantity

__all__ = ["Bar", "Rows", "draw_intervals", "overview_drawings", "rows_of"]

FloatArray = NDArray[np.float64]

#: Points, by what an interval covers: the narrower the interval, the thicker its bar.
_THICKNESS = {"mean": 3.0, "user": 1.4, "share": 0.6}
#: Between two environments, in distances between two bars of one.
_GAP = 1.5
_MOST_LETTERS = 24
_FARTHEST = 1e4  # ratio to the reference that a figure shows
_ROOM = 0.02  # at both ends of an axis, as a share of its length
_LINE_HEIGHT = 2.1  # mm, of a bar or of the subjects
_HEIGHT = 24.0  # mm, of title, axis and legend


@dataclass(frozen=True, eq=False)
class Bar:
    """An interval to draw, divided by its reference, or less it in the quantity's unit."""

    environment: str
    kind: str
    method: str
    lower: float
    upper: float
    estimate: float


@dataclass(frozen=True, eq=False)
class Rows:
    """What is drawn of one quantity."""

    bars: list[Bar]
    subjects: dict[str, FloatArray]  # Values as those of the bars, by environment
    label: str  # Of the axis
    relative: bool  # Values are divided by their references; else they are less them
    log: bool

    @property
    def centre(self) -> float:
        """Where all references lie."""
        return 1.0 if self.relative else 0.0


def rows_of(
    intervals: Sequence[IntervalRow],
    cells: Sequence[CellValues],
    quantity: Quantity,
    kinds: Collection[str],
    families: Sequence[str],
) -> Rows:
    """Return the bars of a quantity, each in the first of the families, and its subjects."""
    rows = matching(intervals, parameter=quantity.name, joint="marginal")
    relative = quantity.name not in compared_by_difference(rows)
    bars: list[Bar] = []
    for name in distinct(rows, "environment"):
        for kind in kinds:
            for method in METHODS:
                of_bar = matching(rows, environment=name, kind=kind, method=method)
                row = first(of_bar, family=families)
                if row is not None and row.reference is not None:
                    ends = [row.lower, row.upper, row.estimate]
                    lower, upper, estimate = _against(ends, row.reference, relative=relative)
                    bars.append(Bar(name, kind, method, lower, upper, estimate))
    subjects = {
        cell.environment: _against(cell.values, cell.reference, relative=relative)
        for cell in matching(cells, parameter=quantity.name)
    }
    values = np.concatenate([*subjects.values(), [bar.lower for bar in bars]])
    log = families[0] == "lognormal" and relative and bool((values > 0).all())
    return Rows(bars, subjects, _axis_label(quantity, relative=relative), relative, log)


def _against(values: Sequence[float | None], reference: float, *, relative: bool) -> FloatArray:
    """Divide values by their reference, or subtract it."""
    array = np.array(values, dtype=float)
    return array / reference if relative else array - reference


def _axis_label(quantity: Quantity, *, relative: bool) -> str:
    if relative:
        return f"{quantity.words} / reference"
    unit = f" ({quantity.unit})" if quantity.unit else ""
    return f"{quantity.words} − reference{unit}" if quantity.is_matched else quantity.words + unit


def draw_intervals(
    ax: Axes,
    environments: Sequence[str],
    rows: Rows,
    *,
    kinds: Mapping[str, str],
    subject: str,
    labels: Sequence[str] | None = None,
) -> None:
    """Draw a row per environment: subjects as dots, kinds by thickness, methods by colour.

    Parameters
    ----------
    ax : Axes
        To draw on. Its ends hold every finite value; what is infinite reaches them.
    environments : sequence of str
        The rows, from the top.
    rows : Rows
        What is drawn of one quantity.
    kinds : mapping of str to str
        What kinds are called in the legend.
    subject : str
        What one subject is called.
    labels : sequence of str, optional
        Of the rows; their names by default.
    """
    methods = [method for method in METHODS if matching(rows.bars, method=method)]
    lines = [
        (kind, method)
        for kind in KINDS
        for method in methods
        if matching(rows.bars, kind=kind, method=method)
    ]
    left, right = _ends(environments, rows)
    pitch = len(lines) + _GAP
    ax.axvline(rows.centre, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8)
    for index, name in enumerate(environments):
        top = -pitch * index
        dots = rows.subjects.get(name, np.empty(0))
        ax.plot(
            dots,
            np.full(len(dots), top),
            ".",
            color=COLOURS["quiet"],
            markersize=3.4,
            label=f"one {subject}" if len(dots) else None,
        )
        for line, (kind, method) in enumerate(lines, start=1):
            for bar in matching(rows.bars, environment=name, kind=kind, method=method):
                _draw_bar(ax, bar, top - line, np.clip([bar.lower, bar.upper], left, right))
    # Lines of no length stand for methods and kinds in the legend.
    for method in methods:
        ax.plot([], [], color=COLOURS[method], linewidth=3, label=METHOD_NAMES[method])
    for kind in dict.fromkeys(kind for kind, _ in lines):
        ax.plot([], [], color=COLOURS["quiet"], linewidth=_THICKNESS[kind], label=kinds[kind])
    ax.set_xlim(left, right)
    if rows.log:
        log_scale(ax, "x", plain=True)
        label_between(ax, "x")
    middles = -pitch * np.arange(len(environments)) - len(lines) / 2
    ax.set_yticks(middles, environments if labels is None else labels)
    ax.set_ylim(-pitch * len(environments) + _GAP / 2, _GAP / 2)
    ax.set_xlabel(rows.label)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)


def _ends(environments: Sequence[str], rows: Rows) -> tuple[float, float]:
    """Return the ends of an axis that holds every finite value."""
    values: list[float] = []
    for name in environments:
        values += rows.subjects.get(name, np.empty(0)).tolist()
    for bar in rows.bars:
        if bar.environment in environments:
            values += [bar.lower, bar.upper]
    shown = np.array([*values, rows.centre])
    shown = shown[np.isfinite(shown)]
    if rows.log:
        # Limits of two subjects may span a hundred decades.
        shown = np.clip(shown, 1.0 / _FARTHEST, _FARTHEST)
        room = (shown.max() / shown.min()) ** _ROOM
        return float(shown.min() / room), float(shown.max() * room)
    room = _ROOM * float(np.ptp(shown) or 1.0)
    return float(shown.min()) - room, float(shown.max()) + room


def _draw_bar(ax: Axes, bar: Bar, y: float, ends: FloatArray) -> None:
    colour = COLOURS[bar.method]
    ax.plot(ends, [y, y], color=colour, linewidth=_THICKNESS[bar.kind])
    if bar.kind == "mean":
        ax.plot(
            [bar.estimate],
            [y],
            MARKERS[bar.method],
            markersize=3.2,
            markerfacecolor=COLOURS["paper"],
            markeredgecolor=colour,
        )


def overview_drawings(results: Results, overview: Sequence[OverviewRow]) -> list[Drawing]:
    """Return the figure of the foremost environments; of many, another one has all."""
    if not overview:
        return []
    names = distinct(overview, "environment")
    shown = foremost(overview)
    drawings = [_drawing(results, "overview", [name for name in names if name in shown])]
    if len(names) > len(shown):
        every = _drawing(results, "overview_all", chosen(names))
        drawings.append(every)
    return drawings


def _drawing(results: Results, name: str, environments: Sequence[str]) -> Drawing:
    """Return a figure with a panel per quantity."""
    words = words_of(results)
    quantities = [results.data.quantities[one] for one in distinct(results.intervals, "parameter")]
    kinds = [kind for kind in ("mean", "user") if matching(results.intervals, kind=kind)]
    rows = [
        rows_of(
            results.intervals,
            results.data.cells,
            quantity,
            kinds or ["share"],
            families_of(results),
        )
        for quantity in quantities
    ]
    columns = min(2, len(rows))

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(rows), columns=columns)
        for ax, quantity, own in zip(axes, quantities, rows, strict=True):
            draw_intervals(
                ax,
                environments,
                own,
                kinds=kind_names(results.data.words),
                subject=words.subject,
                labels=unique_labels(environments, _MOST_LETTERS),
            )
            ax.set_title(quantity.head, loc="left")
        legend(axes, ncols=5)

    lines = max(len({(bar.kind, bar.method) for bar in own.bars}) for own in rows) + _GAP
    every = distinct(results.intervals, "environment")
    said = f"What {words.users} {words.verb}"
    if len(environments) < len(every):
        said += f": {len(environments)} of {len(every)} {words.environments}"
    left_out = choice_said(every, words.environments) if len(environments) > MOST_OPEN else ""
    height = _HEIGHT + _LINE_HEIGHT * lines * len(environments)
    return Drawing(
        name=name,
        title=said,
        description="Dots: the "
        f"{words.subjects}. Bars: intervals of the average and the next {words.user}. Dashed: the"
        f" reference.{left_out}",
        size=(WIDE / 2 if columns == 1 else WIDE, height * -(-len(rows) // columns)),
        draw=draw,
    )
