"""The section of psychophysics: what stands in its tables, and what is absent without data."""

from __future__ import annotations

import csv
import io

import pytest

from percept import Scene, Study
from percept.report.adjustments import adjustments
from percept.report.basics import Value
from percept.report.tables import csv_tables
from percept.sessions import Sessions
from tests.documents import as_results, page_of_results, parts_of, with_rows
from tests.study.test_psychophysics import repeated


def results_of(repeats, **study):
    inference = {"method": "classical", "level": 0.9}
    scene = Scene(inference=inference, study=study)
    sessions = Sessions.from_frame(repeated(repeats=repeats))
    return Study(sessions, scene).results(curves=False)


@pytest.fixture(scope="module")
def judged():
    return results_of(3, jnd={"k": 0.5})


def section_of(results):
    return parts_of([adjustments(results)])["psychophysics"]


def test_each_row_of_the_study_stands_in_one_cell(judged):
    (table,) = section_of(judged).tables
    shown = []
    for row in table.rows:
        for cell in row:
            numbers = [part.exact for part in cell if isinstance(part, Value)]
            shown += [tuple(numbers)] * bool(numbers)
    elsewhere = {("sigma_e", True)}
    expected = [
        row
        for row in judged.psychophysics
        if (row.measure, row.environment is not None) not in elsewhere
    ]
    assert sorted(shown) == sorted((row.estimate, row.lower, row.upper) for row in expected)
    assert table.caption == "Measures with 90 % limits."
    assert list(table.heads) == ["Measure", "Of", "k, classical"]
    jnd = ("JND (N/m)",)
    assert [row[1] for row in table.rows if row[0] == jnd][:2] == [("weich",), ("hart",)]


def test_the_page_speaks_of_what_there_is(judged):
    page = page_of_results(judged)
    assert "JND (N/m)" in page
    assert "Within one JND?" in page
    without = page_of_results(results_of(1))
    assert "JND" not in without


def test_csv_and_json_hold_every_digit(judged):
    tables = csv_tables(judged)
    rows = list(csv.DictReader(io.StringIO(tables["psychophysics.csv"])))
    for row, record in zip(rows, judged.psychophysics, strict=True):
        assert (row["measure"], float(row["upper"])) == (record.measure, record.upper)
    (first, _) = csv.DictReader(io.StringIO(tables["equivalence.csv"]))
    assert first["outcome"] == judged.equivalence[0].outcome
    again = as_results(with_rows(judged.to_json()))
    assert again.psychophysics == judged.psychophysics
    assert again.equivalence == judged.equivalence
