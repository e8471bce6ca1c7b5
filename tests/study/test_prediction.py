"""Environments nobody tested, against dense conditioning."""

import numpy as np
import pandas as pd
import pytest

from percept import RefusalError, Scene, Study, UsageError, read_sessions
from percept.study.prediction import predict
from tests import DATASETS
from tests.fits import SHARED


@pytest.fixture(scope="module")
def loose(fitted):
    """The published study with few frequencies, and the posterior of tests/commands."""
    tables = fitted.scene.to_dict() | {"frequency": {"lower": 0.1, "upper": 100.0, "points": 9}}
    return Study(fitted.sessions, Scene(**tables).with_inference(tolerance=0.1), store=SHARED)


def test_wider_than_at_a_tested_environment_and_flagged_outside(loose):
    inside = predict(loose, stiffness=10_000, damping=10)
    rows = "environment == 'VE3' and method == 'bayesian' and kind == 'mean'"
    tested = loose.intervals.query(rows).set_index("parameter")
    new = inside.intervals.query("kind == 'mean'").set_index("parameter")
    assert (new["lower"] < tested["lower"]).all()
    assert (new["upper"] > tested["upper"]).all()
    assert not inside.extrapolates
    far = predict(loose, stiffness=5e5, damping=0.01)
    assert far.beyond == pytest.approx({"k": 1.0, "b": -1.0})
    assert "1 decades above the tested range" in far.sentence
    means = [prediction.intervals.query("kind == 'mean'") for prediction in (inside, far)]
    widths = [np.log(rows["upper"] / rows["lower"]) for rows in means]
    assert (widths[1] > widths[0]).all()


def test_an_environment_the_fit_does_not_know_has_no_say():
    """Damping was never adjusted in VE3: it is neither fitted nor in the tested range."""
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    table = table[table["environment"].isin(["VE1", "VE2", "VE3"])].copy()
    without = table[table["environment"] != "VE3"]
    table.loc[table["environment"] == "VE3", "b_adj"] = np.nan
    scene = Scene(inference={"method": "bayesian", "tolerance": 0.2, "kinds": ["mean"]})
    found, wanted = (
        predict(Study(part, scene, store=SHARED), stiffness=9e3, damping=9.0)
        for part in (table, without)
    )
    assert wanted.beyond["k"] > 0.9
    assert found.beyond == wanted.beyond
    pd.testing.assert_frame_equal(found.intervals, wanted.intervals)


def test_boundaries_hold_draws_of_their_kind(loose):
    found = predict(loose, stiffness=15_000, damping=12)
    shapes = {(b.kind, b.joint, b.shape) for b in found.boundaries}
    assert {("user", "marginal", "envelope"), ("user", "hotelling", "envelope")} <= shapes
    assert ("mean", "joint", "pointwise") in shapes
    known = {(b.kind, b.shape): b for b in found.boundaries if b.joint in ("joint", "marginal")}
    # At low omega abs(Z_h) is k/omega: the pointwise band is the interval of k, within Monte Carlo
    # error.
    row = found.intervals.query("kind == 'mean' and parameter == 'k'").iloc[0]
    point = known["mean", "pointwise"]
    half = 0.5 * np.log(row["upper"] / row["lower"])
    ends = np.array([point.lower[0], point.upper[0]]) * point.omega[0]
    assert np.abs(np.log(ends / [row["lower"], row["upper"]])).max() < 0.15 * half


@pytest.fixture(scope="module")
def published():
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=0.2)
    return Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene, store=SHARED)


def test_published_limits_have_no_predicted_curve_that_needs_a_correlation(
    published,
):
    found = predict(published, stiffness=15_000, damping=12)
    assert {(b.joint, b.shape) for b in found.boundaries} == {
        ("marginal", "corner"),
        ("marginal", "envelope"),
    }
    assert set(found.intervals["kind"]) == {"mean", "user", "share"}
    assert found.intervals["covers"].str.contains("moment matching").all()


@pytest.mark.parametrize(
    ("changes", "at", "error", "message"),
    [
        ({}, {"k": 100.0}, UsageError, "damping of the new environment must be a positive number"),
        (
            {},
            {"k": -100.0, "b": 1.0},
            UsageError,
            "stiffness of the new environment must be a positive number",
        ),
        (
            {"parameters": ("k",)},
            {"k": 100.0, "b": 1.0},
            UsageError,
            r"b = 1\.0: the study does not analyse damping\. Leave it out",
        ),
        (
            {"method": "classical"},
            {"k": 100.0, "b": 1.0},
            RefusalError,
            "classical method has no model",
        ),
    ],
)
def test_what_cannot_be_predicted_is_refused(fitted, changes, at, error, message):
    study = Study(fitted.sessions, fitted.scene.with_inference(**changes), store=SHARED)
    with pytest.raises(error, match=message):
        predict(study, at=at)


def test_environments_that_tell_nothing_of_others_predict_none(fitted):
    scene = fitted.scene.with_inference(tolerance=0.2, parameters=("k",))
    model = {"pooling": "none", "prior": "reference"}
    apart = Study(fitted.sessions, scene.with_tables(model=model))
    with pytest.raises(RefusalError, match="without pooling, an environment tells nothing about"):
        predict(apart, stiffness=100.0)
    one = Study(fitted.sessions.table.query("environment == 'VE3'"), scene)
    with pytest.raises(RefusalError, match="one environment shows no trend to predict others from"):
        predict(one, stiffness=100.0)
