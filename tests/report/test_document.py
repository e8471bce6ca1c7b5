from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from percept import Scene, Study, read_sessions
from percept.results import dumps
from tests.documents import build_document
from tests.study.checked import study_of, table_of

from .conftest import DATASETS


def test_files_go_by_name_and_folders_stay_out(classical):
    assert [file["name"] for file in classical["provenance"]["files"]] == ["hbfd_sessions.csv"]
    assert str(DATASETS) not in dumps(classical)


def test_cells_are_the_adjustments(classical):
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    for cell in classical["data"]["cells"]:
        values = table.loc[table["environment"] == cell["environment"], f"{cell['parameter']}_adj"]
        assert cell["values"] == values.tolist()
        assert cell["mean"] == pytest.approx(values.mean(), rel=1e-15)
        assert cell["sd"] == pytest.approx(values.std(ddof=1), rel=1e-14)


def test_a_summary_and_a_scene_without_device_are_documents_too():
    study = Study(
        read_sessions(DATASETS / "hbfd_table1.csv"), Scene(inference={"method": "classical"})
    )
    document = build_document(study)
    assert document["data"]["form"] == "summary"
    assert document["data"]["cells"] == []
    assert [document[name] for name in ("boundaries", "coupling", "sensitivity", "design")] == [
        [],
        *[None] * 3,
    ]
    assert any("device" in entry["why"] for entry in document["skipped"])
    normal = [
        row for row in document["intervals"] if row["family"] == "normal" and row["kind"] == "mean"
    ]
    assert np.isfinite([row["lower"] for row in normal]).all()


def test_checks_of_normality_are_scipy_s_and_speak_where_they_reject():
    table = table_of(("k",), subjects=12, references=[[100.0, 1e3, 1e4]], seed=3)
    first = table["environment"].iloc[0]
    table.loc[(table["subject"] == "S01") & (table["environment"] == first), "k_adj"] *= 1e3
    study = study_of(table, checks={}, method="classical")
    document = build_document(study, curves=False)
    rows = document["checks"]["normality"]
    assert len(rows) == 2 * 3
    for row in rows:
        values = table[table["environment"] == row["environment"]]["k_adj"].to_numpy()
        wanted = stats.shapiro(np.log(values) if row["family"] == "lognormal" else values)
        assert (row["statistic"], row["p_value"]) == pytest.approx(
            (wanted.statistic, wanted.pvalue), rel=1e-9
        )
    assert document["checks"]["loo"] is None
    # The page's intervals are of one family: only its misfit is a caution.
    for family in ("lognormal", "normal"):
        study = study_of(table, checks={}, method="classical", family=family)
        cautions = build_document(study, curves=False)["summary"]["cautions"]
        assert [text for text in cautions if "Shapiro" in text] == [
            f"Shapiro–Wilk tests reject the {family} family, which classical intervals assume,"
            f" for k in {first}."
        ]
