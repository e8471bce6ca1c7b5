from __future__ import annotations

import copy
import re
import xml.etree.ElementTree as ET
from importlib import resources

import numpy as np
import pytest
from matplotlib.figure import Figure

from percept.report.figures import drawings
from percept.report.figures.boundaries import curve_drawings
from percept.report.figures.canvas import (
    COLOURS,
    WIDTH,
    Drawing,
    drawn,
    log_scale,
    panels,
)
from percept.report.figures.intervals import overview_drawings
from tests.documents import as_results

SVG = "{http://www.w3.org/2000/svg}"
HOSTILE = '<script>alert("$x$")</script>'


@pytest.fixture(scope="module")
def found(both):
    return {drawing.name: drawing for drawing in drawings_of(both)}


def drawings_of(document):
    return drawings(as_results(document))


def file(drawing, form="svg"):
    return drawn(drawing, [form])[form]


def test_there_is_a_figure_of_everything_with_data(found):
    curves = {"ratios", "stability", "design"}
    assert found.keys() == curves | {"overview", "band"}


@pytest.mark.parametrize("form", ["svg", "pdf", "png"])
def test_the_same_drawing_gives_the_same_bytes(found, form):
    once, again = (file(found["band"], form) for _ in range(2))
    assert once == again
    assert once.startswith({"svg": b"<?xml", "pdf": b"%PDF", "png": b"\x89PNG"}[form])


def test_a_file_has_its_size_in_millimetres(found):
    drawing = found["band"]
    root = ET.fromstring(file(drawing))
    for side, length in (("width", WIDTH), ("height", drawing.height)):
        assert float(root.get(side).removesuffix("pt")) == pytest.approx(
            length * 72 / 25.4, rel=1e-6
        )


def test_embedded_fonts_in_a_pdf(found):
    # Type 42 keeps the outlines of the font; Type 3 is what journals refuse.
    assert b"/FontFile2" in file(found["band"], "pdf")


def drawn_on(drawing):
    figure = Figure(figsize=(WIDTH / 25.4, drawing.height / 25.4), layout="constrained")
    drawing.draw(figure)
    return figure


@pytest.mark.parametrize("study", ["both", "classical"])
def test_every_subject_and_every_limit_is_drawn_within_the_axis(study, request):
    results = as_results(request.getfixturevalue(study))
    (drawing,) = overview_drawings(results)
    for parameter, ax in zip(("k", "b"), drawn_on(drawing).axes, strict=True):
        left, right = ax.get_xlim()
        wanted = [
            value / cell.reference
            for cell in results.data.cells
            if cell.parameter == parameter
            for value in cell.values
        ]
        dots = [x for line in ax.lines if line.get_marker() == "." for x in line.get_xdata()]
        assert sorted(dots) == pytest.approx(sorted(wanted), rel=1e-14)
        bars = {tuple(line.get_xdata()) for line in ax.lines if line.get_marker() == "None"}
        shown = {
            (row.lower / row.reference, row.upper / row.reference)
            for row in results.intervals
            if (row.parameter, row.family, row.joint) == (parameter, "lognormal", "marginal")
            and row.kind != "share"
        }
        assert shown <= bars
        ends = [*dots, *(end for pair in shown for end in pair)]
        assert left < min(ends) <= max(ends) < right


def test_limits_of_a_hundred_decades_reach_the_end_of_the_axis_and_no_farther(classical):
    document = copy.deepcopy(classical)
    for row in document["intervals"]:
        if row["kind"] == "user":
            row |= {"lower": row["reference"] * 1e-50, "upper": row["reference"] * 1e50}
    (drawing,) = overview_drawings(as_results(document))
    for ax in drawn_on(drawing).axes:
        left, right = ax.get_xlim()
        assert 1e-5 < left < 1e-4 < 1e4 < right < 1e5
        assert [left, right] in [list(line.get_xdata()) for line in ax.lines]


@pytest.mark.parametrize(
    ("verdict", "said"), [("can", "not decided"), ("cannot", "cannot be\nrendered")]
)
def test_verdicts_stand_in_the_titles_of_ratios(both, verdict, said):
    document = copy.deepcopy(both)
    for row in document["rendering"]:
        row["verdict"] = verdict
    for row in document["verdicts"]:
        row["outcome"] = "too little data"
    (ratios,) = curve_drawings(as_results(document))
    titles = [ax.get_title() for ax in drawn_on(ratios).axes]
    assert [title.partition("\n")[0] for title in titles] == ["VE1", "VE2", "VE4"]
    assert all(title.partition("\n")[2].startswith(said) for title in titles)


def test_ratios_are_the_boundaries_over_the_reference(both):
    results = as_results(both)
    (ratios,) = curve_drawings(results)
    ax = drawn_on(ratios).axes[0]
    (boundary,) = (
        one
        for one in results.boundaries
        if (one.environment, one.kind, one.method, one.family, one.shape, one.joint)
        == ("VE1", "user", "classical", "lognormal", "envelope", "marginal")
    )
    curves = [line.get_ydata() for line in ax.lines]
    for limit in (boundary.lower, boundary.upper):
        assert any(np.array_equal(curve, limit / boundary.reference) for curve in curves)


