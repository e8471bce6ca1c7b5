import io
import json

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions
from percept.batch import COLUMNS, StudySource, analyse, encode, run_batch, sources
from tests.batch.conftest import study_text


def read(outcome):
    """Rows, with every number as Python reads it, whatever pandas' version."""
    rows = pd.read_csv(io.StringIO(outcome.rows), dtype=str, names=list(COLUMNS))
    return rows.astype({name: float for name, kind in COLUMNS.items() if kind != "text"})


def job(path, **changes):
    return StudySource(str(path), Scene(), {"tolerance": 0.3, **changes}).read()


def test_rows_are_the_study_s_own_intervals_in_every_digit(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(study_text(1))
    outcome = analyse(job(path))
    assert outcome.status == "done"
    study = Study(read_sessions(path), Scene().with_inference(tolerance=0.3))
    found = read(outcome)
    assert list(found.columns) == list(COLUMNS)
    for column in ("lower", "upper", "estimate", "reference", "level", "n"):
        np.testing.assert_array_equal(found[column], study.intervals[column])
    for column in ("environment", "parameter", "kind", "method", "family", "joint", "unit"):
        assert list(found[column]) == list(study.intervals[column])
    assert set(found["steps"]) == {study.fit.run.steps}
    assert set(found["rhat"]) == {study.fit.run.gate.rhat}
    assert set(found["subjects"]) == {3}
    assert set(found["study"]) == {str(path)}
    assert found["share"].isna().sum() == (found["kind"] != "share").sum()
    assert analyse(job(path)) == outcome


def test_a_study_that_misses_its_tolerance_is_done_and_says_its_error(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(study_text(1))
    scene = Scene(inference={"tolerance": 1e-4, "most_steps": 200})
    found = read(analyse(StudySource(str(path), scene, {}).read()))
    assert set(found["status"]) == {"done"}
    assert set(found["method"]) == {"classical", "bayesian"}
    assert f"{100 * found['worst_error'][0]:.3g} % of a half-width" in found["message"][0]


def test_a_parquet_table_has_the_same_numbers_nulls_and_names(tmp_path):
    pq = pytest.importorskip("pyarrow.parquet", reason="needs the extra percept-haptics[tables]")
    frame = pd.DataFrame(
        {
            "lower": [-np.inf, 0.1 + 0.2, 5e-324],
            "share": [np.nan, 0.9, 1 / 3],
            "environment": ["NA", 'a "b", c', "ü\nnull"],
            "n": [3, 4, 5],
        }
    )
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path in paths:
        path.write_text(study_text(1))

    def given(function, jobs):
        outcomes = encode("a", "k", "done", "", frame), encode("007", "l", "refused", "why")
        yield from zip(jobs, outcomes, strict=True)

    studies = sources(map(str, paths))
    summary = run_batch(studies, tmp_path / "out", given, table_format="parquet")
    rows = pq.read_table(summary.table).to_pylist()
    assert [row["lower"] for row in rows] == [-np.inf, 0.1 + 0.2, 5e-324, None]
    assert [row["share"] for row in rows] == [None, 0.9, 1 / 3, None]
    assert [row["environment"] for row in rows] == [*frame["environment"], None]
    assert [row["n"] for row in rows] == [3, 4, 5, None]
    assert [row["study"] for row in rows] == ["a", "a", "a", "007"]
    assert [row["message"] for row in rows] == [None, None, None, "why"]
    assert [list(row) for row in rows] == [list(COLUMNS)] * 4
    assert json.dumps(rows[0]["subjects"]) == "null"
