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
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "FORMATS", "Drawing", "inline_svg", "plain_text", "render"]

FORMATS = ("svg", "pdf", "png")

# Blue and vermilion of Okabe and Ito, which remain apart in every common form of colour blindness; never told
# apart by colour alone. The names are those of the page's style sheet, where the dark page has its own values.
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
_STYLE: dict[str, Any] = {
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


def render(drawing: Drawing, form: str, *, dpi: int = 300) -> bytes:
    """Draw for a file: fonts embedded, white ground.

    Parameters
    ----------
    drawing : Drawing
        What to draw.
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
    return _drawn(drawing, form, dpi, {"svg.fonttype": "path", "figure.facecolor": "white"})


def inline_svg(drawing: Drawing) -> str:
    """Draw for the page: an ``<svg>`` element with a title, text as text, and the page's colours.

    Parameters
    ----------
    drawing : Drawing
        What to draw.

    Returns
    -------
    str
        Safe to put into HTML; every id starts with the drawing's name.
    """
    settings = {"svg.fonttype": "none", "figure.facecolor": "none"}
    text = _drawn(drawing, "svg", 72, settings).decode("utf-8")
    body = text[text.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.DOTALL)
    body = re.sub(r'\b(id|xlink:href|href)="(#?)([^"]+)"', rf'\1="\2{drawing.name}-\3"', body)
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{drawing.name}-\1)", body)
    for name, colour in COLOURS.items():
        body = body.replace(colour, f"var(--{name})")
    opening, _, rest = body.partition(">")
    box = re.search(r'viewBox="[^"]*"', opening)
    if box is None:
        raise RuntimeError("matplotlib wrote an SVG without a viewBox.")
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {box[0]} '
        f'role="img" aria-labelledby="{drawing.name}-title {drawing.name}-desc">'
        f'<title id="{drawing.name}-title">{escape(drawing.title)}</title>'
        f'<desc id="{drawing.name}-desc">{escape(drawing.description)}</desc>'
    )
    return re.sub(r"\n\s*", "\n", head + rest).strip()


def _drawn(drawing: Drawing, form: str, dpi: int, settings: dict[str, Any]) -> bytes:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({**_STYLE, **settings}):
        figure = Figure(figsize=tuple(side * _MM for side in drawing.size), layout="constrained")
        drawing.draw(figure)
        buffer = io.BytesIO()
        # Dates and versions would make equal figures differ.
        quiet = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {"Software": None}}[form]
        figure.savefig(buffer, format=form, dpi=dpi, metadata=quiet)
    return buffer.getvalue()
