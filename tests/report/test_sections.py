"""What the sections of a report choose from its document, and where its pointers lead."""

from __future__ import annotations

import copy
import re

import pytest
from matplotlib.figure import Figure

from percept.report.basis import bibtex, checks, cited, methods
from percept.report.figures import drawings
from percept.report.page import render_page
from percept.report.sections import build_sections
from percept.report.select import at
from percept.sessions.quantities import IMPEDANCE
from tests.documents import as_results, build_document
from tests.study.checked import study_of, table_of


def section(document, name):
    return next(found for found in build_sections(document) if found.name == name).values


@pytest.fixture(params=["lognormal", "normal"])
def document(classical, request):
    """The document holds both families; the scene's is the one on the page."""
    changed = copy.deepcopy(classical)
    changed["provenance"]["scene"]["inference"]["family"] = request.param
    return changed


def test_laws_of_the_band_stand_where_their_pointers_say(document):
    (values,) = section(document, "band")["parts"]
    assert values["family"] == document["provenance"]["scene"]["inference"]["family"]
    assert values["law_rows"]
    labels = ("method", "kind", "family", "model")
    for row in values["law_rows"]:
        for model, law in row["cells"].items():
            wanted = [row["method"], row["kind"], values["family"], model]
            assert [at(document, law["pointer"])[name] for name in labels] == wanted
            assert law["parameters"] == at(document, law["pointer"])["parameters"]
    for row in values["statements"]:
        for column, pointer in zip(values["stated"], row["pointers"], strict=True):
            found = at(document, pointer)
            assert found["statement"] == row["statement"]
            assert {name: found[name] for name in column} == column


def test_memberships_stand_where_their_pointers_say(document):
    memberships = section(document, "coupling")["memberships"]
    labels = ("environment", "kind", "method", "family", "shape")
    assert memberships["rows"]
    for row in memberships["rows"]:
        for column, cell in zip(memberships["columns"], row["cells"], strict=True):
            wanted = [
                row["environment"],
                column["kind"],
                column["method"],
                memberships["family"],
                "envelope",
            ]
            assert [cell[name] for name in labels] == wanted
            assert at(document, cell["pointer"]).items() <= cell.items()


def test_verdicts_stand_where_their_pointers_say(both):
    values = section(both, "verdicts")
    count = 2 * len(both["data"]["environments"])
    for method in ("bayesian", "classical"):
        assert len(values[method]) == count
        for row in values[method]:
            found = at(both, row["pointer"])
            assert found[method] == row[method]
            assert row["rendered"] == ("through the coupling" if found["coupled"] else "directly")


def test_every_environment_has_its_effective_impedance(classical):
    effective = section(classical, "coupling")["effective"]
    assert [row["environment"] for row in effective] == classical["data"]["environments"]


def test_environments_are_told_apart_where_their_intervals_say_different_things(classical):
    document = copy.deepcopy(classical)
    for row in document["intervals"]:
        row["covers"] = "one thing" if row["environment"] == "VE1" else "another"
    sentences = section(document, "intervals")["sentences"]
    told = {one["covers"]: one["where"] for one in sentences if one["kind"] == "mean"}
    assert told == {
        "one thing": ["k of VE1", "b of VE1"],
        "another": [f"{name} of VE{index}" for name in ("k", "b") for index in range(2, 6)],
    }


REGRESSION = (
    "a regression of bias on the logarithm of the reference with a deviation for each environment"
)
SHARED = "subject effects shared by all environments"
PAIR = " and correlated between stiffness and damping"
WITHIN = "between-subject scatter within each environment"


def model_of(*, form="trials", environments=3, parameters=("k", "b"), **model):
    rows = [
        {
            "parameter": p,
            "kind": "mean",
            "method": "bayesian",
            "family": "lognormal",
            "n": 6,
            "reference": 5.0,
        }
        for p in parameters
    ]
    document = {
        "data": {
            "form": form,
            "parameters": [*parameters],
            "quantities": {p: IMPEDANCE[p].model_dump() for p in parameters},
            "environments": [f"VE{j}" for j in range(environments)],
            "words": {name: [name, f"{name}s"] for name in ("environment", "subject", "user")},
        },
        "provenance": {
            "scene": {"inference": {"family": "lognormal"}, "model": model},
            "versions": {"percept": "0"},
        },
        "intervals": rows,
        "diagnostics": None,
        "coupling": None,
        "band": None,
        "boundaries": [],
    }
    return methods(document).values["model"]


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
            f"{REGRESSION}, {SHARED}{PAIR}, and between-subject scatter alike in all environments",
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


