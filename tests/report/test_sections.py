"""What the sections of a report choose from its results."""

from __future__ import annotations

import copy
import dataclasses
import re

import pytest
from matplotlib.figure import Figure

from percept import Scene
from percept.report.basis import bibtex, checks, cited, methods
from percept.report.feelings import coupling_sentences
from percept.report.figures import drawings
from percept.report.overview import findings
from percept.results import IntervalRow, Prior
from percept.sessions.quantities import IMPEDANCE
from tests.documents import EMPTY, as_results, build_document, page_of, sections_of
from tests.study.checked import study_of, table_of


def section(document, name):
    return next(found for found in sections_of(document) if found.name == name).view


@pytest.fixture(params=["lognormal", "normal"])
def document(classical, request):
    """The document holds both families; the scene's is the one on the page."""
    changed = copy.deepcopy(classical)
    changed["provenance"]["scene"]["inference"]["family"] = request.param
    return changed


END = {
    "stiffness": 9e3, "damping": 2.0, "probability": 0.97, "error": 0.01, "draws": 512,
    "bound": "plane",
}  # fmt: skip


def test_couplings_that_feel_real_are_named_with_their_span(both):
    changed = copy.deepcopy(both)
    absent = {"stiffest": None, "softest": None, "outcome": "none"}
    environments = changed["design"]["environments"] = [
        both["design"]["environments"][0] | {"name": name} | absent
        for name in ("VE1", "VE2", "VE3", "VE4", None)
    ]
    sure = "with 95 % probability or more"
    (none,) = coupling_sentences(as_results(changed))
    assert none == (
        f"No coupling is stable in time and feels real in VE1, VE2, VE3 and VE4 {sure}."
    )
    environments[1] |= {"stiffest": END, "softest": END | {"stiffness": 700.0}}
    environments[2] |= {"outcome": "undecided"}
    said = coupling_sentences(as_results(changed))
    assert said == [
        f"Couplings that are stable in time feel real in VE2 (0.7 to 9 kN/m) {sure}.",
        f"No coupling is stable in time and feels real in VE1 and VE4 {sure}.",
        "Whether one is in VE3 the data do not decide.",
    ]
    sentences = findings(as_results(changed)).overview.sentences
    assert any(sentence.endswith(" ".join(said)) for sentence in sentences)
    for row in environments:
        row |= {"stiffest": None, "softest": None, "outcome": "undecided"}
    assert coupling_sentences(as_results(changed)) == [
        f"Whether a coupling is stable in time and feels real in VE1, VE2, VE3 and VE4 {sure},"
        " the data do not decide."
    ]
    for row in environments:
        row |= {"stiffest": END | {"bound": "map"}, "softest": END}
    (every,) = coupling_sentences(as_results(changed))
    assert every.endswith(f"VE3 (9 kN/m and more) and VE4 (9 kN/m and more) {sure}.")
    changed["design"] = None
    assert coupling_sentences(as_results(changed)) == []


def test_every_environment_has_its_effective_impedance(classical):
    memberships = classical["coupling"]["memberships"]
    assert [row["environment"] for row in memberships] == classical["data"]["environments"]


REGRESSION = (
    "a regression of bias on the logarithm of the reference with a deviation for each environment"
)
SHARED = "subject effects shared by all environments"
PAIR = " and correlated between stiffness and damping"
WITHIN = "between-subject scatter within each environment"


def model_of(*, form="trials", environments=3, parameters=("k", "b"), diagnostics=None, **model):
    scene = Scene(
        model=model, inference={"method": "bayesian"}, study={"subject": ["subject", "subjects"]}
    )
    row = IntervalRow(
        environment="VE0", parameter="k", kind="mean", method="bayesian", family="lognormal",
        joint="marginal", level=0.99, share=None, confidence=None, lower=4.0, upper=6.0,
        estimate=5.0, n=6, unit="", reference=5.0, covers="",
    )  # fmt: skip
    data = dataclasses.replace(
        EMPTY.data, form=form, parameters=parameters,
        quantities={p: IMPEDANCE[p] for p in parameters},
        environments=tuple(f"VE{j}" for j in range(environments)),
    )  # fmt: skip
    results = dataclasses.replace(
        EMPTY, data=data,
        provenance=dataclasses.replace(EMPTY.provenance, scene=scene.to_dict()),
        intervals=tuple(dataclasses.replace(row, parameter=p) for p in parameters),
        diagnostics=diagnostics,
    )  # fmt: skip
    return methods(results).view.model


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, f"{REGRESSION}, {SHARED}{PAIR}, and {WITHIN}"),
        ({"parameters": ("k",)}, f"{REGRESSION}, {SHARED}, and {WITHIN}"),
        ({"environments": 1}, "a bias, and between-subject scatter"),
        ({"form": "summary"}, f"{REGRESSION}, and {WITHIN} (stiffness and damping each by itself)"),
        ({"subject_effect": False}, f"{REGRESSION}, and {WITHIN}"),
        (
            {"common_spread": True},
            f"{REGRESSION}, {SHARED}{PAIR}, and between-subject scatter equal in all environments",
        ),
        (
            {"weber": True, "parameters": ("b",)},
            (
                f"{REGRESSION}, {SHARED}, and {WITHIN}, "
                "in proportion to the reference but for each environment’s own deviation"
            ),
        ),
    ],
)
def test_the_model_that_was_fitted_is_named(given, said):
    assert model_of(**given) == said


