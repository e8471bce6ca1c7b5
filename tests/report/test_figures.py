from __future__ import annotations

import copy
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure

from percept.report.figures import drawings
from percept.report.figures.boundaries import boundary_drawings
from percept.report.figures.canvas import (
    COLOURS,
    Drawing,
    log_scale,
    panels,
)
from percept.report.figures.intervals import Bar, BarAxis, draw_intervals, interval_drawings
from percept.report.figures.output import STYLE, drawn
from tests.documents import as_results

SVG = "{http://www.w3.org/2000/svg}"
HOSTILE = '<script>alert("$x$")</script>'


@pytest.fixture(scope="module")
def found(both):
    return {drawing.name: drawing for drawing in drawings(as_results(both))}


def axes():
    return Figure().add_subplot()


def inline(drawing):
    return drawn(drawing, ())[1]


def file(drawing, form="svg"):
    return drawn(drawing, [form])[0][form]


def test_there_is_a_figure_of_everything_with_data(found):
    curves = {"boundaries", "boundaries_close", "ratios", "zwidth", "stability", "design"}
    assert found.keys() == curves | {"overview_k", "overview_b", "pse_k", "pse_b", "band"}


@pytest.mark.parametrize("form", ["svg", "pdf", "png"])
def test_the_same_drawing_gives_the_same_bytes(found, form):
    once, again = (file(found["boundaries_close"], form) for _ in range(2))
    assert once == again
    assert once.startswith({"svg": b"<?xml", "pdf": b"%PDF", "png": b"\x89PNG"}[form])


def test_a_file_has_its_size_in_millimetres(found):
    drawing = found["band"]
    root = ET.fromstring(file(drawing))
    for side, length in zip(("width", "height"), drawing.size, strict=True):
        assert float(root.get(side).removesuffix("pt")) == pytest.approx(
            length * 72 / 25.4, rel=1e-6
        )


def test_embedded_fonts_in_a_pdf(found):
    # Type 42 keeps the outlines of the font; Type 3 is what journals refuse.
    assert b"/FontFile2" in file(found["band"], "pdf")


def test_the_page_s_svg_is_one_element_with_title_and_ids_of_its_own(found):
    drawing = found["ratios"]
    text = inline(drawing)
    root = ET.fromstring(text)
    assert root.tag == f"{SVG}svg"
    # Rules of its own would hold for the whole page.
    assert root.find(f".//{SVG}style") is None
    assert root.find(f"{SVG}title").text == drawing.title
    ids = {element.get("id") for element in root.iter() if element.get("id")}
    others = "".join(inline(found[name]) for name in ("boundaries", "stability"))
    assert not any(f'id="{one}"' in others for one in ids)
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text))
    assert used
    assert used <= ids
    labelled = root.get("aria-labelledby").split()
    assert set(labelled) <= ids


def test_the_page_s_svg_takes_its_colours_from_the_page(found):
    drawing = found["overview_k"]
    text = inline(drawing)
    assert "var(--classical)" in text
    assert "var(--bayesian)" in text
    left = set(re.findall(r"#[0-9a-fA-F]{6}\b", text))
    assert not left, left


def test_hostile_names_are_drawn_as_text(both):
    document = copy.deepcopy(both)
    parts = ("intervals", "boundaries", "close")
    of_cells = [row for row in document["psychophysics"] if row["environment"]]
    for part in (*(document[name] for name in parts), document["data"]["cells"], of_cells):
        for row in part:
            row["environment"] = row["environment"].replace("VE1", HOSTILE)
    for table in ("zoom", "impedances", "close_impedances"):
        document[table][HOSTILE] = document[table]["VE1"]
    by_name = {drawing.name: drawing for drawing in drawings(as_results(document))}
    for name in ("boundaries",):
        text = inline(by_name[name])
        assert "<script" not in text
        seen = "".join(ET.fromstring(text).itertext())
        assert 'alert("$x$")' in seen


