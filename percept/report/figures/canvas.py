"""What figures are drawn on: axes placed in millimetres, in colours that everyone can tell apart."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from percept.report.numbers import SUPERSCRIPT

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


def panels(
    figure: Figure,
    count: int = 1,
    *,
    columns: int | None = None,
    left: float = 14.0,
    right: float = 3.0,
    top: float = 6.0,
    bottom: float = 11.0,
    gap: float = 12.0,
    line: float = 17.0,
) -> list[Axes]:
    """Add axes in rows, one row by default, placed in millimetres so that figures of one size line up."""
    width, height = (float(side) / MM for side in figure.get_size_inches())
    columns = columns or count
    rows = -(-count // columns)
    wide = (width - left - right - gap * (columns - 1)) / columns
    high = (height - top - bottom - line * (rows - 1)) / rows
    return [
        figure.add_axes(
            (
                (left + (index % columns) * (wide + gap)) / width,
                (bottom + (rows - 1 - index // columns) * (high + line)) / height,
                wide / width,
                high / height,
            )
        )
        for index in range(count)
    ]


#: An axis shows what most groups need on either side, and this many times that at most.
_GENEROUS = 3.0


def common_range(
    lows: ArrayLike, highs: ArrayLike, *, log: bool, centre: float = 1.0
) -> tuple[float, float]:
    """Return the ends of an axis for groups about a centre, ratios about 1: no group flattens the others."""
    ends = []
    for sign, sides in ((-1.0, lows), (1.0, highs)):
        values = np.asarray(sides, dtype=float)
        with np.errstate(divide="ignore"):
            out = np.maximum(
                sign * (np.log(np.maximum(values, 0.0)) if log else values - centre), 0.0
            )
        # An infinite end is cut off like any other that lies far out, and decides nothing.
        middle = float(np.median(out))
        far = (
            _GENEROUS * middle if 0.0 < middle < np.inf else out[np.isfinite(out)].max(initial=0.0)
        )
        end = sign * float(min(out.max(), far or 1.0))
        ends.append(float(np.exp(end)) if log else centre + end)
    return ends[0], ends[1]


def mark(ax: Axes, artists: Iterable[Artist], method: str, kind: str = "") -> None:
    """Name marks by what they show, so that the page can hide them."""
    axes = ax.figure.axes
    for artist in artists:
        # A file's ids are different.
        count = sum(
            str(other.get_gid()).startswith("mark-") for own in axes for other in own.get_children()
        )
        artist.set_gid(f"mark-{method}-{kind}-{count}")


def brief(value: float) -> str:
    """Write what lies beyond an axis: two digits, or a whole number."""
    return "∞" if not np.isfinite(value) else f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"


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


def legend(ax: Axes, **settings: Any) -> None:
    """Put the legend of some axes at an edge of their figure, below by default, each label once."""
    handles, labels = ax.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure = ax.get_figure(root=True)
    if figure is not None and named:
        below: dict[str, Any] = {"loc": "lower left", "ncols": 2, "borderaxespad": 0.2}
        figure.legend(named.values(), named.keys(), **below | settings)


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
    """Fit the names of rows or panels into a width, mm; names that look the same then are numbered."""
    labels = [_shortened(name, int(most / LETTER)) for name in names]
    if len(set(labels)) < len(labels):
        labels = [
            _shortened(f"{row}. {name}", int(most / LETTER))
            for row, name in enumerate(names, start=1)
        ]
    return labels


def _shortened(name: str, letters: int) -> str:
    # Names in a series differ at their ends: the middle goes.
    half = letters // 2
    return (
        name if len(name) <= letters else f"{name[: letters - 1 - half]}…{name[len(name) - half :]}"
    )
