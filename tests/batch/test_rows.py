import io

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from percept import Scene, Study, read_sessions
from percept.batch import SCHEMA, StudySource, analyse, encode
from tests.batch.conftest import study_text


def read(data):
    return pq.read_table(io.BytesIO(data))


def job(path, **changes):
    return StudySource(str(path), Scene(), {"tolerance": 0.3, **changes}).read()


def test_rows_are_the_study_s_own_intervals_in_every_digit(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(study_text(1))
    outcome = analyse(job(path))
    assert outcome.status == "done"
    study = Study(read_sessions(path), Scene().with_inference(tolerance=0.3))
    table = read(outcome.table)
    assert table.schema.equals(SCHEMA)
    found = table.to_pandas()
    for column in ("lower", "upper", "estimate", "reference", "level", "n"):
        np.testing.assert_array_equal(found[column], study.intervals[column])
    for column in ("environment", "parameter", "kind", "method", "family", "joint", "unit"):
        assert list(found[column]) == list(study.intervals[column])
    assert set(found["steps"]) == {study.fit.run.steps}
    assert set(found["rhat"]) == {study.fit.run.gate.rhat}
    assert set(found["subjects"]) == {3}
    assert set(found["study"]) == {str(path)}
    assert found["share"].isna().sum() == (found["kind"] != "share").sum()


def test_equal_studies_give_equal_bytes(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(study_text(1))
    assert analyse(job(path)).table == analyse(job(path)).table


def test_a_study_that_misses_its_tolerance_is_done_and_says_its_error(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(study_text(1))
    scene = Scene(inference={"tolerance": 1e-4, "most_steps": 200})
    found = read(analyse(StudySource(str(path), scene, {}).read()).table).to_pandas()
    assert set(found["status"]) == {"done"}
    assert set(found["method"]) == {"classical", "bayesian"}
    assert f"{100 * found['worst_error'][0]:.3g} % of a half-width" in found["message"][0]


def test_infinite_limits_survive_and_missing_numbers_are_null():
    frame = pd.DataFrame({"lower": [-np.inf, 1.0], "share": [np.nan, 0.9]})
    rows = read(encode("a", "key", "done", None, frame).table).to_pylist()
    assert [row["lower"] for row in rows] == [-np.inf, 1.0]
    assert [row["share"] for row in rows] == [None, 0.9]
    assert [row["study"] for row in rows] == ["a", "a"]
