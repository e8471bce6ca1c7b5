"""What is pasted into a paper says what the page says, and nothing in it runs."""

import copy
import html
import re
import xml.etree.ElementTree as ET

import pytest

from percept import Scene, Study, read_sessions
from percept.report.decisions import feeling_sentences
from percept.report.methods import methods_paragraph, model_words
from percept.report.overview import findings, setting_sentences
from percept.report.tables import paste_tables
from percept.report.write import build_sections
from tests import DATASETS
from tests.documents import EMPTY, as_results, page_of_results

HOSTILE = r"\input{/etc/passwd} & 50% <b>_$#~^[x]"


#: What pdfTeX writes as it stands, of what is not ASCII.
LATIN = set("–’“”…ê")


def page_of(results):
    return page_of_results(results, files={"overview.csv"})


def tables(results):
    sections = build_sections(results, findings(results))
    return paste_tables(sections, simulated=results.data.simulated)


def rows_of(text):
    """The texts of the rows of a LaTeX table, heads and all, as before they were escaped."""
    body = text.partition("\\toprule\n")[2].partition("\\bottomrule")[0]
    rows = []
    for line in body.replace("\\midrule\n", "").strip().split("\n"):
        assert line.endswith(r" \\")
        rows.append([plain(cell.strip()) for cell in re.split(r"(?<!\\)&", line[:-3])])
    return rows


def plain(text):
    """Undo the escapes of numbers and words, by a list of its own."""
    escapes = {
        "$-$": "−", r"\,": "\u202f", r"\%": "%", r"$\cdot$": "·", r"$\times$": "×", "$|$": "|",
        r"$\sigma$": "σ", r"$\gamma$": "γ", r"$\eta$": "η", "$^2$": "²", r"$\varepsilon$": "ε",
        r"$\pm$": "±", r"$\omega$": "ω", "$<$": "<", "$>$": ">", "$^{-}$": "⁻", r"\_": "_",
        r"$\dagger$": "†",
    }  # fmt: skip
    for tex, sign in escapes.items():
        text = text.replace(tex, sign)
    for digit, raised in zip("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹", strict=True):
        text = text.replace(f"$^{{{digit}}}$", raised)
    return text


def word_rows(page):
    """The cells of a page of one table, by ElementTree."""
    body = page.partition("</p>")[2].partition("</body>")[0].replace("<table border", "<table")
    rows = []
    for row in ET.fromstring(body).iter("tr"):
        cells = []
        for cell in row:
            cells.append("".join(cell.itertext()))
        rows.append(cells)
    return rows


def test_every_table_is_told_as_on_the_page(both):
    results = as_results(both)
    page = html.unescape(re.sub("<[^>]+>", "", page_of(results)))
    files = tables(results)
    named = {name.partition(".")[0] for name in files}
    assert {"overview", "intervals_k", "psychophysics", "subjects", "verdicts"} <= named
    assert files.keys() == {f"{name}.{form}" for name in named for form in ("tex", "html")}
    for name in named:
        text = files[f"{name}.tex"]
        rows = rows_of(text)
        word = word_rows(files[f"{name}.html"])
        assert rows == word
        for cell in {cell for row in rows for cell in row}:
            assert cell.replace("_", "") in page.replace("_", ""), (name, cell)
        columns = text.partition(r"\begin{tabular}{")[2].partition("}")[0]
        assert {len(row) for row in rows} == {len(columns)}
        caption = text.partition(r"\caption{")[2].partition("}\n")[0]
        assert plain(caption).removesuffix(" Simulated data.").replace("_", "") in page
        assert caption.endswith("Simulated data.")
        assert {sign for sign in text if ord(sign) > 127} <= LATIN


def test_names_become_no_commands(both):
    document = copy.deepcopy(both)
    for part in ("intervals", "boundaries"):
        for row in document[part]:
            name = row["environment"].replace("VE1", HOSTILE)
            row["environment"] = name.replace("VE2", "*VE2")
    document["boundaries"] = []
    files = tables(as_results(document))
    told = [name for name, text in files.items() if "etc/passwd" in text]
    assert {"overview.tex", "intervals_b.tex", "overview.html"} <= set(told)
    for name in told:
        text = files[name]
        if name.endswith(".html"):
            assert html.escape(HOSTILE) in text
            assert "<b>" not in text
            continue
        assert r"\input" not in text
        row = next(line for line in text.split("\n") if "etc/passwd" in line)
        assert r"\textbackslash{}input\{/etc/passwd\} \& 50\% $<$b$>$\_\$\#" in row
        assert "\n*VE2" not in text
        assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")


def test_a_study_without_intervals_has_no_tables_and_no_paragraph():
    assert paste_tables([], simulated=False) == {}
    assert findings(EMPTY).paragraph == ""


def test_the_paragraph_has_the_sentences_of_the_page(both):
    results = as_results(both)
    said = findings(results).paragraph
    assert said.startswith("These results are of simulated data. Users set stiffness above the")
    assert said.endswith(" ".join([*setting_sentences(results), *feeling_sentences(results)]))


@pytest.fixture(scope="module")
def offsets():
    """A study whose references are zero."""
    scene = Scene.load(DATASETS / "illusions.toml").with_inference(tolerance=0.3)
    scene = scene.with_tables(
        model=scene.model.model_dump(exclude_none=True) | {"priors": {"alpha_sd": 2.0}}
    )
    return Study(read_sessions(DATASETS / "illusions.csv", scene=scene), scene).results()


def test_methods_of_zero_references_speak_of_no_logarithm(offsets):
    assert model_words(offsets).startswith("a common bias, a deviation for each illusion, ")
    paragraph = " ".join(methods_paragraph(offsets))
    assert "logarithm" not in paragraph
    assert "lognormal" not in paragraph
    assert "All priors are percept’s defaults but for alpha_sd = 2." in paragraph


def test_what_is_above_zero_is_not_called_too_high(offsets):
    said = findings(offsets)
    assert "set offset above zero in " in said.sentences[0]
    assert "the reference in" not in said.paragraph
