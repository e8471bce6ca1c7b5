"""What the sections of a report choose from its results."""

from __future__ import annotations

import copy
import dataclasses
import re

import pytest
from matplotlib.figure import Figure

from percept.report.decisions import coupling_sentences
from percept.report.figures import drawings
from percept.report.methods import bibtex, cited, model_words
from percept.report.overview import findings
from tests.documents import as_results, build_document, page_of, parts_of, sections_of
from tests.study.checked import study_of, table_of

END = {
    "stiffness": 9e3, "damping": 2.0, "probability": 0.97, "error": 0.01, "draws": 512,
    "bound": "plane",
}  # fmt: skip


def said_of(document):
    return coupling_sentences(as_results(document))


def test_couplings_that_feel_real_are_named_with_their_span(both):
    changed = copy.deepcopy(both)
    changed["design"]["together"] = None
    absent = {"stiffest": None, "softest": None, "outcome": "none"}
    environments = changed["design"]["environments"] = [
        both["design"]["environments"][0] | {"name": name} | absent
        for name in ("VE1", "VE2", "VE3", "VE4")
    ]
    assert said_of(changed) == [
        "For VE1, VE2, VE3 and VE4, no coupling reaches 95 % probability of feeling real."
    ]
    environments[1] |= {"stiffest": END, "softest": END | {"stiffness": 700.0}, "outcome": "some"}
    environments[2] |= {"outcome": "undecided"}
    said = said_of(changed)
    assert said == [
        "With 95 % probability, couplings make VE2 (0.7 kN/m with 2 N·s/m to 9 kN/m with"
        " 2 N·s/m) feel real.",
        "For VE1 and VE4, no coupling reaches 95 % probability of feeling real.",
        "Whether a coupling makes VE3 feel real the data do not decide.",
    ]
    sentences = findings(as_results(changed)).sentences
    assert sentences[1] == " ".join(said)
    environments[0] |= {"stiffest": END | {"bound": "map"}, "softest": END, "outcome": "some"}
    assert said_of(changed)[0].endswith(
        " make VE1 (9 kN/m with 2 N·s/m to rigid) and VE2 (0.7 kN/m with 2 N·s/m to 9 kN/m with"
        " 2 N·s/m) feel real; none of these ends serves both."
    )
    for row in environments:
        row |= {"stiffest": END, "softest": END, "outcome": "some"}
    changed["design"]["together"] = END
    assert said_of(changed) == [
        "With 95 % probability, couplings make VE1, VE2, VE3 and VE4 feel real; 9 kN/m with"
        " 2 N·s/m serves all of them."
    ]


def test_the_model_that_was_fitted_is_named(both):
    results = as_results(both)
    assert model_words(results) == (
        "a common bias, a regression of bias on the logarithm of the reference, a deviation for"
        " each environment, effects of each subject, a trend over the reference for each subject,"
        " scatter between subjects within each environment, a trend of this scatter over the"
        " reference and correlations of the quantities"
    )
    # What a simpler model lacks has no prior in force.
    priors = [prior for prior in results.diagnostics.priors if prior.prior != "kappa_sd"]
    weber = dataclasses.replace(results.diagnostics, priors=tuple(priors))
    assert "trend of this scatter" not in model_words(
        dataclasses.replace(results, diagnostics=weber)
    )


@pytest.fixture(scope="module")
def checked():
    table = table_of(("k", "b"), subjects=8, references=[[100.0, 1e3], [1.0, 5.0]], seed=2)
    table.loc[table["subject"] == "S01", "k_adj"] *= 20.0
    return build_document(study_of(table, checks={}, tolerance=0.2), curves=False)


def test_messages_and_tables_stand_on_the_page(checked):
    page = page_of(checked)
    assert "S01 is an outlier" in page
    rows = checked["checks"]
    shown = [rows["loo"]["subjects"][0]["farther"], rows["statistics"][0]["above"]]
    for number in (*shown, rows["normality"][0]["p_value"]):
        assert f'<data value="{number}">' in page


def test_no_section_without_checks(checked):
    assert "model" not in parts_of(sections_of({**checked, "checks": None}))


def test_only_what_was_used_is_cited(classical, both):
    keys = [reference.key for reference in cited(as_results(classical))]
    assert keys == ["boundaries", "percept", "meeker2017", "adams1999", "colgate1997"]
    assert {"emcee", "cotter2013", "vehtari2021"} <= {
        reference.key for reference in cited(as_results(both))
    }


def test_entries_are_balanced_and_have_their_fields(both):
    results = as_results(both)
    text = bibtex(results)
    entries = re.findall(r"@(\w+)\{(\w+),", text)
    assert [key for _, key in entries] == [reference.key for reference in cited(results)]
    depth = 0
    for letter in text:
        depth += (letter == "{") - (letter == "}")
        assert depth >= 0
    assert depth == 0
    articles = [reference for reference in cited(results) if reference.entry == "article"]
    assert all(
        {"author", "title", "journal", "year", "volume", "pages"} <= one.fields.keys()
        for one in articles
    )


@pytest.mark.evidence
def test_of_many_environments_some_are_drawn_and_the_page_says_so(classical):
    document = copy.deepcopy(classical)
    names = [f"E{number:02d}" for number in range(60)]
    document["data"]["environments"] = names
    for part in ("intervals", "boundaries"):
        kept = [row for row in document[part] if row["environment"] == "VE1"]
        document[part] = [row | {"environment": name} for name in names for row in kept]
    shared = document["impedances"]
    document["impedances"] = dict.fromkeys(names, shared["VE1"])
    document["data"]["cells"] = [
        cell | {"environment": name}
        for name in names
        for cell in document["data"]["cells"]
        if cell["environment"] == "VE1"
    ]
    results = as_results(document)
    by_name = {drawing.name: drawing for drawing in drawings(results)}
    said = (
        "Figures, curves, couplings and results without each subject are of the first 10 of 60"
        " environments."
    )
    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    by_name["overview"].draw(figure)
    assert len(figure.axes[0].get_yticklabels()) == 10
    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    by_name["ratios"].draw(figure)
    assert len(figure.axes) == 10
    parts = parts_of(sections_of(document))
    for name in ("overview", "ratios"):
        assert by_name[name].description.endswith(said)
    assert said in parts["boundaries"].sentences
    assert coupling_sentences(results)[-1] == said
    (table,) = parts["environments"].tables
    assert len(table.rows) == 10
    assert table.caption.endswith("The first 10 of 60; the sections below have all.")
