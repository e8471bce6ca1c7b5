"""Environments nobody tested, against dense conditioning."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

from percept import RefusalError, Scene, Study, UsageError, read_sessions
from percept.sessions import Sessions
from percept.study.prediction import predict
from tests import DATASETS
from tests.fits import SHARED


@pytest.fixture(scope="module")
def loose(fitted: Study) -> Study:
    """The published study with few frequencies, and a tolerance that is met anywhere."""
    tables = fitted.scene.to_dict() | {"frequency": {"lower": 0.1, "upper": 100.0, "points": 9}}
    return Study(fitted.sessions, Scene(**tables).with_inference(tolerance=0.3), store=SHARED)


def test_wider_than_at_a_tested_environment_and_flagged_outside(loose: Study) -> None:
    inside = predict(loose, stiffness=10_000, damping=10)
    known = loose.intervals
    known = known[
        (known["environment"] == "VE3")
        & (known["method"] == "bayesian")
        & (known["kind"] == "mean")
    ]
    for row in inside.intervals.query("kind == 'mean'").itertuples():
        tested = known[known["parameter"] == row.parameter].iloc[0]
        assert row.lower < tested["lower"]
        assert row.upper > tested["upper"]
    assert not inside.extrapolates
    far = predict(loose, stiffness=5e5, damping=0.01)
    assert far.beyond == pytest.approx({"k": 1.0, "b": -1.0})
    assert "1 decades above the tested range" in far.sentence
    means = [prediction.intervals.query("kind == 'mean'") for prediction in (inside, far)]
    widths = [np.log(rows["upper"] / rows["lower"]) for rows in means]
    assert (widths[1] > widths[0]).all()


def test_an_environment_the_fit_does_not_know_has_no_say() -> None:
    """Damping was never adjusted in VE3: it is neither fitted nor in the tested range."""
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    table = table[table["environment"].isin(["VE1", "VE2", "VE3"])].copy()
    without = table[table["environment"] != "VE3"]
    table.loc[table["environment"] == "VE3", "b_adj"] = np.nan
    scene = Scene(inference={"method": "bayesian", "tolerance": 0.2})
    found, wanted = (
        predict(Study(Sessions.from_frame(part), scene, store=SHARED), stiffness=9e3, damping=9.0)
        for part in (table, without)
    )
    assert wanted.beyond["k"] > 0.9
    assert found.beyond == wanted.beyond
    pd.testing.assert_frame_equal(found.intervals, wanted.intervals)


def test_boundaries_hold_draws_of_their_kind(loose: Study) -> None:
    found = predict(loose, stiffness=15_000, damping=12)
    shapes = {(b.kind, b.joint, b.shape) for b in found.boundaries}
    assert {("user", "marginal", "envelope"), ("user", "hotelling", "envelope")} <= shapes
    assert ("mean", "joint", "pointwise") in shapes
    known = {(b.kind, b.shape): b for b in found.boundaries if b.joint in ("joint", "marginal")}
    # At low omega abs(Z_h) is k/omega: the pointwise band is the interval of k, within Monte Carlo
    # error.
    row = found.intervals[
        (found.intervals["kind"] == "mean") & (found.intervals["parameter"] == "k")
    ].iloc[0]
    point = known["mean", "pointwise"]
    half = 0.5 * np.log(row["upper"] / row["lower"])
    ends = np.array([point.lower[0], point.upper[0]]) * point.omega[0]
    assert np.abs(np.log(ends / [row["lower"], row["upper"]])).max() < 0.15 * half


@pytest.fixture(scope="module")
def published() -> Study:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=0.2)
    return Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene, store=SHARED)


def test_published_limits_have_no_predicted_curve_that_needs_a_correlation(
    published: Study,
) -> None:
    found = predict(published, stiffness=15_000, damping=12)
    assert {(b.joint, b.shape) for b in found.boundaries} == {
        ("marginal", "corner"),
        ("marginal", "envelope"),
    }
    assert set(found.intervals["kind"]) == {"mean", "user", "share"}
    assert found.intervals["covers"].str.contains("moment matching").all()


def test_refused(fitted: Study) -> None:
    with pytest.raises(UsageError, match="damping of the new environment is missing"):
        predict(fitted, stiffness=100.0)
    with pytest.raises(
        UsageError, match="stiffness of the new environment must be a positive number"
    ):
        predict(fitted, stiffness=-100.0, damping=1.0)
    one_parameter = Study(fitted.sessions, fitted.scene.with_inference(parameters=("k",)))
    with pytest.raises(
        UsageError, match=r"b = 1\.0: the study does not analyse damping\. Leave it out"
    ):
        predict(one_parameter, stiffness=100.0, damping=1.0)
    classical = Study(fitted.sessions, fitted.scene.with_inference(method="classical"))
    with pytest.raises(RefusalError, match="classical method has no model"):
        predict(classical, stiffness=100.0, damping=1.0)
    alone = fitted.scene.to_dict()
    alone["model"] |= {"pooling": "none", "prior": "reference"}
    alone["inference"] |= {"tolerance": 0.2, "parameters": ["k"]}
    with pytest.raises(
        RefusalError, match="without pooling, an environment tells nothing about others"
    ):
        predict(Study(fitted.sessions, Scene(**alone)), stiffness=100.0)
    table = fitted.sessions.table
    stiffness_alone = fitted.scene.with_inference(tolerance=0.2, parameters=("k",))
    one = dataclasses.replace(fitted.sessions, table=table[table["environment"] == "VE3"])
    with pytest.raises(RefusalError, match="one environment shows no trend to predict others from"):
        predict(Study(one, stiffness_alone), stiffness=100.0)
