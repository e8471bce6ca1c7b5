"""The section of model checks: every table that is there, with its numbers' places."""

import pytest

from percept.report import build_document
from percept.report.page import render_page
from percept.report.sections import build_parts
from percept.report.sections.checks import build
from tests.study.checked import study_of, table_of


@pytest.fixture(scope="module")
def document():
    table = table_of(("k", "b"), subjects=8, references=[[100.0, 1e3], [1.0, 5.0]], seed=2)
    table.loc[table["subject"] == "S01", "k_adj"] *= 20.0
    return build_document(study_of(table, checks={}, tolerance=0.2), curves=False)


def test_messages_and_tables_stand_on_the_page(document):
    assert [part.name for part in build_parts(document)].index("checks") > 0
    page = render_page(document, {}, date="2026-01-01")
    assert "S01 lies far from what the others predict" in page
    for place in (
        "loo/subjects/0/pareto_k", "statistics/0/above", "shrinkage/0/moved", "correlation/0/positive",
        "weber/1/upper", "sensitivity/0/prior", "prior/0/q99.5",
    ):  # fmt: skip
        assert f'data-at="/checks/{place}"' in page, place
    assert "/checks/models" not in page


def test_compared_models_are_a_table_and_a_sentence(document):
    row = {"model": "full", "elpd": 1.0, "se": 2.0, "difference": 0.0, "difference_se": 0.0, "rough": 0}
    models = {"table": [row], "failed": ["exact Weber: stuck"], "sentence": "All are alike."}
    part = build({**document, "checks": {**document["checks"], "models": models}})
    assert {"All are alike.", "exact Weber: stuck"} <= set(part.values["messages"])
    places = [table["place"] for table in part.values["tables"]]
    assert places[1] == "/checks/models/table"


def test_no_section_without_checks(document):
    assert build({**document, "checks": None}) is None
