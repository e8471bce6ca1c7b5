import io

import numpy as np
import pandas as pd

from percept import Scene, Study, read_sessions
from percept.batch import COLUMNS, StudySource, analyse
from tests.batch.conftest import study_text


def read(outcome):
    """Rows of an outcome, every number as the same double."""
    rows = pd.read_csv(io.StringIO(outcome.rows), dtype=str, names=list(COLUMNS))
    texts = ("study", "key", "status", "message", "environment", "parameter", "kind", "method")
    numbers = rows.columns.drop([*texts, "family", "joint", "unit"])
    return rows.astype(dict.fromkeys(numbers, float))


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