@pytest.fixture(scope="module")
def checked():
    table = table_of(("k", "b"), subjects=8, references=[[100.0, 1e3], [1.0, 5.0]], seed=2)
    table.loc[table["subject"] == "S01", "k_adj"] *= 20.0
    return build_document(study_of(table, checks={}, tolerance=0.2), curves=False)


def test_messages_and_tables_stand_on_the_page(checked):
    assert [one.name for one in build_sections(checked)].index("checks") > 0
    page = render_page(checked, {}, date="2026-01-01")
    assert "S01 lies far from what the others predict" in page
    for pointer in (
        "loo/subjects/0/pareto_k", "statistics/0/above", "prior/0/quantiles/99.5",
    ):  # fmt: skip
        assert f'data-at="/checks/{pointer}"' in page, pointer


def test_no_section_without_checks(checked):
    assert checks({**checked, "checks": None}) is None


def test_only_what_was_used_is_cited(classical, both):
    keys = [reference["key"] for reference in cited(classical)]
    assert keys == ["boundaries", "percept", "meeker2017", "adams1999"]
    assert {"emcee", "cotter2013", "vehtari2021"} <= {reference["key"] for reference in cited(both)}


def test_entries_are_balanced_and_have_their_fields(both):
    text = bibtex(both)
    entries = re.findall(r"@(\w+)\{(\w+),", text)
    assert [key for _, key in entries] == [reference["key"] for reference in cited(both)]
    depth = 0
    for letter in text:
        depth += (letter == "{") - (letter == "}")
        assert depth >= 0
    assert depth == 0
    articles = [reference for reference in cited(both) if reference["entry"] == "article"]
    assert all(
        {"author", "title", "journal", "year", "volume", "pages"} <= one["fields"].keys()
        for one in articles
    )


def test_the_page_s_numbers_follow_the_list(both):
    page = render_page(both, {}, date="2026-01-01")
    shown = [int(one) for one in re.findall(r"&nbsp;\[(\d+)\]", page)]
    assert list(dict.fromkeys(shown)) == list(range(1, len(cited(both)) + 1))


def test_of_many_environments_some_are_drawn_and_the_page_says_so(classical):
    document = copy.deepcopy(classical)
    names = [f"E{number:02d}" for number in range(60)]
    document["data"]["environments"] = names
    for part in ("intervals", "boundaries"):
        kept = [row for row in document[part] if row["environment"] == "VE1"]
        document[part] = [row | {"environment": name} for name in names for row in kept]
    document["data"]["cells"] = [
        cell | {"environment": name}
        for name in names
        for cell in document["data"]["cells"]
        if cell["environment"] == "VE1"
    ]
    everywhere = document["design"]["maps"][0]["environments"]
    regions = [everywhere[0] | {"name": name} for name in names]
    document["design"]["maps"][0]["environments"] = [*regions, everywhere[-1]]
    said = "24 of 60 environments are drawn, evenly spaced in their order. The tables hold all."
    by_name = {drawing.name: drawing for drawing in drawings(as_results(document))}
    for name in ("overview_k", "overview_b", "boundaries", "ratios", "design"):
        assert said in by_name[name].description, name
    figure = Figure(figsize=(7.0, 7.0))
    by_name["overview_k"].draw(figure)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert (labels[0], labels[-1], len(labels)) == ("E00", "E59", 24)
    for name, panels in (("boundaries", 24), ("ratios", 72), ("design", 25)):
        figure = Figure(figsize=(7.0, 7.0))
        by_name[name].draw(figure)
        assert len(figure.axes) == panels, name
    explorer = section(document, "boundaries")
    assert [curves["name"] for curves in explorer["curves"]] == labels
    assert said in explorer["left_out"]
    assert said not in render_page(classical, {}, date="2026-01-01")
