"""The section of psychophysics: what stands in its tables, and what is absent without data."""

from __future__ import annotations

import csv
import dataclasses
import io
import json

import pytest

from percept import Scene, Study
from percept.report.overview import findings
from percept.report.page import render_page
from percept.report.psychophysics import psychophysics
from percept.report.tables import csv_tables
from percept.results import Results
from percept.sessions import Sessions
from tests.study.test_psychophysics import repeated


def results_of(repeats, **study):
    inference = {"method": "classical", "level": 0.9}
    scene = Scene(inference=inference, study=study)
    sessions = Sessions.from_frame(repeated(repeats=repeats))
    return Study(sessions, scene).results(curves=False)


@pytest.fixture(scope="module")
def judged():
    return results_of(3, jnd={"k": 0.5})


def page_of(results):
    return render_page(results, findings(results), {}, date="2026-01-01")


def test_each_row_of_the_study_stands_in_one_cell(judged):
    groups = psychophysics(judged).view.groups
    cells = [cell for group in groups for line in group.lines for cell in line.cells if cell]
    assert len(cells) == len(judged.psychophysics)
    assert {id(cell) for cell in cells} == {id(row) for row in judged.psychophysics}
    by_head = {group.head: group for group in groups}
    jnd = by_head["JND (SD of adjustment) of stiffness k, N/m"]
    assert [line.label for line in jnd.lines] == ["weich", "hart"]
    assert [line.label for line in by_head["σ e of stiffness k"].lines] == ["weich", "hart", "all"]


def test_the_page_speaks_of_what_there_is(judged):
    page = page_of(judged)
    assert "A JND is made of the SD of a subject’s own adjustments" in page
    assert "Within one JND?" in page
    without = page_of(results_of(1))
    assert "A JND is made of" not in without
    assert "Within one JND?" not in without


def test_csv_and_json_hold_every_digit(judged):
    tables = csv_tables(judged)
    rows = list(csv.DictReader(io.StringIO(tables["psychophysics.csv"])))
    for row, record in zip(rows, judged.psychophysics, strict=True):
        assert (row["measure"], float(row["upper"])) == (record.measure, record.upper)
    (first, _) = csv.DictReader(io.StringIO(tables["equivalence.csv"]))
    assert first["outcome"] == judged.equivalence[0].outcome
    again = Results.from_plain(json.loads(judged.to_json()))
    assert again.psychophysics == judged.psychophysics
    assert again.equivalence == judged.equivalence


def test_means_have_no_points_of_equality(judged):
    quantities = {
        name: quantity.model_copy(update={"reference": "none"})
        for name, quantity in judged.data.quantities.items()
    }
    data = dataclasses.replace(judged.data, quantities=quantities)
    heads = [
        group.head for group in psychophysics(dataclasses.replace(judged, data=data)).view.groups
    ]
    assert any(head.startswith("JND") for head in heads)
    assert not any("PSE" in head or "onstant error" in head for head in heads)
