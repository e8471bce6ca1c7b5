"""What figures are drawn on: panels that make room for their labels, and colours for everyone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from percept.report.numbers import SUPERSCRIPT
from percept.report.select import METHOD_NAMES

# Blue and vermilion remain apart in every common form of colour blindness, and form tells them
# apart as well. The names come from the page's style sheet, where the dark page has its own values.
COLOURS = {
    "ink": "#1c2127",
    "quiet": "#667079",
    "rule": "#d4d9de",
    "paper": "#fffffe",
    "classical": "#0067a5",
    "bayesian": "#c44e00",
    "coupled": "#007a5a",
    "warn": "#a8326e",
}

#: Marks tell the methods apart where colours do not.
MARKERS = {"classical": "o", "bayesian": "D"}
REFERENCE_DASHES = (0, (7, 3))
#: Inches.
MM = 1 / 25.4
#: mm, of every figure: a column of a journal, and of the page.
WIDTH = 87.5
#: Ends of a logarithmic axis over each other, up to which more is labelled than powers of ten.
_SHORT_SPAN = 5.0
_LONG_SPAN = 1e3
#: Over so many decades only every second or fifth power is labelled.
_MOST_TICKS = 5


@dataclass(frozen=True)
class Drawing:
    """A figure before it is drawn."""

    name: str  # Of its file, without ending
    title: str  # What it shows, in a few words
    description: str  # What a reader who cannot see it should know
    height: float  # mm
    draw: Callable[[Figure], None]  # Draws on an empty matplotlib Figure with constrained layout


def panels(figure: Figure, count: int = 1, *, columns: int | None = None) -> list[Axes]:
    """Add axes row by row from the top, all in one row by default."""
    columns = columns or count
    rows = -(-count // columns)
    axes: list[Axes] = list(figure.subplots(rows, columns, squeeze=False).flat)
    for spare in axes[count:]:
        spare.remove()
    return axes[:count]


def log_scale(ax: Axes, axes: str = "xy", *, plain: bool = False) -> None:
    """Make axes logarithmic, without minor ticks; as plain numbers between ends that are set."""
    for name in axes:
        ax.set(**{f"{name}scale": "log"})
        axis = {"x": ax.xaxis, "y": ax.yaxis}[name]
        axis.minorticks_off()
        # In letters: matplotlib's formulas take longer than the figure.
        axis.set_major_formatter("{x:g}" if plain else _power_of_ten)
        low, high = sorted(axis.get_view_interval())
        steps: tuple[float, ...] = (1,)
        if plain and high < _SHORT_SPAN * low:
            steps = (1, 1.2, 1.5, 2, 3, 5, 7)
        elif plain and high < _LONG_SPAN * low:
            steps = (1, 2, 5)
        axis.set_major_locator(LogLocator(subs=steps, numticks=_MOST_TICKS))


def _power_of_ten(x: float, _: object) -> str:
    return f"10{str(round(np.log10(x))).translate(SUPERSCRIPT)}"


def legend(axes: Sequence[Axes], *, ncols: int = 4) -> None:
    """Put one legend of some axes below their figure, each label once."""
    named: dict[str, Artist] = {}
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        named |= dict(zip(labels, handles, strict=True))
    figure = axes[0].get_figure(root=True)
    if figure is not None and named:
        figure.legend(list(named.values()), list(named), loc="outside lower left", ncols=ncols)


def method_legend(ax: Axes, methods: Sequence[str]) -> None:
    """Name methods in the legend by lines of no length."""
    for method in methods:
        ax.plot([], [], color=COLOURS[method], linewidth=3, label=METHOD_NAMES[method])


def reference_line(ax: Axes, place: float, across: Literal["x", "y"] = "x") -> None:
    """Draw where all references lie, or where nothing differs."""
    line = {"x": ax.axvline, "y": ax.axhline}[across]
    line(place, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8)


def draw_interval(
    ax: Axes,
    place: float,
    limits: Iterable[float],
    estimate: float | None,
    method: str,
    *,
    width: float = 2.4,
    upright: bool = False,
) -> None:
    """Draw an interval as a bar, and its estimate as a mark if there is one."""
    along = list(limits)
    beside = [place, place]
    colour = COLOURS[method]
    ax.plot(*((beside, along) if upright else (along, beside)), color=colour, linewidth=width)
    if estimate is not None:
        at = ([place], [estimate]) if upright else ([estimate], [place])
        ax.plot(
            *at, MARKERS[method], markersize=3.4, markerfacecolor=COLOURS["paper"],
            markeredgecolor=colour,
        )  # fmt: skip


def shortened(names: Sequence[str], letters: int) -> list[str]:
    """Cut long names in the middle: names in a series differ at their ends."""
    end = letters // 2
    return [
        name if len(name) <= letters else f"{name[: letters - 1 - end]}…{name[len(name) - end :]}"
        for name in names
    ]
