from __future__ import annotations

import copy
import csv
import io

import pandas as pd
import pytest

from percept.report.numbers import rounded
from percept.report.tables import csv_tables
from tests.documents import as_results

from .conftest import DATASETS


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


@pytest.mark.parametrize(("parameter", "unit"), [("k", "N/m"), ("b", "N·s/m")])
def test_limits_read_back_to_the_same_doubles(classical, parameter, unit):
    rows = rows_of(csv_tables(as_results(classical))[f"intervals_{parameter}.csv"])
    expected = [row for row in classical["intervals"] if row["parameter"] == parameter]
    assert [float(row[f"lower ({unit})"]) for row in rows] == [row["lower"] for row in expected]
    assert [float(row[f"upper ({unit})"]) for row in rows] == [row["upper"] for row in expected]
    assert [row["environment"] for row in rows] == [row["environment"] for row in expected]


def test_the_paper_s_table_comes_out_to_the_digit(classical):
    published = pd.read_csv(DATASETS / "hbfd_table1.csv", dtype=str)
    tables = {
        p: rows_of(csv_tables(as_results(classical))[f"intervals_{p}.csv"]) for p in ("k", "b")
    }
    for row in published.itertuples():
        unit = {"k": "N/m", "b": "N·s/m"}[row.parameter]
        found = next(
            r
            for r in tables[row.parameter]
            if (r["environment"], r["kind"], r["family"], r["joint"])
            == (row.environment, "mean", "normal", "marginal")
        )
        for limit in ("lower", "upper"):
            digits = len(getattr(row, limit).replace(".", "").lstrip("0"))
            assert float(rounded(float(found[f"{limit} ({unit})"]), digits)) == float(
                getattr(row, limit)
            )


def test_curves_have_a_row_per_frequency(classical):
    results = as_results(classical)
    rows = rows_of(csv_tables(results)["boundaries.csv"])
    first = results.boundaries[0]
    some = rows[: first.omega.size]
    assert len(rows) == sum(boundary.omega.size for boundary in results.boundaries)
    for head, name in (
        ("omega (rad/s)", "omega"),
        ("lower (N·s/m)", "lower"),
        ("coupled (N·s/m)", "coupled"),
    ):
        assert [float(row[head]) for row in some] == getattr(first, name).tolist()


@pytest.mark.parametrize("start", ["", " ", "\t", "\u00a0 ", "\n"])
@pytest.mark.parametrize("sign", ["=", "+", "-", "@", "＝"])
def test_text_that_a_spreadsheet_would_run_is_neutralised(classical, start, sign):
    document = copy.deepcopy(classical)
    for row in document["intervals"]:
        row["environment"] = f'{start}{sign}HYPERLINK("http://x")'
        row["lower"] = "-inf"
    rows = rows_of(csv_tables(as_results(document))["intervals_k.csv"])
    assert {row["environment"] for row in rows} == {f'\'{start}{sign}HYPERLINK("http://x")'}
    assert {row["lower (N/m)"] for row in rows} == {"-inf"}


@pytest.mark.parametrize(("parameter", "unit"), [("k", "N/m"), ("b", "N·s/m")])
def test_adjustments_are_in_the_units_of_their_heads(classical, parameter, unit):
    rows = rows_of(csv_tables(as_results(classical))[f"data_{parameter}.csv"])
    cells = [cell for cell in classical["data"]["cells"] if cell["parameter"] == parameter]
    for name in ("reference", "mean", "sd"):
        assert [float(row[f"{name} ({unit})"]) for row in rows] == [cell[name] for cell in cells]


@pytest.mark.parametrize(
    "name", ["intervals_k.csv", "intervals_b.csv", "band.csv", "boundaries.csv"]
)
def test_labels_tell_every_row_from_the_others(classical, name):
    labels = ("environment", "kind", "method", "family", "joint", "shape", "level", "omega (rad/s)")
    rows = [
        tuple(row.get(label) for label in labels)
        for row in rows_of(csv_tables(as_results(classical))[name])
    ]
    assert len(set(rows)) == len(rows) > 1
