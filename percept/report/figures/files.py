"""From a drawing to a file: one style, the same bytes from the same input.

SVG is written by `percept.report.figures.svg`; PDF and PNG, where they are asked for, by matplotlib.
"""

from __future__ import annotations

import io
from html import escape
from typing import Any

from percept.errors import UsageError
from percept.report.figures.canvas import COLOURS, MM, Drawing
from percept.report.figures.svg.axes import SvgFigure
from percept.report.figures.svg.paint import Look, paint
from percept.report.figures.svg.text import Letters, Outlines

__all__ = ["FORMATS", "inline_svg", "rendered"]

FORMATS = ("svg", "pdf", "png")

_LOOK = Look(ink=COLOURS["ink"], quiet=COLOURS["quiet"], rule=COLOURS["rule"])
_SPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
# matplotlib's settings for the same look.
_STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": _LOOK.text,
    "axes.titlesize": _LOOK.title,
    "axes.labelsize": _LOOK.text,
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
    "xtick.labelsize": _LOOK.ticks,
    "ytick.labelsize": _LOOK.ticks,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": _LOOK.legend,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt",
    "mathtext.fontset": "dejavusans",
    "pdf.fonttype": 42,
}
# rem per mm: at the most a figure's lettering is as large as the page's small print, at the least readable.
_LEAST, _MOST = 0.165, 0.3


def rendered(drawing: Drawing, form: str, *, dpi: int = 300) -> bytes:
    """Draw for a file: letters as outlines or with their font, white ground.

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
    if form != "svg":
        return _by_matplotlib(drawing, form, dpi)
    outlines = Outlines()
    body = paint(_drawn(drawing), outlines, _LOOK)
    width, height = (side * MM * 72.0 for side in drawing.size)
    text = (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        f'<svg {_SPACES} width="{width:.9g}pt" height="{height:.9g}pt" '
        f'viewBox="0 0 {width:.9g} {height:.9g}">\n'
        f"<title>{escape(drawing.title)}</title>\n<desc>{escape(drawing.description)}</desc>\n"
        f'{outlines.definitions}\n<rect width="100%" height="100%" style="fill:#ffffff"/>\n{body}\n</svg>\n'
    )
    return text.encode("utf-8")


def inline_svg(drawing: Drawing) -> str:
    """Draw for the page: an ``<svg>`` with a title, text as text, and the page's colours.

    Parameters
    ----------
    drawing : Drawing
        What to draw.

    Returns
    -------
    str
        Safe to put into HTML; every id starts with ``svg-`` and the drawing's name.
    """
    prefix = f"svg-{drawing.name}-"
    body = paint(_drawn(drawing), Letters(), _LOOK, prefix=prefix)
    for name, colour in COLOURS.items():
        body = body.replace(colour, f"var(--{name})")
    width, height = (side * MM * 72.0 for side in drawing.size)
    return (
        f'<svg {_SPACES} viewBox="0 0 {width:.7g} {height:.7g}" '
        f'style="min-width:{drawing.size[0] * _LEAST:.4g}rem;max-width:{drawing.size[0] * _MOST:.4g}rem" '
        f'role="img" aria-labelledby="{prefix}title {prefix}desc">'
        f'<title id="{prefix}title">{escape(drawing.title)}</title>'
        f'<desc id="{prefix}desc">{escape(drawing.description)}</desc>\n{body}\n</svg>'
    )


def _drawn(drawing: Drawing) -> SvgFigure:
    width, height = drawing.size
    figure = SvgFigure((width * MM, height * MM))
    drawing.draw(figure)
    return figure


def _by_matplotlib(drawing: Drawing, form: str, dpi: int) -> bytes:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    # Dates and versions would make equal figures differ.
    quiet: dict[str, Any] = {
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        "png": {"Software": None},
    }[form]
    width, height = drawing.size
    buffer = io.BytesIO()
    with rc_context(_STYLE):
        figure = Figure(figsize=(width * MM, height * MM))
        drawing.draw(figure)
        figure.savefig(buffer, format=form, dpi=dpi, facecolor="white", metadata=quiet)
    return buffer.getvalue()
