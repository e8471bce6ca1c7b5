import numpy as np
import pytest

from percept import Scene, Study, read_sessions
from percept.errors import UsageError
from tests import DATASETS

SESSIONS = DATASETS / "hbfd_sessions.csv"


def classical(sessions=None, **inference):
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical", **inference)
    return Study(sessions or read_sessions(SESSIONS), scene)


def test_showing_a_study_computes_nothing():
    study = classical()
    before = dict(vars(study))
    page = study._repr_html_()
    assert vars(study) == before
    assert "<td>stiffness k, damping b</td>" in page


@pytest.mark.parametrize("kind", ["user", None])
def test_the_summary_lays_methods_side_by_side(fitted, kind):
    table, intervals = fitted.summary(kind), fitted.intervals
    kinds = [kind] if kind else list(fitted.scene.inference.kinds)
    assert len(table) == len(fitted.data.environments) * 2 * len(kinds)
    assert set(table["kind"]) == set(kinds)
    for row in table.to_dict("records"):
        for method in ("classical", "bayesian"):
            wanted = {"method": method, "family": "lognormal", "joint": "marginal"}
            wanted |= {name: row[name] for name in ("environment", "parameter", "kind", "unit")}
            (one,) = intervals[
                np.all([intervals[k] == v for k, v in wanted.items()], axis=0)
            ].to_dict("records")
            assert [row[f"{method}_{name}"] for name in ("estimate", "lower", "upper")] == [
                one[name] for name in ("estimate", "lower", "upper")
            ]
            assert row["reference"] == one["reference"]


def test_a_kind_that_was_not_asked_for_is_named():
    with pytest.raises(
        UsageError, match="'share': the study has no such kind; there are mean, user"
    ):
        classical(kinds=("mean", "user")).summary("share")


def test_curves_are_the_boundaries_row_by_row():
    study = classical(kinds=("user",))
    table, start = study.curves, 0
    for boundary in study.boundaries:
        part = table.iloc[start : start + boundary.omega.size]
        start += boundary.omega.size
        for name in ("omega", "lower", "upper", "reference", "coupled"):
            np.testing.assert_array_equal(part[name], getattr(boundary, name))
        for name in ("environment", "kind", "method", "family", "joint", "shape", "level"):
            assert set(part[name]) == {getattr(boundary, name)}
    assert start == len(table) > 0
