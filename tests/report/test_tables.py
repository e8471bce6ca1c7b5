from __future__ import annotations

import copy
import csv
import io

import pandas as pd
import pytest

from percept.report.basics import rounded
from percept.report.tables import csv_tables
from tests.documents import as_results

from .conftest import DATASETS


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


@pytest.mark.parametrize(
    ("name", "part"),
    [("intervals", "intervals"), ("data", "data/cells"), ("band", "band/rows")],
)
def test_numbers_read_back_to_the_same_doubles_and_text_to_itself(classical, name, part):
    records = classical
    for step in part.split("/"):
        records = records[step]
    rows = rows_of(csv_tables(as_results(classical))[f"{name}.csv"])
    assert len(rows) == len(records)
    for row, record in zip(rows, records, strict=True):
        assert row.keys() == record.keys()
        for field, value in record.items():
            if isinstance(value, float):
                assert float(row[field]) == value
            elif isinstance(value, str):
                assert row[field] == value


def test_the_paper_s_table_comes_out_to_the_digit(classical):
    published = pd.read_csv(DATASETS / "hbfd_table1.csv", dtype=str)
    rows = rows_of(csv_tables(as_results(classical))["intervals.csv"])
    for row in published.itertuples():
        found = next(
            r
            for r in rows
            if (r["parameter"], r["environment"], r["kind"], r["family"], r["joint"])
            == (row.parameter, row.environment, "mean", "normal", "marginal")
        )
        for limit in ("lower", "upper"):
            digits = len(getattr(row, limit).replace(".", "").lstrip("0"))
            assert float(rounded(float(found[limit]), digits)) == float(getattr(row, limit))


def test_curves_have_a_row_per_frequency(classical):
    results = as_results(classical)
    rows = rows_of(csv_tables(results)["boundaries.csv"])
    first = results.boundaries[0]
    some = rows[: first.omega.size]
    assert len(rows) == sum(boundary.omega.size for boundary in results.boundaries)
    for name in ("omega", "lower", "coupled"):
        assert [float(row[name]) for row in some] == getattr(first, name).tolist()


def test_a_record_in_a_record_has_columns_of_both_names(classical):
    results = as_results(classical)
    rows = rows_of(csv_tables(results)["verdicts.csv"])
    for row, verdict in zip(rows, results.verdicts, strict=True):
        assert float(row["classical_probability"]) == verdict.classical.probability
        assert row["coupled"] == str(verdict.coupled).lower()


def test_no_table_calls_real_what_cannot_be_rendered(classical):
    results = as_results(classical)
    cannot = {
        (row.environment, row.coupled) for row in results.rendering if row.verdict == "cannot"
    }
    outcomes = {}
    for row in rows_of(csv_tables(results)["verdicts.csv"]):
        display = row["environment"], row["coupled"] == "true"
        outcomes.setdefault(display in cannot, set()).update(
            (row["outcome"], row["classical_outcome"])
        )
    assert outcomes[True] == {"cannot be rendered"}
    assert "feels real" in outcomes[False] | {row.outcome for row in results.verdicts}
    assert "cannot be rendered" not in outcomes[False]


def test_text_that_a_spreadsheet_would_run_is_neutralised(classical):
    document = copy.deepcopy(classical)
    for row in document["intervals"]:
        row["environment"] = ' =HYPERLINK("http://x")'
        row["lower"] = "-inf"
    rows = rows_of(csv_tables(as_results(document))["intervals.csv"])
    assert {row["environment"] for row in rows} == {'\' =HYPERLINK("http://x")'}
    assert {row["lower"] for row in rows} == {"-inf"}


@pytest.mark.parametrize("name", ["intervals.csv", "band.csv", "boundaries.csv"])
def test_labels_tell_every_row_from_the_others(classical, name):
    labels = ("parameter", "environment", "kind", "method", "family", "joint", "shape", "omega")
    rows = [
        tuple(row.get(label) for label in labels)
        for row in rows_of(csv_tables(as_results(classical))[name])
    ]
    assert len(set(rows)) == len(rows) > 1
