"""Widths and outlines of the letters in figures: DejaVu Sans, as far as its own table goes.

``glyphs.json`` holds what `trace` reads off the font that matplotlib brings; ``python -m
percept.report.figures.svg.glyphs`` writes it again. The font's licence allows its outlines in documents.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

__all__ = ["CHARACTERS", "EM", "Glyph", "glyphs", "trace", "width"]

#: Units of a glyph per em.
EM = 2048
#: Basic and accented Latin, Greek, and the signs that labels use.
CHARACTERS = "".join(
    map(
        chr,
        (
            *range(0x20, 0x7F),
            *range(0xA1, 0x180),
            *range(0x391, 0x3A2),
            *range(0x3A3, 0x3CA),
            *map(ord, "−–—‘’“”…·×≤≥√∞"),
        ),
    )
)
_FILE = "glyphs.json"
# What a letter outside the table takes: its outline is the reader's business, its room has to be guessed.
_USUAL = 0.6 * EM


@dataclass(frozen=True)
class Glyph:
    """A letter of the font.

    Attributes
    ----------
    advance : float
        Width it takes, in units of 1/`EM` em.
    path : str
        Outline as SVG path data in the same units, y upward; empty for a blank.
    """

    advance: float
    path: str


@cache
def glyphs() -> dict[str, Glyph]:
    """Return the table, by character."""
    text = resources.files(__package__).joinpath(_FILE).read_text(encoding="utf-8")
    return {character: Glyph(*entry) for character, entry in json.loads(text).items()}


def width(text: str, size: float) -> float:
    """Return the width of a line of plain text.

    Parameters
    ----------
    text : str
    size : float
        Of the letters, in any unit.

    Returns
    -------
    float
        In the unit of `size`; letters outside the table count 0.6 of it.
    """
    table = glyphs()
    units = sum(table[one].advance if one in table else _USUAL for one in text)
    return units * size / EM


def trace(characters: str = CHARACTERS) -> dict[str, tuple[float, str]]:
    """Read letters off the font file that matplotlib brings.

    Parameters
    ----------
    characters : str

    Returns
    -------
    dict
        Character to advance and path data, as `Glyph` has them; characters the font lacks are left out.
    """
    from matplotlib.font_manager import FontProperties, findfont
    from matplotlib.ft2font import FT2Font, LoadFlags

    font = FT2Font(findfont(FontProperties(family="DejaVu Sans")))
    known = font.get_charmap()
    found = {}
    for character in characters:
        if ord(character) not in known:
            continue
        glyph = font.load_char(ord(character), flags=LoadFlags.NO_SCALE)
        found[character] = (float(glyph.horiAdvance), _path_data(*font.get_path()))
    return found


def _path_data(vertices: Any, codes: Any) -> str:
    from matplotlib.path import Path

    letters = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C", Path.CLOSEPOLY: "z"}
    parts = []
    for points, code in Path(vertices, codes).iter_segments(simplify=False, curves=True):
        # Unscaled outlines come in 64ths of the font's units.
        ends = "" if code == Path.CLOSEPOLY else " ".join(f"{64 * value:g}" for value in points)
        parts.append(letters[code] + ends)
    return "".join(parts)


if __name__ == "__main__":
    target = resources.files(__package__).joinpath(_FILE)
    with resources.as_file(target) as file:
        lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in trace().items())
        file.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
