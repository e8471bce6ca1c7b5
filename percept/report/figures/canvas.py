"""From a drawing to a file: one style, sizes in millimetres, the same bytes from the same input."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from percept.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "COLOURS",
    "FORMATS",
    "Drawing",
    "drawn",
    "grid",
    "inline_svg",
    "legend_below",
    "panels",
    "plain_text",
    "rendered",
]

FORMATS = ("svg", "pdf", "png")

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

_MM = 1 / 25.4
_STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.5,
    "axes.titlesize": 8.0,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.edgecolor": COLOURS["quiet"],
    "axes.labelcolor": COLOURS["ink"],
    "axes.titlecolor": COLOURS["ink"],
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "grid.color": COLOURS["rule"],
    "grid.linewidth": 0.4,
    "text.color": COLOURS["ink"],
    "xtick.color": COLOURS["quiet"],
    "ytick.color": COLOURS["quiet"],
    "xtick.labelcolor": COLOURS["ink"],
    "ytick.labelcolor": COLOURS["ink"],
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 6.8,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt",
    "mathtext.fontset": "dejavusans",
    "pdf.fonttype": 42,
    "svg.hashsalt": "percept",
}


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
        Draws on an empty matplotlib Figure.
    """

    name: str
    title: str
    description: str
    size: tuple[float, float]
    draw: Callable[[Figure], None]


def plain_text(text: str) -> str:
    """Return text that matplotlib draws as it stands, dollar signs included."""
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
    figure : matplotlib Figure
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
    figure : matplotlib Figure
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
    width, height = (float(side) / _MM for side in figure.get_size_inches())
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
    figure = ax.get_figure(root=True)
    if figure is not None and handles:
        figure.legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0.0, 0.0), ncols=columns, borderaxespad=0.2
        )


def drawn(drawing: Drawing) -> Figure:
    """Draw once, for any number of formats.

    Parameters
    ----------
    drawing : Drawing
        What to draw.

    Returns
    -------
    Figure
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        width, height = drawing.size
        figure = Figure(figsize=(width * _MM, height * _MM))
        drawing.draw(figure)
    return figure


def rendered(figure: Figure, form: str, *, dpi: int = 300) -> bytes:
    """Write a drawn figure for a file: fonts embedded, white ground.

    Parameters
    ----------
    figure : Figure
        As `drawn` returns it.
    form : {"svg", "pdf", "png"}
        The format.
    dpi : int
        Dots per inch of a PNG.

    Returns
    -------
    bytes
        The same for the same drawing.

    Raises
    ------
    UsageError
        Another format.
    """
    if form not in FORMATS:
        raise UsageError(f"figures come as {', '.join(FORMATS)}.", value=form)
    return _saved(figure, form, {"svg.fonttype": "path"}, dpi=dpi, facecolor="white")


def inline_svg(figure: Figure, drawing: Drawing) -> str:
    """Write a drawn figure for the page: an ``<svg>`` with a title, text as text, and the page's colours.

    Parameters
    ----------
    figure : Figure
        As `drawn` returns it.
    drawing : Drawing
        What it shows.

    Returns
    -------
    str
        Safe to put into HTML; every id starts with ``svg-`` and the drawing's name.
    """
    body = _saved(figure, "svg", {"svg.fonttype": "none"}, dpi=72, facecolor="none").decode("utf-8")
    opening, _, rest = body[body.index("<svg") :].partition(">")
    for pattern, replacement in _INLINE:
        rest = pattern.sub(replacement.replace("NAME", drawing.name), rest)
    for name, colour in COLOURS.items():
        rest = rest.replace(colour, f"var(--{name})")
    width = drawing.size[0]
    box = re.search(r'viewBox="[^"]*"', opening)
    if box is None:
        raise RuntimeError("matplotlib wrote an SVG without a viewBox.")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {box[0]} '
        f'style="min-width:{width * _LEAST:.4g}rem;max-width:{width * _MOST:.4g}rem" '
        f'role="img" aria-labelledby="svg-{drawing.name}-title svg-{drawing.name}-desc">'
        f'<title id="svg-{drawing.name}-title">{escape(drawing.title)}</title>'
        f'<desc id="svg-{drawing.name}-desc">{escape(drawing.description)}</desc>' + rest.strip()
    )


# rem per mm: at the most a figure's lettering is as large as the page's small print, at the least readable.
_LEAST, _MOST = 0.165, 0.3
_INLINE = tuple(
    (re.compile(pattern, re.DOTALL), replacement)
    for pattern, replacement in (
        (r"<metadata>.*?</metadata>|<!--.*?-->", ""),
        (r'\bid="([^"]+)"', r'id="svg-NAME-\1"'),
        (r'xlink:href="#([^"]+)"', r'xlink:href="#svg-NAME-\1"'),
        (r"url\(#([^)]+)\)", r"url(#svg-NAME-\1)"),
        (r"\n\s*", "\n"),
    )
)


def _saved(figure: Figure, form: str, settings: dict[str, Any], *, dpi: int, facecolor: str) -> bytes:
    from matplotlib import rc_context

    buffer = io.BytesIO()
    # Dates and versions would make equal figures differ.
    quiet: dict[str, Any] = {
        "svg": {"Date": None, "Creator": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        "png": {"Software": None},
    }[form]
    style: Any = {**_STYLE, **settings}
    with rc_context(style):
        figure.savefig(buffer, format=form, dpi=dpi, facecolor=facecolor, metadata=quiet)
    return buffer.getvalue()
