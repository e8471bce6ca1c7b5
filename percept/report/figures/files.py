"""From a drawing to a file and to the page: one style, drawn once, the same bytes from the same input."""

from __future__ import annotations

import io
import re
from functools import cached_property
from html import escape
from typing import Any

from percept.report.figures.canvas import COLOURS, MM, Drawing, Figure
from percept.report.formats import check_formats

_DPI = 300  # of a PNG

_STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.5,
    # Names are the user's: a dollar sign among them begins no formula.
    "text.parse_math": False,
    "axes.titlesize": 8.0,
    # At its place at once: looking for room above the ticks costs as much as drawing them.
    "axes.titley": 1.0,
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
    "figure.facecolor": "none",
    "grid.color": COLOURS["rule"],
    "grid.linewidth": 0.4,
    "text.color": COLOURS["ink"],
    "xtick.color": COLOURS["quiet"],
    "ytick.color": COLOURS["quiet"],
    "xtick.labelcolor": COLOURS["ink"],
    "ytick.labelcolor": COLOURS["ink"],
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 6.8,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt",
    "path.simplify": True,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "percept",
}
# Dates and versions would make equal figures differ.
_NO_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
_SPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
# rem per mm: at the most a figure's lettering is as large as the page's small print, at the least readable.
_LEAST, _MOST = 0.2, 0.3
# matplotlib's rule for every element would hold for the whole page; the outer element hands it down instead.
_OWN_STYLE = re.compile(r"<defs>\s*<style.*?</style>\s*</defs>", re.DOTALL)
_HANDED_DOWN = 'stroke-linejoin="round" stroke-linecap="butt"'
# Text keeps its > escaped, so that these are the tags and nothing a user wrote.
_TAG = re.compile(r"<[^>]*>")
_ID = re.compile(r"""\s+id=("[^"]*"|'[^']*')""")
_BREAK_INSIDE = re.compile(r"\s*\n\s*(?=[^<\s])")
_INDENT = re.compile(r"\s*\n\s*")
_REFERENCE = re.compile(r'(url\(|href=")#([^)"]+)')


class Picture:
    """A drawing, drawn; for any number of files and for the page."""

    def __init__(self, drawing: Drawing) -> None:
        from matplotlib import rc_context
        from matplotlib.figure import Figure as EmptyFigure

        from percept.report.figures.powers import plain_powers

        self.drawing = drawing
        width, height = drawing.size
        with rc_context(_STYLE):
            self._figure: Figure = EmptyFigure(figsize=(width * MM, height * MM))
            drawing.draw(self._figure)
            plain_powers(self._figure)

    def file(self, form: str) -> bytes:
        """Return the content of a file: fonts embedded in a PDF, text as text in an SVG, white ground."""
        check_formats([form])
        if form != "svg":
            return self._saved(form, dpi=_DPI, facecolor="white")
        width, height = self._points
        text = (
            '<?xml version="1.0" encoding="utf-8"?>\n'
            f'<svg {_SPACES} width="{width:.9g}pt" height="{height:.9g}pt" '
            f'viewBox="0 0 {width:.9g} {height:.9g}" {_HANDED_DOWN}>\n'
            f"<title>{escape(self.drawing.title)}</title>\n<desc>{escape(self.drawing.description)}</desc>\n"
            f'<rect width="100%" height="100%" style="fill: #ffffff"/>\n{self._elements}\n</svg>\n'
        )
        return text.encode("utf-8")

    def inline(self) -> str:
        """Return an ``<svg>`` for the page, with a title and in the page's colours."""
        prefix = f"svg-{self.drawing.name}-"
        used = {match[2] for match in _REFERENCE.finditer(self._elements)}

        def own(found: re.Match[str]) -> str:
            tag = found[0]
            if "#" in tag:
                tag = _REFERENCE.sub(rf"\1#{prefix}\2", tag)
                for name, colour in COLOURS.items():
                    tag = tag.replace(colour, f"var(--{name})")
            # Ids that nothing refers to may hold a label, and a page's ids hold no spaces.
            return _ID.sub(lambda one: f' id="{prefix}{name}"' if (name := one[1][1:-1]) in used else "", tag)

        width, height = self._points
        side = self.drawing.size[0]
        return (
            f'<svg {_SPACES} viewBox="0 0 {width:.7g} {height:.7g}" {_HANDED_DOWN} '
            f'style="min-width:{side * _LEAST:.4g}rem;max-width:{side * _MOST:.4g}rem" '
            f'role="img" aria-labelledby="{prefix}title {prefix}desc">'
            f'<title id="{prefix}title">{escape(self.drawing.title)}</title>'
            f'<desc id="{prefix}desc">{escape(self.drawing.description)}</desc>\n'
            f"{_TAG.sub(own, self._elements)}\n</svg>"
        )

    @property
    def _points(self) -> tuple[float, float]:
        width, height = (side * MM * 72.0 for side in self.drawing.size)
        return width, height

    @cached_property
    def _elements(self) -> str:
        """What stands inside the ``<svg>`` that matplotlib writes."""
        text = self._saved("svg", dpi=72).decode("utf-8")
        inside = text[text.index("<svg") :].partition(">")[2].rpartition("</svg>")[0]
        # One line for each element, and no indentation.
        joined = _BREAK_INSIDE.sub(" ", _OWN_STYLE.sub("", inside, count=1))
        return _INDENT.sub("\n", joined).strip()

    def _saved(self, form: str, **settings: Any) -> bytes:
        from matplotlib import rc_context

        buffer = io.BytesIO()
        with rc_context(_STYLE):
            self._figure.savefig(buffer, format=form, metadata=_NO_METADATA[form], **settings)
        return buffer.getvalue()
