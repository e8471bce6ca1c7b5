"""What figures are drawn on: axes placed in millimetres, in colours that everyone can tell apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    # Importing matplotlib takes long: only drawing does it.
    Figure = Axes = Any

# Blue and vermilion remain apart in every common form of colour blindness, and form tells them apart as well.
# The names are those of the page's style sheet, where the dark page has its own values.
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


@dataclass(frozen=True)
class Drawing:
    """A figure that has not been drawn yet."""

    name: str  # Of its file, without ending
    title: str  # What it shows, in a few words
    description: str  # What a reader who cannot see it should know
    size: tuple[float, float]  # Width and height, mm
    draw: Callable[[Figure], None]  # Draws on an empty matplotlib Figure


def panels(
    figure: Figure,
    *,
    left: float = 14.0,
    right: float = 3.0,
    top: float = 6.0,
    bottom: float = 11.0,
    gap: float = 12.0,
    columns: int = 1,
) -> list[Axes]:
    """Add axes in a row, placed in millimetres so that figures of one size line up."""
    return grid(figure, columns, columns=columns, left=left, right=right, top=top, bottom=bottom, gap=gap)


def grid(
    figure: Figure,
    count: int,
    *,
    columns: int,
    left: float = 14.0,
    right: float = 3.0,
    top: float = 6.0,
    bottom: float = 11.0,
    gap: float = 12.0,
    line: float = 17.0,
) -> list[Axes]:
    """Add axes in rows, placed in millimetres."""
    width, height = (float(side) / MM for side in figure.get_size_inches())
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


def legend_below(ax: Axes, *, columns: int = 2) -> None:
    """Put the legend of some axes at the lower edge of their figure, each label once."""
    handles, labels = ax.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure = ax.get_figure(root=True)
    if figure is not None and named:
        figure.legend(
            named.values(),
            named.keys(),
            loc="lower left",
            bbox_to_anchor=(0.0, 0.0),
            ncols=columns,
            borderaxespad=0.2,
        )


def row_labels(names: Sequence[str], *, most: float) -> tuple[list[str], float]:
    """Fit the names of rows into a margin.

    A name that is too long loses its middle, since names in a series differ at their ends; names that look
    the same then are numbered.
    """
    labels = [_shortened(name, most) for name in names]
    if len(set(labels)) < len(labels):
        labels = [_shortened(f"{row}. {name}", most) for row, name in enumerate(names, start=1)]
    return labels, max(map(_width, labels))


def _shortened(name: str, most: float) -> str:
    width = _width(name)
    if width <= most:
        return name
    kept = int(len(name) * most / width)
    while True:
        label = f"{name[: kept - kept // 2]}…{name[len(name) - kept // 2 :]}"
        if kept <= 2 or _width(label) <= most:
            return label
        kept -= 1


def _width(label: str) -> float:
    from matplotlib import rcParams
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=rcParams["ytick.labelsize"])
    points: float = text_to_path.get_text_width_height_descent(label, font, ismath=False)[0]
    return points / 72.0 / MM


def shade_boxes(
    ax: Axes, boxes: NDArray[np.float64], *, color: str, alpha: float, label: str | None = None
) -> None:
    """Shade boxes that do not overlap, without outline, all as one mark."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    corners = boxes[:, [[0, 2], [1, 2], [1, 3], [0, 3]]]
    closed = np.concatenate([corners, corners[:, :1]], axis=1)
    # Where boxes touch, smoothed edges would leave a light line.
    mark = PathPatch(
        Path.make_compound_path_from_polys(closed),
        color=color,
        alpha=alpha,
        linewidth=0,
        antialiased=False,
        label=label,
    )
    ax.add_artist(mark)
    # add_patch would look for the extent segment by segment.
    ax.update_datalim(corners.reshape(-1, 2))
    ax.autoscale_view()
