"""What is pasted into a paper says what the page says, and nothing in it runs."""

import copy
import dataclasses
import html
import re
import xml.etree.ElementTree as ET

import pytest

from percept import Scene, Study, read_sessions
from percept.report.basis import methods
from percept.report.overview import findings
from percept.report.page import render_page
from percept.report.paste import paste_tables
from percept.results import Results
from tests import DATASETS
from tests.documents import EMPTY, as_results

HOSTILE = r"\input{/etc/passwd} & 50% <b>_$#~^[x]"


def tables(results):
    return paste_tables(results, findings(results).overview.rows)


def cells(text):
    """The texts of the rows of a LaTeX table, as they stood before they were escaped."""
    body = text.partition("\\midrule\n")[2].partition("\\bottomrule")[0]
    rows = []
    for line in body.strip().split("\n"):
        assert line.endswith(r" \\")
        rows.append([cell.strip() for cell in re.split(r"(?<!\\)&", line[:-3])])
    return rows


def plain(text):
    for tex, sign in (("$-$", "−"), (r"\,", "\u202f"), (r"\%", "%"), (r"$\cdot$", "·")):
        text = text.replace(tex, sign)
    return text


def test_tables_say_what_the_page_says(both):
    results = as_results(both)
    page = html.unescape(
        re.sub("<[^>]+>", "", render_page(results, findings(results), {}, date=""))
    )
    files = tables(results)
    assert files.keys() == {
        f"{name}.{form}"
        for name in ("overview", "intervals_k", "intervals_b")
        for form in ("tex", "html")
    }
    for name in ("overview", "intervals_k", "intervals_b"):
        rows = [[plain(cell) for cell in row] for row in cells(files[f"{name}.tex"])]
        for row in rows:
            for cell in row:
                assert cell in page, (name, cell)
        table = ET.fromstring(
            files[f"{name}.html"].partition("\n")[2].replace('charset="utf-8"', 'a=""/')
        )
        found = [[cell.text for cell in row] for row in table.iter("tr")]
        assert found[1:] == rows


def test_names_become_no_commands(both):
    document = copy.deepcopy(both)
    for part in ("intervals", "boundaries"):
        for row in document[part]:
            row["environment"] = row["environment"].replace("VE1", HOSTILE)
    document["boundaries"] = []
    files = tables(as_results(document))
    for name, text in files.items():
        if name.endswith(".html"):
            assert html.escape(HOSTILE) in text
            assert "<b>" not in text
            continue
        assert r"\input" not in text
        row = next(line for line in text.split("\n") if "etc/passwd" in line)
        assert r"\textbackslash{}input\{/etc/passwd\} \& 50\% <b>\_\$\#" in row
        assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")


def test_a_study_without_intervals_has_no_tables_and_no_paragraph():
    assert paste_tables(EMPTY, ()) == {}
    assert findings(EMPTY).paragraph == ""


def test_the_paragraph_has_the_numbers_of_the_first_screen(both):
    said = findings(as_results(both))
    sentences = " ".join(said.overview.sentences)
    intervals = re.findall(r"99 % credible interval ([^)]+)\)", said.paragraph)
    assert intervals
    for interval in intervals:
        assert interval in sentences
    assert said.paragraph.startswith(
        "These results are of simulated data. Stiffness was set 43 % too"
    )
    assert said.paragraph.count("99 % CI ") == len(intervals)


def test_the_paragraph_of_the_classical_method_and_of_many_environments(classical):
    said = findings(as_results(classical)).paragraph
    assert "credible" not in said
    assert " showed no clear bias in " in said
    document = copy.deepcopy(classical)
    shifted = [row for row in document["intervals"] if row["environment"] == "VE1"]
    names = [f"E{number}" for number in range(12)]
    document["intervals"] = [row | {"environment": name} for name in names for row in shifted]
    document["boundaries"] = []
    said = findings(as_results(document)).paragraph
    assert "in E9 (99 % CI" in said
    assert "and off in 2 more environments." in said


@pytest.fixture(scope="module")
def offsets():
    """A study whose references are zero."""
    scene = Scene.load(DATASETS / "illusions.toml").with_inference(tolerance=0.3)
    scene = scene.with_tables(
        model=scene.model.model_dump(exclude_none=True) | {"priors": {"alpha_sd": 2.0}}
    )
    return Study(read_sessions(DATASETS / "illusions.csv", scene=scene), scene).results()


def test_methods_of_zero_references_speak_of_no_logarithm(offsets):
    view = methods(offsets).view
    assert view.model.startswith("a common bias with a deviation for each illusion, ")
    assert view.classical_families == ["normal"]
    page = render_page(offsets, findings(offsets), {}, date="")
    paragraph = page.partition('<blockquote id="paragraph"')[2].partition("</blockquote>")[0]
    assert "logarithm" not in paragraph.replace("lognormal", "")
    assert "lognormal" not in paragraph
    assert (
        "Of the priors, the SD of the common bias alpha (response scale) was 2; all others are"
        " percept’s defaults."
    ) in paragraph


def test_priors_that_nobody_changed_are_said_to_be_the_defaults(offsets):
    scene = copy.deepcopy(dict(offsets.provenance.scene))
    scene["model"] = scene["model"] | {"priors": {}}
    provenance = dataclasses.replace(offsets.provenance, scene=scene)
    results = dataclasses.replace(offsets, provenance=provenance)
    assert methods(results).view.priors == "All priors are percept’s defaults."
    assert isinstance(results, Results)
