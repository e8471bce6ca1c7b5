"""What figures are drawn on: axes placed in millimetres, in colours that everyone can tell apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

    from percept.report.figures.svg.axes import SvgAxes, SvgFigure

    #: Ours, which write SVG at once, or matplotlib's, for PDF and PNG.
    Figure = SvgFigure | matplotlib.figure.Figure
    Axes = SvgAxes | matplotlib.axes.Axes
else:
    Figure = Axes = Any

__all__ = [
    "COLOURS",
    "MM",
    "Axes",
    "Drawing",
    "Figure",
    "grid",
    "legend_below",
    "panels",
    "plain_text",
]

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
    """A figure that has not been drawn yet.

    Attributes
    ----------
    name : str
        Of its file, without ending; never made from text of the input.
    title : str
        What it shows, in a few words.
    description : str
        What a reader who cannot see it should know.
    size : tuple of float
        Width and height, mm.
    draw : callable
        Draws on an empty Figure, ours or matplotlib's.
    """

    name: str
    title: str
    description: str
    size: tuple[float, float]
    draw: Callable[[Figure], None]


def plain_text(text: str) -> str:
    """Return text that is drawn as it stands, dollar signs included."""
    return text.replace("\\", "\\\\").replace("$", r"\$") if "$" in text else text


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
    """Add axes in a row, placed in millimetres so that figures of one size line up.

    Parameters
    ----------
    figure : Figure
        Where to add them.
    left, right, top, bottom : float
        Margins, mm.
    gap : float
        Between axes, mm.
    columns : int
        How many.

    Returns
    -------
    list of Axes
    """
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
    """Add axes in rows, placed in millimetres.

    Parameters
    ----------
    figure : Figure
        Where to add them.
    count : int
        How many in all.
    columns : int
        How many in a row.
    left, right, top, bottom : float
        Margins, mm.
    gap, line : float
        Between axes, sideways and from row to row, mm.

    Returns
    -------
    list of Axes
        Row by row from the top left.
    """
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
    """Put the legend of some axes at the lower edge of their figure."""
    handles, labels = ax.get_legend_handles_labels()
    # Of either library, and its own axes' marks.
    figure: Any = ax.get_figure(root=True)
    if figure is not None and handles:
        figure.legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0.0, 0.0), ncols=columns, borderaxespad=0.2
        )