def test_the_caption_of_intervals_says_what_is_drawn(both, classical):
    _, two = interval_drawings(as_results(both))
    assert " Each classical bar stands above the Bayesian one. " in two.description
    assert " Ticks: the subjects; those beyond the axis are counted." in two.description
    assert " Classical limits are lognormal." in two.description
    document = copy.deepcopy(classical)
    for row in (*document["intervals"], *document["data"]["cells"]):
        if (row["environment"], row["parameter"]) == ("VE1", "b"):
            row["reference"] = 0.0
    k, b = interval_drawings(as_results(document))
    assert "Bayesian" not in k.description
    assert k.title == "What users set, divided by the reference"
    assert b.title == "What users set, less the reference"
    figure = Figure()
    b.draw(figure)
    (legend,) = figure.legends
    # The first environment, which has no bars, is not the one that names them.
    assert [text.get_text() for text in legend.get_texts()] == [
        "classical", "average user", "next user", "one subject",
    ]  # fmt: skip


def people_drawn(drawing):
    """Count the ticks of a drawing and the subjects that it counts at the ends of its axis."""
    with rc_context(STYLE):
        figure = Figure(figsize=[side / 25.4 for side in drawing.size])
        drawing.draw(figure)
    (ax,) = figure.axes
    left, right = ax.get_xlim()
    ticks = 0
    for line in ax.get_lines():
        if line.get_label().startswith(("one ", "_child")) and np.isnan(line.get_ydata()).any():
            places = line.get_xdata()
            assert ((places >= left) & (places <= right)).all()
            ticks += int(np.isnan(line.get_ydata()).sum())
    said = [re.fullmatch(r"(\d+) more", text.get_text()) for text in ax.texts]
    return ticks, sum(int(count[1]) for count in said if count)


@pytest.mark.parametrize("study", ["both", "classical"])
def test_every_subject_is_drawn_or_counted(study, request):
    document = as_results(request.getfixturevalue(study))
    for drawing in interval_drawings(document):
        parameter = drawing.name.removeprefix("overview_")
        wanted = sum(cell.n for cell in document.data.cells if cell.parameter == parameter)
        ticks, counted = people_drawn(drawing)
        assert ticks + counted == wanted
        assert counted > 0


@pytest.mark.parametrize(
    ("adjusted", "beyond"),
    [((-5.0, 0.0, 9.0, 10.0), 2), ((10.0,), 0), ((9.0, 1e9), 1), ((), 0)],
    ids=["no logarithm", "alone", "far", "nobody"],
)
def test_who_is_beyond_the_axis_is_counted(classical, adjusted, beyond):
    drawn_people = []
    for values in (adjusted, ()):
        document = copy.deepcopy(classical)
        cell = document["data"]["cells"][0]
        assert (cell["environment"], cell["parameter"]) == ("VE1", "k")
        cell |= {"values": list(values), "n": len(values)}
        drawn_people.append(people_drawn(interval_drawings(as_results(document))[0]))
    (ticks, counted), (others, others_counted) = drawn_people
    assert (ticks - others, counted - others_counted) == (len(adjusted) - beyond, beyond)


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
            "size": (80.0, 60.0),
            "draw": on,
            **given,
        }
    )


def texts(content):
    return ["".join(element.itertext()) for element in ET.fromstring(content).iter(f"{SVG}text")]


def test_powers_of_ten_are_plain_letters():
    def draw(ax):
        log_scale(ax, "x")
        ax.set_xlim(1e-3, 1e3)

    said = texts(inline(drawing_of(draw)))
    assert {"10⁻³", "10⁰", "10²"} <= set(said)
    assert not [one for one in said if "$" in one or "{" in one]


