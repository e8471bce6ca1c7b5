"""Drawings become files and parts of the page: drawn once, equal bytes from equal input."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from percept.report.figures.canvas import COLOURS, MM, WIDTH, Drawing
from percept.report.sections import Plot

_DPI = 300  # of a PNG
_POINTS = 72.0  # of an SVG, per inch

#: matplotlib's settings for every figure.
STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.5,
    # Names are the user's: a dollar sign among them begins no formula.
    "text.parse_math": False,
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
    "legend.handlelength": 1.5,
    "legend.columnspacing": 1.4,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt",
    "path.simplify": True,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
# Dates and versions would make equal figures differ.
_NO_METADATA: dict[str, dict[str, str | None]] = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
_HEAD = re.compile(r"<svg[^>]*>")
# matplotlib's rule for every element would hold for the whole page; the outer element hands it down
# instead.
_OWN_STYLE = re.compile(r"<defs>\s*<style.*?</style>\s*</defs>", re.DOTALL)
_HANDED_DOWN = 'stroke-linejoin="round" stroke-linecap="butt"'
# Text keeps its > escaped, so that these are the tags and nothing a user wrote.
_TAG = re.compile(r"<[^>]*>")
_ID = re.compile(r"""\s+id=("[^"]*"|'[^']*')""")
_BREAK_INSIDE = re.compile(r"\s*\n\s*(?=[^<\s])")
_INDENT = re.compile(r"\s*\n\s*")
# Characters that XML cannot hold, even as references.
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ufffe\uffff]")
_REFERENCE = re.compile(r'(?:url\(|href=")#([^)"]+)')


def draw_all(
    drawings: Iterable[Drawing], folder: Path, *, formats: Sequence[str] = ("svg",)
) -> dict[str, Plot]:
    """Draw figures, write their files, and return them by name."""
    plots = {}
    for one in drawings:
        files, svg = drawn(one, formats)
        for form, content in files.items():
            folder.mkdir(exist_ok=True)
            (folder / f"{one.name}.{form}").write_bytes(content)
        plots[one.name] = Plot(one.title, one.description, svg, tuple(files))
    return plots


def drawn(drawing: Drawing, formats: Sequence[str]) -> tuple[dict[str, bytes], str]:
    """Draw a figure once; return its files by format, and an ``<svg>`` in the page's colours."""
    # The salt makes the ids of clips and markers the figure's own: many figures share the page.
    salted = STYLE | {"svg.hashsalt": f"percept {drawing.name}"}
    with rc_context(salted), warnings.catch_warnings():
        # An SVG holds text as text; whoever shows it has more fonts.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        # Names as long as a figure leave no room for axes: they lie over each other.
        warnings.filterwarnings("ignore", "constrained_layout not applied", UserWarning)
        figure = Figure(figsize=(WIDTH * MM, drawing.height * MM), layout="constrained")
        drawing.draw(figure)
        text = _CONTROL.sub("\ufffd", _saved(figure, "svg", dpi=72).decode("utf-8"))
        files = {
            form: (
                _svg_file(drawing, text)
                if form == "svg"
                else _saved(figure, form, dpi=_DPI, facecolor="white")
            )
            for form in formats
        }
    return files, _inline(drawing, text)


def _saved(figure: Figure, form: str, **settings: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form, metadata=_NO_METADATA[form], **settings)
    return buffer.getvalue()


def _escaped(text: str) -> str:
    return escape(_CONTROL.sub("\ufffd", text))


def _svg_file(drawing: Drawing, text: str) -> bytes:
    """Return an SVG file with text as text, on white ground."""
    words = (
        f"<title>{_escaped(drawing.title)}</title>\n<desc>{_escaped(drawing.description)}</desc>\n"
    )
    ground = '<rect width="100%" height="100%" style="fill: #ffffff"/>\n'
    return _HEAD.sub(lambda head: f"{head[0]}\n{words}{ground}", text, count=1).encode()


def _inline(drawing: Drawing, text: str) -> str:
    """Return an ``<svg>`` for the page: a title, the page's colours, a line for each element."""
    inside = _OWN_STYLE.sub("", _HEAD.split(text)[1], count=1)
    inside = _INDENT.sub("\n", _BREAK_INSIDE.sub(" ", inside)).strip()
    used = {match[1] for match in _REFERENCE.finditer(inside)}

    def own(found: re.Match[str]) -> str:
        tag = found[0]
        for name, colour in COLOURS.items():
            tag = tag.replace(colour, f"var(--{name})")
        # Ids that nothing refers to may hold a label, and a page's ids hold no spaces.
        return _ID.sub(lambda one: attribute(one[1][1:-1]), tag)

    def attribute(name: str) -> str:
        return f' id="{name}"' if name in used else ""

    width = WIDTH * MM * _POINTS
    height = drawing.height * MM * _POINTS
    label = f"svg-{drawing.name}"
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="0 0 {width:.7g} {height:.7g}" {_HANDED_DOWN} '
        f'role="img" aria-labelledby="{label}-title {label}-desc">'
        f'<title id="{label}-title">{_escaped(drawing.title)}</title>'
        f'<desc id="{label}-desc">{_escaped(drawing.description)}</desc>\n'
        f"{_TAG.sub(own, inside)}\n"
    )
