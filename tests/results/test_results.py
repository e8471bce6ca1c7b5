"""Results as JSON and back: every digit stays, and what is no report is refused by its place."""

import dataclasses
import json
import math

import numpy as np
import pandas as pd
import pytest

from percept.errors import UsageError
from percept.results import (
    SCHEMA,
    Boundary,
    Data,
    Findings,
    IntervalRow,
    Provenance,
    Results,
    Skipped,
    Words,
)
from percept.sessions.quantities import IMPEDANCE
from percept.sessions.records import Source

INTERVAL = IntervalRow(
    environment="wäll/1~", parameter="k", kind="user", method="bayesian", family="lognormal",
    joint="marginal", level=0.99, share=None, confidence=None, lower=0.1, upper=math.inf,
    estimate=1 / 3, n=4, unit="N/m", reference=-0.0, covers="The next user's value.",
)  # fmt: skip
BOUNDARY = Boundary(
    environment="wäll/1~", kind="mean", method="classical", family="normal", joint="marginal",
    shape="corner", level=0.99, omega=np.array([0.1, 1.0]), lower=np.array([1e-300, 2.0]),
    upper=np.array([np.inf, np.nan]), reference=np.array([1.0, 2.0]),
)  # fmt: skip
RESULTS = Results(
    provenance=Provenance(
        {"percept": "0.1.0"}, 1, (Source("a.csv", "00", 3),), {"frequency": {"upper": 100.0}}
    ),
    data=Data(
        form="trials", simulated=False, subjects=4, rows=4, environments=("wäll/1~",),
        parameters=("k",), quantities={"k": IMPEDANCE["k"]},
        words=Words("wall", "walls", "user", "users", "user", "users"),
        counts={"rows read": 4}, notices=(), references=1,
        doubts=(), exclusions=(), design=None, cells=(),
    ),
    intervals=(INTERVAL,), contrast=(), boundaries=(BOUNDARY,),
    verdicts=(), rendering=None, coupling=None, band=None, design=None, sensitivity=None,
    comparison=None, band_pairs=None, ladder=None, diagnostics=None, checks=None,
    skipped=(Skipped("band law", "one environment"),),
)  # fmt: skip
SUMMARY = Findings(("one",), (), "")


def written(tmp_path, text):
    path = tmp_path / "report.json"
    path.write_text(text, encoding="utf-8")
    return path


def test_results_come_back_digit_for_digit(tmp_path):
    path = written(tmp_path, RESULTS.to_json(SUMMARY))
    loaded = Results.load(path)
    assert loaded.intervals == RESULTS.intervals
    assert (loaded.provenance, loaded.data) == (RESULTS.provenance, RESULTS.data)
    assert loaded.skipped == RESULTS.skipped
    (boundary,) = loaded.boundaries
    for field in dataclasses.fields(Boundary):
        before = getattr(BOUNDARY, field.name)
        after = getattr(boundary, field.name)
        if isinstance(before, np.ndarray):
            np.testing.assert_array_equal(after, before)
        else:
            assert after == before
    assert loaded.to_json(SUMMARY) == path.read_text(encoding="utf-8")


def test_a_document_names_its_schema_and_every_field():
    document = json.loads(RESULTS.to_json())
    assert document["schema"] == SCHEMA
    names = [field.name for field in dataclasses.fields(Results)]
    assert list(document)[1:] == [*names, "impedances", "covers"]


def test_tables_stand_by_columns_and_what_rows_share_stands_once(tmp_path):
    rows = (INTERVAL, dataclasses.replace(INTERVAL, n=5))
    results = dataclasses.replace(RESULTS, intervals=rows, boundaries=(BOUNDARY, BOUNDARY))
    path = written(tmp_path, results.to_json())
    document = json.loads(path.read_text(encoding="utf-8"))
    table = pd.DataFrame(document["intervals"])
    assert table["n"].tolist() == [4, 5]
    assert [document["covers"][place] for place in table["covers"]] == [INTERVAL.covers] * 2
    assert "omega" not in document["boundaries"]
    assert document["impedances"][BOUNDARY.environment]["omega"] == [0.1, 1.0]
    loaded = Results.load(path)
    assert loaded.intervals == rows
    for boundary in loaded.boundaries:
        np.testing.assert_array_equal(boundary.reference, BOUNDARY.reference)


def test_a_file_that_is_no_report_is_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot be read: No such file"):
        Results.load(tmp_path / "none.json")
    with pytest.raises(UsageError, match="is not JSON"):
        Results.load(written(tmp_path, "{"))
    with pytest.raises(UsageError, match="is not JSON"):
        Results.load(written(tmp_path, "[" * 100_000))
    for text in ("[]", "{}", '{"schema": "percept-report/1"}'):
        with pytest.raises(UsageError, match=f"This percept reads {SCHEMA}"):
            Results.load(written(tmp_path, text))


@pytest.mark.parametrize(
    ("name", "value", "place"),
    [
        ("data", 3, "data"),
        ("intervals", {"environment": ["a"], "covers": [0]}, "intervals/0/parameter"),
        ("verdicts", {"environment": [1]}, "verdicts/0/"),
        ("skipped", [{"what": "a", "why": 2}], "skipped/0/why"),
    ],
)
def test_a_damaged_report_is_refused_by_its_place(tmp_path, name, value, place):
    document = json.loads(RESULTS.to_json()) | {name: value}
    with pytest.raises(UsageError) as refused:
        Results.load(written(tmp_path, json.dumps(document)))
    assert refused.value.key.startswith(place)
    assert "report.json" in str(refused.value)


@pytest.mark.parametrize("table", [3, {"n": [1, 2], "covers": [0]}, {"n": [1], "covers": [9]}])
def test_damaged_tables_are_refused(tmp_path, table):
    document = json.loads(RESULTS.to_json()) | {"intervals": table}
    with pytest.raises(UsageError, match="its tables are damaged"):
        Results.load(written(tmp_path, json.dumps(document)))
