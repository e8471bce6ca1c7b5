from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from importlib import resources

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextToPath

from percept.report.figures.canvas import plain_text
from percept.report.figures.svg.glyphs import CHARACTERS, EM, glyphs, trace, width
from percept.report.figures.svg.text import Letters, Outlines, Run, runs, text_width

SPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'


def parsed(element):
    return ET.fromstring(f"<svg {SPACES}>{element}</svg>")


def test_the_table_is_what_the_font_gives():
    pytest.importorskip("matplotlib", minversion="3.10", reason="older ones name the loading flags otherwise")
    kept = json.loads(
        resources.files("percept.report.figures.svg").joinpath("glyphs.json").read_text("utf-8")
    )
    assert {key: tuple(value) for key, value in kept.items()} == trace()
    assert set(kept) == set(CHARACTERS)


@pytest.mark.parametrize(
    "text", ["angular frequency ω (rad/s)", "VE1, mean: average user", "−0.25", "Weber’s é"]
)
def test_widths_are_those_matplotlib_measures(text):
    measured, _, _ = TextToPath().get_text_width_height_descent(
        text, FontProperties(size=100.0), ismath=False
    )
    # Ours is the sum of advances; matplotlib's leaves the room beside the outer letters out and kerns pairs.
    assert width(text, 100.0) == pytest.approx(measured, abs=25.0)


def test_letters_outside_the_table_take_a_usual_width():
    assert "試" not in glyphs()
    assert width("試", 10.0) == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("plain", [Run("plain")]),
        ("|Z$_h$| (N·s/m)", [Run("|Z"), Run("h", "_"), Run("| (N·s/m)")]),
        ("Z$_{h,vc}$", [Run("Z"), Run("h,vc", "_")]),
        ("10$^{-3}$", [Run("10"), Run("−3", "^")]),
        (r"a\$_b\$", [Run("a$_b$")]),
        ("-0.5", [Run("−0.5")]),
        ("S-01", [Run("S-01")]),
    ],
)
def test_indices_are_lowered_and_raised(text, expected):
    assert runs(text) == expected


@given(st.text(alphabet=st.sampled_from("ab$_^{}\\ h"), min_size=1))
def test_text_of_the_input_is_written_as_it_stands(text):
    assert "".join(run.text for run in runs(plain_text(text))) == text
    assert all(run.level == "" for run in runs(plain_text(text)))


@pytest.mark.parametrize("writer", [Letters, Outlines])
@pytest.mark.parametrize("turned", [False, True])
def test_hostile_text_stays_text(writer, turned):
    text = '<script>alert("x")</script>&'
    root = parsed(writer().write(text, 1.0, 2.0, size=7.0, colour="red", turned=turned))
    (element,) = root
    seen = element.get("aria-label") or "".join(element.itertext())
    assert seen == text


def test_outlines_stand_where_the_advances_say():
    outlines = Outlines()
    root = parsed(outlines.write("AVω", 10.0, 20.0, size=8.0, colour="red", align="center"))
    (scaled,) = root[0]
    scale = float(re.match(r"scale\(([\d.]+) ", scaled.get("transform"))[1])
    assert scale == pytest.approx(8.0 / EM, rel=1e-4)
    pens = np.array([float(use.get("x")) for use in scaled])
    advances = np.cumsum([0.0] + [glyphs()[one].advance for one in "AV"])
    start = -0.5 * text_width("AVω", 8.0) / (8.0 / EM)
    np.testing.assert_allclose(pens, start + advances, atol=0.6)
    defined = {path.get("id"): path.get("d") for path in parsed(outlines.definitions)[0]}
    assert defined == {f"glyph-{ord(one):x}": glyphs()[one].path for one in "AVω"}


def test_a_letter_without_outline_leaves_its_label_as_text():
    outlines = Outlines()
    (element,) = parsed(outlines.write("試 1", 0.0, 0.0, size=7.0, colour="red"))
    assert element.tag.endswith("text")
    assert element.text == "試 1"
    assert not list(parsed(outlines.definitions)[0])


def test_a_lowered_index_comes_back_to_the_line():
    (element,) = parsed(Letters().write("Z$_h$ x", 0.0, 0.0, size=10.0, colour="red"))
    low, back = (float(span.get("dy")) for span in element)
    assert low > 0
    assert low + back == pytest.approx(0.0)
