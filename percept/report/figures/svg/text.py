"""Lines of text with indices, as letters or as outlines."""

from __future__ import annotations

import re
from dataclasses import dataclass
from html import escape
from typing import Protocol

from percept.report.figures.svg.glyphs import EM, glyphs, width

__all__ = ["Letters", "Outlines", "Run", "TextWriter", "runs", "text_width"]

# As in matplotlib's mathematics, of which labels use nothing else.
_INDEX = re.compile(r"\$([_^])(?:\{([^}]*)\}|([^$]))\$")
_INDEX_SIZE = 0.7
_SHIFT = {"": 0.0, "_": -0.2, "^": 0.38}
_FAMILY = "'DejaVu Sans', Verdana, sans-serif"
_STARTS = {"left": 0.0, "center": 0.5, "right": 1.0}
_ANCHORS = {"left": "start", "center": "middle", "right": "end"}


@dataclass(frozen=True)
class Run:
    """Part of a line in one size at one height.

    Attributes
    ----------
    text : str
    level : {"", "_", "^"}
        On the line, lowered or raised.
    """

    text: str
    level: str = ""


def runs(text: str) -> list[Run]:
    """Split a label into runs: ``$_h$`` and ``$_{h,vc}$`` are lowered, ``$^2$`` raised.

    Parameters
    ----------
    text : str
        As `percept.report.figures.canvas.plain_text` escapes it: a backslash stands before a dollar sign, or
        a backslash, that is meant.

    Returns
    -------
    list of Run
    """
    if "$" not in text:
        return [Run(text.replace("-", "−") if _is_number(text) else text)]
    found, start = [], 0
    for match in _INDEX.finditer(text):
        if _escaped(text, match.start()):
            continue
        found += [Run(_meant(text[start : match.start()])), Run(match[2] or match[3], match[1])]
        start = match.end()
    found.append(Run(_meant(text[start:])))
    return [
        Run(run.text.replace("-", "−") if run.level else run.text, run.level) for run in found if run.text
    ]


def _is_number(text: str) -> bool:
    return bool(re.fullmatch(r"-\d[\d.e+-]*", text))


def _escaped(text: str, place: int) -> bool:
    before = text[:place]
    return (len(before) - len(before.rstrip("\\"))) % 2 == 1


def _meant(text: str) -> str:
    return re.sub(r"\\([\\$])", r"\1", text)


def text_width(text: str, size: float) -> float:
    """Return the width of a label, in the unit of `size`."""
    return sum(width(run.text, _size(run, size)) for run in runs(text))


def _size(run: Run, size: float) -> float:
    return size * _INDEX_SIZE if run.level else size


class TextWriter(Protocol):
    """Writes labels into an SVG."""

    def write(
        self,
        text: str,
        x: float,
        y: float,
        *,
        size: float,
        colour: str,
        align: str = "left",
        turned: bool = False,
    ) -> str:
        """Return the elements of a label.

        Parameters
        ----------
        text : str
            As `runs` takes it.
        x, y : float
            Where its baseline starts, has its middle or ends; y downward.
        size : float
            Of the letters.
        colour : str
            A CSS colour.
        align : {"left", "center", "right"}
            What of it stands at x.
        turned : bool
            Written upward.

        Returns
        -------
        str
        """
        ...


class Letters:
    """Writes text as text, for a page that has its own fonts."""

    def write(
        self,
        text: str,
        x: float,
        y: float,
        *,
        size: float,
        colour: str,
        align: str = "left",
        turned: bool = False,
    ) -> str:
        """Return one ``<text>`` element; see `TextWriter`."""
        body, shift = "", 0.0
        for run in runs(text):
            step, shift = _SHIFT[run.level] * size - shift, _SHIFT[run.level] * size
            inside = escape(run.text, quote=False)
            if step or run.level:
                inside = f'<tspan dy="{-step:.5g}" style="font-size:{_size(run, size):g}px">{inside}</tspan>'
            body += inside
        turn = f' transform="rotate(-90 {x:.5g} {y:.5g})"' if turned else ""
        style = f"font:{size:g}px {_FAMILY};text-anchor:{_ANCHORS[align]};fill:{colour}"
        return f'<text x="{x:.5g}" y="{y:.5g}"{turn} style="{style}" xml:space="preserve">{body}</text>'


class Outlines:
    """Writes text as outlines, for a file that looks the same everywhere; `definitions` holds the letters."""

    def __init__(self) -> None:
        self._used: dict[str, str] = {}

    def write(
        self,
        text: str,
        x: float,
        y: float,
        *,
        size: float,
        colour: str,
        align: str = "left",
        turned: bool = False,
    ) -> str:
        """Return a group that uses the letters' outlines; see `TextWriter`.

        A label with a letter outside the table stays text, in whatever font the reader has for it.
        """
        table = glyphs()
        parts = runs(text)
        if any(one not in table for run in parts for one in run.text):
            return Letters().write(text, x, y, size=size, colour=colour, align=align, turned=turned)
        at = -_STARTS[align] * text_width(text, size)
        body = ""
        for run in parts:
            scale = _size(run, size) / EM
            rise = _SHIFT[run.level] * size / scale
            pen = at / scale
            inside = ""
            for one in run.text:
                glyph = table[one]
                if glyph.path:
                    name = self._used.setdefault(one, f"glyph-{ord(one):x}")
                    inside += f'<use xlink:href="#{name}" x="{pen:.0f}" y="{rise:.0f}"/>'
                pen += glyph.advance
            body += f'<g transform="scale({scale:.5g} {-scale:.5g})">{inside}</g>'
            at = pen * scale
        turn = " rotate(-90)" if turned else ""
        # Kept as text as well, for readers and searches.
        label = escape("".join(run.text for run in parts))
        place = f"translate({x:.5g} {y:.5g}){turn}"
        return f'<g transform="{place}" style="fill:{colour}" aria-label="{label}">{body}</g>'

    @property
    def definitions(self) -> str:
        """The outlines used so far, as a ``<defs>`` element."""
        table = glyphs()
        paths = (f'<path id="{name}" d="{table[one].path}"/>' for one, name in self._used.items())
        return f"<defs>{''.join(paths)}</defs>"