def test_the_axes_of_couplings_hold_the_one_in_use_and_only_decided_walls_are_drawn(both):
    document = copy.deepcopy(both)
    document["coupling"] |= {"stiffness": 9e6, "damping": 2e5}
    (design,) = [one for one in drawings_of(document) if one.name == "design"]
    figure = drawn_on(design)
    found = [row["name"] for row in both["design"]["environments"] if row["outcome"] == "some"]
    assert [ax.get_title() for ax in figure.axes] == found
    for ax in figure.axes:
        assert ax.get_xlim()[1] > 9e3
        assert ax.get_ylim()[1] > 2e5
    for row in document["design"]["environments"]:
        row["outcome"] = "none"
    assert "design" not in {one.name for one in drawings_of(document)}


def test_every_reference_lies_within_the_axes_of_what_is_rendered(found, both):
    ax = drawn_on(found["stability"]).axes[0]
    names = {text.get_text(): text.xy for text in ax.texts}
    walls = {wall["environment"]: wall for wall in both["zwidth"]["references"]}
    assert names.keys() == walls.keys()
    for name, (x, y) in names.items():
        assert (x, y) == (walls[name]["stiffness"] / 1e3, walls[name]["damping"])
        assert ax.get_xlim()[0] < x < ax.get_xlim()[1]
        assert ax.get_ylim()[0] < y < ax.get_ylim()[1]


@pytest.mark.parametrize("method", ["classical", "bayesian"])
def test_one_law_is_drawn_through_the_bands(method, both, classical):
    document = both if method == "bayesian" else classical
    (band,) = [one for one in drawings(as_results(document)) if one.name == "band"]
    ax = drawn_on(band).axes[0]
    (law,) = [line for line in ax.lines if len(line.get_xdata()) == 80]
    assert law.get_color() == COLOURS[method]
    laws = [row for row in document["band"]["laws"] if row["method"] == method]
    best = max(laws, key=lambda row: row["best"])["model"]
    said = {"weber": "Weber’s law", "offset": "Weber’s law with an offset", "power": "a power law"}
    assert law.get_label() == said[best]
    heights = [sorted(line.get_ydata()) for line in ax.lines if line is not law]
    for row in document["band"]["rows"]:
        if row["family"] == "lognormal":
            assert [row["band"]] in heights
            assert [row["band_lower"], row["band_upper"]] in heights


def drawing_of(draw, **given):
    """A drawing of one set of axes."""

    def on(figure):
        (ax,) = panels(figure)
        draw(ax)

    return Drawing(
        **{
            "name": "one",
            "title": "T",
            "description": "D",
            "height": 60.0,
            "draw": on,
            **given,
        }
    )


def texts(content):
    return ["".join(element.itertext()) for element in ET.fromstring(content).iter(f"{SVG}text")]


def test_powers_of_ten_are_plain_letters():
    def draw(ax):
        ax.set_xlim(1e-3, 1e3)
        log_scale(ax, "x")

    said = texts(file(drawing_of(draw)))
    assert {"10⁻³", "10⁻¹", "10¹"} <= set(said)
    assert not [one for one in said if "$" in one or "{" in one]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "name", ["a\x1b[2J\x00b", "環境 ١", "\u202eabc", r"id='a' --><b> ]]> a$b$c\$"]
)
def test_any_name_is_text_in_a_figure(name):
    drawing = drawing_of(lambda ax: ax.set_title(name), title=name)
    expected = name.replace("\x1b", "\ufffd").replace("\x00", "\ufffd")
    content = file(drawing)
    assert expected in texts(content)
    assert ET.fromstring(content).find(f"{SVG}title").text == expected


@pytest.mark.parametrize(
    ("kinds", "whom"),
    [
        (("mean", "user", "share"), "the next user"),
        (("mean", "share"), "the average user"),
        (("share",), "a share of all users"),
    ],
)
def test_the_title_of_boundaries_says_whom_they_are_for(classical, kinds, whom):
    document = copy.deepcopy(classical)
    document["boundaries"] = [row for row in document["boundaries"] if row["kind"] in kinds]
    ratios = curve_drawings(as_results(document))[0]
    assert ratios.title.startswith(f"What {whom} takes for the reference")


def linear(colour):
    """Linear RGB of a colour in hexadecimal digits."""
    parts = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("theme", [":root {", ':root[data-theme="dark"] {'])
def test_colours_of_text_have_the_contrast_that_wcag_asks_for(theme):
    css = resources.files("percept.report").joinpath("templates", "page.css").read_text("utf-8")
    block = css.partition(theme)[2].partition("}")[0]
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block))
    light = {name: linear(colour) @ [0.2126, 0.7152, 0.0722] for name, colour in colours.items()}
    for text in ("ink", "quiet", "classical", "bayesian", "coupled", "warn", "link"):
        for ground in ("paper", "panel"):
            darker, lighter = sorted([light[text], light[ground]])
            assert (lighter + 0.05) / (darker + 0.05) >= 4.5, (text, ground)


def test_methods_stay_apart_in_colour_blindness():
    # Viénot, Brettel and Mollon (1999): linear RGB as a protanope and a deuteranope sees it.
    seen_by = {
        "protanope": np.array(
            [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]]
        ),
        "deuteranope": np.array(
            [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]]
        ),
    }

    for matrix in seen_by.values():
        classical, bayesian = (matrix @ linear(COLOURS[name]) for name in ("classical", "bayesian"))
        assert np.linalg.norm(classical - bayesian) > 0.25
