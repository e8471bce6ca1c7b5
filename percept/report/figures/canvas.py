"""What figures are drawn on: axes placed in millimetres, colours that everyone can tell apart."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from percept.report.numbers import SUPERSCRIPT

__all__ = [
    "COLOURS", "GROUND", "LETTER", "MARKERS", "MM", "REFERENCE_DASHES", "WIDE", "Drawing", "Frame",
    "brief", "common_range", "legend", "log_scale", "mark", "outer_labels", "panels", "row_labels",
]  # fmt: skip

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

#: Keeps names and values readable over lines.
GROUND = {"facecolor": COLOURS["paper"], "edgecolor": "none", "pad": 0.4}
#: Marks tell the methods apart where colours do not.
MARKERS = {"classical": "o", "bayesian": "D"}
REFERENCE_DASHES = (0, (7, 3))
#: Inches.
MM = 1 / 25.4
#: mm, a figure as wide as the page.
WIDE = 175.0


@dataclass(frozen=True)
class Drawing:
    """A figure: what it says, how it is drawn, and once it is drawn its form on the page."""

    name: str  # Of its file, without ending
    title: str  # What it shows, in a few words
    description: str  # What a reader who cannot see it should know
    size: tuple[float, float]  # Width and height, mm
    draw: Callable[[Figure], None]  # Draws on an empty matplotlib Figure
    svg: str = ""  # ``<svg>`` element for a page
    formats: tuple[str, ...] = ()  # Of the files written


@dataclass(frozen=True)
class Frame:
    """Room around panels and between them, mm."""

    left: float = 14.0
    right: float = 3.0
    top: float = 6.0
    bottom: float = 11.0
    gap: float = 12.0  # Between columns
    line: float = 17.0  # Between rows


def panels(
    figure: Figure, count: int = 1, *, columns: int | None = None, frame: Frame | None = None
) -> list[Axes]:
    """Add axes placed in millimetres, so that figures of one size line up.

    Parameters
    ----------
    figure : Figure
        Of the size it will have.
    count : int
        How many axes.
    columns : int, optional
        Axes in a row; all in one by default.
    frame : Frame, optional
        Room around and between them.

    Returns
    -------
    list of Axes
        Row by row, from the top.
    """
    frame = frame or Frame()
    sides = figure.get_size_inches() / MM
    width = float(sides[0])
    height = float(sides[1])
    columns = columns or count
    rows = -(-count // columns)
    panel_width = (width - frame.left - frame.right - frame.gap * (columns - 1)) / columns
    panel_height = (height - frame.top - frame.bottom - frame.line * (rows - 1)) / rows
    axes = []
    for index in range(count):
        row, column = divmod(index, columns)
        x = frame.left + column * (panel_width + frame.gap)
        y = frame.bottom + (rows - 1 - row) * (panel_height + frame.line)
        place = (x / width, y / height, panel_width / width, panel_height / height)
        axes.append(figure.add_axes(place))
    return axes


#: An axis shows what most groups need on either side, and this many times that at most.
_GENEROUS = 3.0


def common_range(
    lows: ArrayLike, highs: ArrayLike, *, log: bool, centre: float = 1.0
) -> tuple[float, float]:
    """Return the ends of an axis for groups about a centre: no group flattens the others.

    Parameters
    ----------
    lows, highs : array_like, shape (n,)
        Ends of each group.
    log : bool
        Whether the axis is logarithmic; its centre is 1.
    centre : float
        Where every group lies about.

    Returns
    -------
    tuple of float
        The lower and the upper end.
    """
    lows = np.asarray(lows, dtype=float)
    highs = np.asarray(highs, dtype=float)
    if log:
        with np.errstate(divide="ignore"):
            below = _reach(-np.log(np.maximum(lows, 0.0)))
            above = _reach(np.log(np.maximum(highs, 0.0)))
        return float(np.exp(-below)), float(np.exp(above))
    return centre - _reach(centre - lows), centre + _reach(highs - centre)


def _reach(distances: NDArray[np.float64]) -> float:
    """Return how far an axis goes to one side: what most groups need there, and not much more."""
    distances = np.maximum(distances, 0.0)
    middle = float(np.median(distances))
    # An infinite end is cut off like any other that lies far out, and decides nothing.
    if 0.0 < middle < np.inf:
        most = _GENEROUS * middle
    else:
        most = float(distances[np.isfinite(distances)].max(initial=0.0))
    return float(min(distances.max(), most or 1.0))


def mark(ax: Axes, artists: Iterable[Artist], method: str, kind: str = "") -> None:
    """Name marks by what they show, so that the page can hide them."""
    # A file's ids are different.
    marked = 0
    for other in ax.figure.axes:
        marked += sum(str(one.get_gid()).startswith("mark-") for one in other.get_children())
    for number, artist in enumerate(artists, start=marked):
        artist.set_gid(f"mark-{method}-{kind}-{number}")


def brief(value: float) -> str:
    """Write what lies beyond an axis: two digits, or a whole number of at most five."""
    if not np.isfinite(value):
        return "∞"
    if 100 <= abs(value) < 1e5:
        return f"{value:.0f}"
    return f"{value:.2g}"


def log_scale(ax: Axes, axes: str = "xy", *, plain: bool = False) -> None:
    """Make axes logarithmic, without minor ticks; powers of ten on request as plain numbers."""
    for name in axes:
        ax.set(**{f"{name}scale": "log"})
        axis = {"x": ax.xaxis, "y": ax.yaxis}[name]
        axis.minorticks_off()
        # In letters: matplotlib's formulas take longer than the figure.
        axis.set_major_formatter("{x:g}" if plain else _power_of_ten)


def _power_of_ten(x: float, _: object) -> str:
    return f"10{str(round(np.log10(x))).translate(SUPERSCRIPT)}"


def legend(
    ax: Axes, *, loc: Literal["lower left", "center right"] = "lower left", ncols: int = 2
) -> None:
    """Put the legend of some axes at an edge of their figure, below by default, each label once."""
    handles, labels = ax.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure = ax.get_figure(root=True)
    if figure is not None and named:
        figure.legend(named.values(), named.keys(), loc=loc, ncols=ncols, borderaxespad=0.2)


def outer_labels(axes: Sequence[Axes], columns: int) -> None:
    """Keep the labels of the left and the lowest panels of a grid that shares its axes."""
    for index, ax in enumerate(axes):
        if index % columns:
            ax.tick_params(labelleft=False)
            ax.set_ylabel("")
        if index + columns < len(axes):
            ax.tick_params(labelbottom=False)
            ax.set_xlabel("")


#: Width of a letter of a label, mm, on the wide side.
LETTER = 1.45


def row_labels(names: Sequence[str], *, most: float) -> list[str]:
    """Fit names of rows or panels into a width, mm; equal short names are numbered."""
    letters = int(most / LETTER)
    labels = [_shortened(name, letters) for name in names]
    if len(set(labels)) == len(labels):
        return labels
    return [_shortened(f"{row}. {name}", letters) for row, name in enumerate(names, start=1)]


def _shortened(name: str, letters: int) -> str:
    if len(name) <= letters:
        return name
    # Names in a series differ at their ends: the middle goes.
    end = letters // 2
    return f"{name[: letters - 1 - end]}…{name[len(name) - end :]}"