def test_what_a_user_wrote_is_not_taken_for_colours_references_or_mathematics():
    name = r'id="figure_1" url(#x) #0067a5 --><b> ]]> a$b$c\$'
    drawing = drawing_of(lambda ax: ax.set_title(name), title=name, description=name)
    for content in (file(drawing), inline(drawing)):
        root = ET.fromstring(content)
        assert name in texts(content)
        assert [root.find(f"{SVG}{tag}").text for tag in ("title", "desc")] == [name, name]
    assert "var(--classical)" not in inline(drawing)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["a\x1b[2J\x00b", "環境 ١", "\u202eabc"])
def test_characters_that_a_font_or_xml_does_not_have_break_no_figure(name):
    drawing = drawing_of(lambda ax: ax.set_title(name), title=name, description=name)
    expected = name.replace("\x1b", "\ufffd").replace("\x00", "\ufffd")
    for content in (file(drawing), inline(drawing)):
        assert expected in texts(content)
        root = ET.fromstring(content)
        assert [root.find(f"{SVG}{tag}").text for tag in ("title", "desc")] == [expected, expected]


def test_bars_span_their_limits_and_end_in_arrows_where_the_axis_does():
    ax = axes()
    bars = [
        Bar("A", "mean", "classical", 0.55, 2.0, 1.0),
        Bar("A", "user", "classical", -1.0, 4.0, 1.0),
        Bar("B", "mean", "bayesian", 0.8, 1.6, 1.1),
        Bar("C", "mean", "bayesian", 0.8, 1e4, 1.1),
        Bar("D", "mean", "bayesian", 0.8, 1.6, 1.1),
    ]
    axis = BarAxis(relative=True, log=True)
    kinds = {"mean": "average driver", "user": "next driver"}
    draw_intervals(ax, ["A", "B", "C", "D"], bars, axis, kinds=kinds)
    spans = [tuple(line.get_xdata()) for line in ax.get_lines() if len(line.get_xdata()) == 2]
    assert (0.55, 2.0) in spans
    assert (0.8, 1.6) in spans
    left, right = ax.get_xlim()
    (clipped,) = [span for span in spans if span[1] == 4.0]
    assert left < clipped[0] < 0.8
    (far,) = [span for span in spans if span[1] > 4.0]
    assert far[1] < right < 100.0
    assert [text.get_text() for text in ax.texts] == ["-1", "10000"]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["A", "B", "C", "D"]
    assert axis.is_left_by(bars)
    assert not axis.is_left_by(bars[2:3])


@pytest.mark.parametrize(
    ("kinds", "whom"),
    [
        (("mean", "user", "share"), "the next user"),
        (("mean", "share"), "the average user"),
        (("share",), "a share of all users"),
    ],
)
def test_the_caption_of_boundaries_says_whom_they_are_for(classical, kinds, whom):
    document = copy.deepcopy(classical)
    document["boundaries"] = [row for row in document["boundaries"] if row["kind"] in kinds]
    words = next(one for one in boundary_drawings(as_results(document)) if one.name == "boundaries")
    assert words.description.startswith(f"What {whom} takes for the reference ")


def test_both_methods_are_drawn_in_one_family_and_one_shape(both):
    (drawing,) = [one for one in boundary_drawings(as_results(both)) if one.name == "boundaries"]
    figure = Figure()
    drawing.draw(figure)
    labels = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert {"Bayesian, envelope (lognormal)", "classical, envelope (lognormal)"} <= labels
    assert not [label for label in labels if "corner" in label or "(normal" in label]


def contrast(one, other):
    """WCAG contrast ratio of two colours."""

    def luminance(colour):
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))

    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("name", ["ink", "quiet", "classical", "bayesian", "coupled", "warn"])
def test_colours_stand_out_from_the_paper(name):
    assert contrast(COLOURS[name], COLOURS["paper"]) >= 4.5


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

    def linear(colour):
        parts = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)

    for matrix in seen_by.values():
        classical, bayesian = (matrix @ linear(COLOURS[name]) for name in ("classical", "bayesian"))
        assert np.linalg.norm(classical - bayesian) > 0.25
