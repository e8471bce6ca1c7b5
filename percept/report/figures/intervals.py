"""The overview: in a row for each environment every subject, and what intervals cover."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from percept.report.biases import Bias, biases_of, drawn_said, foremost
from percept.report.figures.canvas import (
    COLOURS,
    Drawing,
    draw_interval,
    legend,
    log_scale,
    method_legend,
    panels,
    reference_line,
    shortened,
)
from percept.report.select import KINDS, METHODS, distinct, kind_names, matching
from percept.results import CellValues, Results
from percept.sessions.quantities import Quantity

FloatArray = NDArray[np.float64]

#: Points, by what an interval covers: the narrower the interval, the thicker its bar.
_THICKNESS = {"mean": 3.0, "user": 1.4, "share": 0.6}
#: Between two environments, in distances between two bars of one.
_GAP = 1.5
_MOST_LETTERS = 20
_FARTHEST = 1e4  # ratio to the reference that a figure shows
_ROOM = 0.02  # at both ends of an axis, as a share of its length
_LINE_HEIGHT = 1.9  # mm, of a bar or of the subjects
_HEIGHT = 22.0  # mm, of title, axis and legend


def draw_intervals(
    ax: Axes,
    environments: Sequence[str],
    biases: Sequence[Bias],
    cells: Sequence[CellValues],
    quantity: Quantity,
    *,
    kinds: Mapping[str, str],
    subject: str,
) -> None:
    """Draw a row per environment: subjects as dots, kinds by thickness, methods by colour.

    Parameters
    ----------
    ax : Axes
        To draw on. Its ends hold every finite value; what is infinite reaches them.
    environments : sequence of str
        The rows, from the top.
    biases : sequence of Bias
        Intervals of one quantity, at least one.
    cells : sequence of CellValues
        Values of the subjects.
    quantity : Quantity
        What is drawn.
    kinds : mapping of str to str
        What kinds are called in the legend.
    subject : str
        What one subject is called.
    """
    relative = biases[0].relative
    bars = []  # Each with its limits and estimate against the reference
    for bias in biases:
        row = bias.row
        if row.environment in environments:
            ends = _against([row.lower, row.upper, row.estimate], row.reference, relative=relative)
            bars.append((row, ends))
    dots = {}
    for cell in matching(cells, parameter=quantity.name):
        if cell.environment in environments:
            dots[cell.environment] = _against(cell.values, cell.reference, relative=relative)
    values = np.concatenate([*dots.values(), *(ends for _, ends in bars)])
    log = biases[0].row.family == "lognormal" and relative and bool((values > 0).all())
    left, right = _ends(np.append(values, float(relative)), log=log)
    rows = [row for row, _ in bars]
    lines = [(k, m) for k in KINDS for m in METHODS if matching(rows, kind=k, method=m)]
    pitch = len(lines) + _GAP
    reference_line(ax, float(relative))
    for index, name in enumerate(environments):
        top = -pitch * index
        x = dots.get(name, np.empty(0))
        label = f"one {subject}" if len(x) else None
        ax.plot(x, np.full(len(x), top), ".", color=COLOURS["quiet"], markersize=3.4, label=label)
        for row, ends in bars:
            if row.environment == name:
                place = top - 1 - lines.index((row.kind, row.method))
                shown = np.clip(ends[:2], left, right)
                estimate = ends[2] if row.kind == "mean" else None
                width = _THICKNESS[row.kind]
                draw_interval(ax, place, shown, estimate, row.method, width=width)
    method_legend(ax, [method for method in METHODS if matching(rows, method=method)])
    for kind in dict.fromkeys(kind for kind, _ in lines):
        ax.plot([], [], color=COLOURS["quiet"], linewidth=_THICKNESS[kind], label=kinds[kind])
    ax.set_xlim(left, right)
    if log:
        log_scale(ax, "x", plain=True)
    middles = -pitch * np.arange(len(environments)) - len(lines) / 2
    ax.set_yticks(middles, shortened(environments, _MOST_LETTERS))
    ax.set_ylim(-pitch * len(environments) + _GAP / 2, _GAP / 2)
    unit = f" ({quantity.unit})" if quantity.unit else ""
    against = " − reference" if quantity.is_matched else ""
    ax.set_xlabel(quantity.words + (" / reference" if relative else f"{against}{unit}"))
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)


def _against(values: ArrayLike, reference: float | None, *, relative: bool) -> FloatArray:
    """Divide values by their reference, or subtract it."""
    array = np.asarray(values, dtype=float)
    return array / reference if relative and reference else array - (reference or 0.0)


def _ends(values: FloatArray, *, log: bool) -> tuple[float, float]:
    """Return the ends of an axis that holds every finite value."""
    shown = values[np.isfinite(values)]
    if log:
        # Limits of two subjects may span a hundred decades.
        shown = np.clip(shown, 1.0 / _FARTHEST, _FARTHEST)
        room = (shown.max() / shown.min()) ** _ROOM
        return float(shown.min() / room), float(shown.max() * room)
    room = _ROOM * float(np.ptp(shown) or 1.0)
    return float(shown.min()) - room, float(shown.max()) + room


def overview_drawings(results: Results) -> list[Drawing]:
    """Return the figure of the foremost environments, a panel per quantity."""
    environments = foremost(results)
    if not environments:
        return []
    words = results.data.words
    kinds = [kind for kind in ("mean", "user") if matching(results.intervals, kind=kind)]
    every = []
    for kind in kinds or ["share"]:
        for method in METHODS:
            every += biases_of(results, kind, method=method)
    names = distinct(every, "parameter")
    columns = min(2, len(names))

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(names), columns=columns)
        for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
            quantity = results.data.quantities[name]
            draw_intervals(
                ax,
                environments,
                matching(every, parameter=name),
                results.data.cells,
                quantity,
                kinds=kind_names(words.user, words.users),
                subject=words.subject,
            )
            ax.set_title(quantity.head, loc="left")
            if index % columns:
                ax.tick_params(axis="y", labelleft=False)
        legend(axes, ncols=3)

    lines = len({(bias.row.kind, bias.row.method) for bias in every}) + _GAP
    height = _HEIGHT + _LINE_HEIGHT * lines * len(environments)
    return [
        Drawing(
            name="overview",
            title=f"What {words.users} {words.verb}",
            description="Dots: the "
            f"{words.subjects}. Bars: intervals of the average and the next {words.user}. Dashed:"
            f" the reference. {drawn_said(results)}".rstrip(),
            height=height * -(-len(names) // columns),
            draw=draw,
        )
    ]
