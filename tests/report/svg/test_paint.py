"""What the SVG shows against what matplotlib makes of the same drawing."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.figure import Figure

from percept.report.figures.canvas import COLOURS, panels
from percept.report.figures.catalogue import drawings
from percept.report.figures.files import rendered
from percept.report.figures.svg.axes import SvgFigure
from percept.report.figures.svg.paint import Look, paint
from percept.report.figures.svg.text import Letters

SIZE = (100 / 25.4, 60 / 25.4)
LOOK = Look(ink="#111111", quiet="#222222", rule="#333333")
X = np.array([0.1, 1.0, 7.0, 100.0])


def both_ways(draw):
    """The same drawing on axes of ours and of matplotlib."""
    found = []
    for kind in (SvgFigure, Figure):
        figure = kind(figsize=SIZE)
        (ax,) = panels(figure)
        draw(ax)
        found.append((figure, ax))
    return found


def curves(text, colour):
    """Points of every stroke of a colour, pt from the top left."""
    found = re.findall(rf'<path d="([^"]*)" style="fill:none;stroke:{colour}', text)
    return [
        np.array([[float(side) for side in pair.split()] for pair in piece.split("L")])
        for path in found
        for piece in path.split("M")[1:]
    ]


def painted(figure):
    return paint(figure, Letters(), LOOK)


def logarithmic(ax):
    ax.plot(X, [3.0, 40.0, 0.2, 9.0], color="#abcdef")
    ax.set_xscale("log")
    ax.set_yscale("log")


def linear(ax):
    ax.plot(X, [3.0, -40.0, 0.2, 9.0], color="#abcdef")
    ax.margins(y=0.12)
    ax.set_xlim(0.0, 60.0)


def with_a_rule(ax):
    ax.plot(X, X, color="#abcdef")
    ax.axhline(-50.0, color="#000000")
    ax.axvline(300.0, color="#000000")


@pytest.mark.parametrize("draw", [logarithmic, linear, with_a_rule])
def test_curves_lie_where_matplotlib_puts_them(draw):
    (ours, our_ax), (theirs, their_ax) = both_ways(draw)
    assert our_ax.get_xlim() == pytest.approx(their_ax.get_xlim(), rel=1e-9)
    assert our_ax.get_ylim() == pytest.approx(their_ax.get_ylim(), rel=1e-9)
    line = their_ax.get_lines()[0]
    pixels = their_ax.transData.transform(np.column_stack(line.get_data())) * 72.0 / theirs.dpi
    (curve,) = curves(painted(ours), "#abcdef")
    np.testing.assert_allclose(curve[:, 0], pixels[:, 0], atol=0.006)
    np.testing.assert_allclose(SIZE[1] * 72.0 - curve[:, 1], pixels[:, 1], atol=0.006)


def test_a_missing_point_leaves_a_gap():
    figure = SvgFigure(SIZE)
    (ax,) = panels(figure)
    ax.plot([0.0, 1.0, 2.0, 3.0, 4.0], [1.0, 2.0, np.nan, 2.0, 1.0], color="#abcdef")
    assert [len(piece) for piece in curves(painted(figure), "#abcdef")] == [2, 2]


def test_what_is_not_positive_falls_below_a_log_axis():
    figure = SvgFigure(SIZE)
    (ax,) = panels(figure)
    ax.plot([1.0, 2.0, 3.0], [1.0, 0.0, 10.0], color="#abcdef")
    ax.set_yscale("log")
    (curve,) = curves(painted(figure), "#abcdef")
    assert curve[1, 1] > SIZE[1] * 72.0
    assert np.isfinite(curve).all()


def test_a_shaded_area_goes_out_on_one_side_and_back_on_the_other():
    figure = SvgFigure(SIZE)
    (ax,) = panels(figure)
    ax.fill_between([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], [2.0, 3.0, 2.0], color="#abcdef", alpha=0.25)
    (path, alpha) = re.search(
        r'<path d="([^"]*)" style="fill:#abcdef;fill-opacity:([\d.]+)"', painted(figure)
    ).groups()
    around = np.array([[float(side) for side in pair.split()] for pair in path[1:].split("L")])
    assert alpha == "0.25"
    assert around[:3, 0].tolist() == around[:2:-1, 0].tolist()
    assert (around[:3, 1] > around[:2:-1, 1]).all()


def test_bars_have_their_corners():
    figure = SvgFigure(SIZE)
    (ax,) = panels(figure)
    ax.barh([0.0, 2.0], [1.0, 3.0], height=[2.0, 1.0], left=[0.0, 1.0], color="#abcdef")
    ax.set_xlim(0.0, 4.0)
    ax.set_ylim(0.0, 4.0)
    (path,) = re.findall(r'<path d="([^"]*)"[^>]*fill:#abcdef', painted(figure))
    corners = re.findall(r"M([\d.]+) ([\d.]+)H([\d.]+)V([\d.]+)", path)
    left, bottom, wide, high = 14.0, 49.0, 83.0, 43.0
    mm = np.array(corners, dtype=float) * 25.4 / 72.0
    expected = [[0, 0, 1, 2], [1, 2, 4, 3]]
    shares = [[left + wide * a / 4, bottom - high * b / 4, left + wide * c / 4, bottom - high * d / 4]
              for a, b, c, d in expected]  # fmt: skip
    np.testing.assert_allclose(mm, shares, atol=0.01)


def test_marks_outside_the_limits_are_not_drawn_and_those_on_the_edge_whole():
    figure = SvgFigure(SIZE)
    (ax,) = panels(figure)
    ax.plot([0.0, 1.0, 5.0], [0.5, 0.5, 0.5], marker="o", linestyle="none", color="#abcdef")
    ax.set_xlim(0.0, 1.0)
    ax.set_ylim(0.0, 1.0)
    text = painted(figure)
    assert len(re.findall("fill:#abcdef;stroke:#abcdef", text)) == 2
    assert "fill:#abcdef" not in text[text.index("<g clip-path") : text.index("</g>")]


def test_a_legend_names_what_has_a_label_down_its_columns():
    figure = SvgFigure(SIZE)
    (ax,) = panels(figure)
    ax.barh([0.0], [1.0], height=[1.0], left=[0.0], color="#abcdef", label="bars")
    for name in ("one", "two", None, "three"):
        ax.plot([0.0, 1.0], [0.0, 1.0], label=name)
    handles, labels = ax.get_legend_handles_labels()
    assert labels == ["one", "two", "three", "bars"]
    figure.legend(handles, labels, ncols=2)
    root = ET.fromstring(f'<svg xmlns:xlink="x">{painted(figure)}</svg>')
    places = {t.text: (float(t.get("x")), float(t.get("y"))) for t in root.iter("text") if t.text in labels}
    assert places["one"][0] == places["two"][0] < places["three"][0] == places["bars"][0]
    assert places["one"][1] == places["three"][1] < places["two"][1] == places["bars"][1]


def test_every_figure_of_a_report_is_sound_and_says_what_its_axes_are(both):
    for drawing in drawings(both):
        root = ET.fromstring(rendered(drawing, "svg"))
        tags = {element.tag.rpartition("}")[2] for element in root.iter()}
        assert "text" not in tags, drawing.name
        used = {element.get("{http://www.w3.org/1999/xlink}href") for element in root.iter()} - {None}
        defined = {f"#{element.get('id')}" for element in root.iter() if element.get("id")}
        assert used <= defined
        said = {element.get("aria-label") for element in root.iter()} - {None}
        assert any("(" in label or "reference" in label for label in said), drawing.name
        assert COLOURS["ink"] in rendered(drawing, "svg").decode()