def test_subjects_own_trial_sds_are_named(both):
    prior = Prior(prior="omega_s_scale", value=0.5, meaning="")
    diagnostics = dataclasses.replace(as_results(both).diagnostics, priors=(prior,))
    said = model_of(diagnostics=diagnostics)
    assert said.endswith(f"{WITHIN}, with trial SDs that differ between subjects")


@pytest.fixture(scope="module")
def checked():
    table = table_of(("k", "b"), subjects=8, references=[[100.0, 1e3], [1.0, 5.0]], seed=2)
    table.loc[table["subject"] == "S01", "k_adj"] *= 20.0
    return build_document(study_of(table, checks={}, tolerance=0.2), curves=False)


def test_messages_and_tables_stand_on_the_page(checked):
    assert [one.name for one in sections_of(checked)].index("checks") > 0
    page = page_of(checked)
    assert "S01 lies far from what the others predict" in page
    for pointer in (
        "loo/subjects/0/pareto_k", "statistics/0/above",
    ):  # fmt: skip
        assert f'data-at="/checks/{pointer}"' in page, pointer


def test_no_section_without_checks(checked):
    assert checks(as_results({**checked, "checks": None})) is None


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
    everywhere = document["design"]["environments"]
    regions = [everywhere[0] | {"name": name} for name in names]
    document["design"]["environments"] = [*regions, everywhere[-1]]
    said = "24 of 60 environments are drawn, evenly spaced in their order. The tables hold all."
    by_name = {drawing.name: drawing for drawing in drawings(as_results(document))}
    for name in ("overview_all_k", "overview_all_b", "boundaries", "ratios", "design"):
        assert said in by_name[name].description, name
    figure = Figure(figsize=(7.0, 7.0))
    by_name["overview_all_k"].draw(figure)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert (labels[0], labels[-1], len(labels)) == ("E00", "E59", 24)
    foremost = by_name["overview_k"]
    assert foremost.title.endswith(": 10 of 60 environments, those whose bias is clearest")
    figure = Figure(figsize=(7.0, 7.0))
    foremost.draw(figure)
    assert len(figure.axes[0].get_yticklabels()) == 10
    for name, panels in (("boundaries", 24), ("ratios", 72), ("design", 25)):
        figure = Figure(figsize=(7.0, 7.0))
        by_name[name].draw(figure)
        assert len(figure.axes) == panels, name
    explorer = section(document, "boundaries")
    assert [curves["name"] for curves in explorer.curves] == labels
    assert said in explorer.left_out
    assert said not in page_of(classical)
    screen = section(document, "summary")
    assert len(screen.lines) == 10
    assert len(screen.lines) + len(screen.folded) == 120
    assert screen.every == ["overview_all_k", "overview_all_b"]
    assert section(classical, "summary").folded == []


def test_every_subject_has_a_row_that_warnings_lead_to(both):
    document = copy.deepcopy(both)
    subjects = list(dict.fromkeys(row["subject"] for row in document["data"]["people"]))
    checks = []
    for subject in subjects:
        outlier = subject in ("S03", "S09")
        check = {"subject": subject, "elpd": -1.0, "pareto_k": 0.3}
        checks.append(check | {"farther": 0.5, "outlier": outlier})
    loo = {"elpd": -9.0, "se": 1.0, "good_k": 0.7, "subjects": checks, "cells": []}
    document["checks"] = {"normality": [], "loo": loo | {"messages": ["S03 leads."]}}
    page = page_of(document)
    for rank, subject in enumerate(subjects, start=1):
        assert f'<tr id="subject-{rank}"><th scope="row">{subject}</th>' in page
    assert '<a href="#subject-3">S03</a>, <a href="#subject-9">S09</a>.' in page
