"""Two studies side by side: their difference, what is said with it, and whom it refuses to
divide."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import RefusalError, Scene, Study, UsageError
from percept.sessions import ReadOptions, Sessions
from percept.study.compare import compare_studies
from percept.study.conditions import by_level
from tests.documents import build_document


def sessions(prefix, *, trials=1, seed=0):
    rng = np.random.default_rng(seed)
    rows = [
        [f"{prefix}{s}", "VE1", 15.0, t, 15.0 * np.exp(0.1 * rng.standard_normal())]
        for s in range(5)
        for t in range(trials)
    ]
    return Sessions.from_frame(
        pd.DataFrame(rows, columns=["subject", "environment", "k_ref", "trial", "k_adj"])
    )


def study(which, **inference):
    return Study(which, Scene(inference={"method": "classical", **inference}))


def scattered(prefix, centre, sd, count, seed):
    k = centre * np.exp(sd * np.random.default_rng(seed).standard_normal(count))
    subjects = [f"{prefix}{i}" for i in range(count)]
    table = pd.DataFrame({"subject": subjects, "environment": "VE1", "k_ref": 100.0, "k_adj": k})
    return study(Sessions.from_frame(table), level=0.9), np.log(k)


def test_limits_of_a_difference_are_welch_s_and_those_of_a_ratio_of_spreads_fisher_s():
    """Four subjects and nine, of four times the spread."""
    first, a = scattered("A", 100.0, 0.1, 4, seed=2)
    second, b = scattered("B", 120.0, 0.4, 9, seed=3)
    (row,) = compare_studies(first, second).differences.query("parameter == 'k'").itertuples()
    welch = stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.9)
    np.testing.assert_allclose(np.log([row.lower, row.upper]), [welch.low, welch.high], rtol=1e-9)
    fisher = b.var(ddof=1) / a.var(ddof=1) / stats.f(8, 3).ppf([0.95, 0.05])
    np.testing.assert_allclose([row.spread_lower, row.spread_upper], np.sqrt(fisher), rtol=1e-9)


def test_blank_levels_are_named_with_their_row():
    frame = sessions("A").table.assign(hand=["L", "R", "L", "", "R"])
    options = ReadOptions.from_mapping({"sessions": {"groups": ["hand"]}})
    whole = Sessions.from_frame(frame, scene=options)
    with pytest.raises(UsageError, match=r"<frame>:5, column 'hand': 1 row without a value"):
        by_level(whole, ["hand"])
    # Of a part of the table the labels are those of the whole.
    some = dataclasses.replace(whole, table=whole.table.iloc[2:])
    with pytest.raises(UsageError, match=r"<frame>:5, column 'hand'"):
        by_level(some, ["hand"])


def test_a_study_against_a_shifted_copy_of_itself(fitted: Study) -> None:
    table = fitted.sessions.table.copy()
    table["k_adj"] *= 1.25
    table["subject"] = "other " + table["subject"].astype(str)
    scene = fitted.scene.model_copy(update={"device": None}).with_inference(tolerance=0.2)
    other = Study(dataclasses.replace(fitted.sessions, table=table), scene)
    found = compare_studies(fitted, other).differences
    k = found[(found["parameter"] == "k") & (found["method"] == "classical")]
    np.testing.assert_allclose(k["value"], 1.25, rtol=1e-9)
    np.testing.assert_allclose(k["spread_value"], 1.0, rtol=1e-6)
    b = found[(found["parameter"] == "b") & (found["method"] == "bayesian")]
    assert (b["lower"] < 1.0).all()
    assert (b["upper"] > 1.0).all()
    assert b["probability_above"].between(0.2, 0.8).all()
    bayes = found[(found["parameter"] == "k") & (found["method"] == "bayesian")].set_index(
        "environment"
    )
    assert bayes.loc["VE4", "probability_above"] > 0.999
    assert (bayes["spread_lower"] < 1.0).all()
    assert (bayes["spread_upper"] > 1.0).all()


def test_what_only_one_study_has_is_named(fitted: Study) -> None:
    table = fitted.sessions.table
    some = table[table["environment"].isin(["VE3", "VE5"])].drop(columns=["b_ref", "b_adj"])
    sessions = Sessions.from_frame(some.assign(subject="other " + some["subject"].astype(str)))
    classical = fitted.scene.model_copy(update={"device": None}).with_inference(method="classical")
    found = compare_studies(Study(fitted.sessions, classical), Study(sessions, classical))
    assert found.notes == ("Only A has VE1, VE2, VE4: left out.", "Only A has b: left out.")
    assert compare_studies(Study(sessions, classical), Study(fitted.sessions, classical)).notes == (
        "Only B has VE1, VE2, VE4: left out.",
        "Only B has b: left out.",
    )


def test_an_environment_without_a_difference_is_named(fitted: Study) -> None:
    scene = fitted.scene.model_copy(update={"device": None}).with_inference(method="classical")
    table = fitted.sessions.table.drop(columns=["b_ref", "b_adj"])
    other = table.assign(subject="other " + table["subject"].astype(str))
    # One value of VE3 has no logarithm.
    other.loc[other.index[other["environment"] == "VE3"][0], "k_adj"] = -463.0
    studies = [Study(Sessions.from_frame(own), scene) for own in (table, other)]
    found = compare_studies(*studies)
    assert found.notes[-1] == (
        "No classical difference of k in VE3: in A or B it has no interval of the lognormal family."
    )
    assert "VE3" not in set(found.differences["environment"])
    cautions = build_document(studies[1])["summary"]["cautions"]
    assert cautions[0] == (
        "Intervals of stiffness are of the normal family in VE3, where values of zero or below have"
        " no logarithm, and of the lognormal family in VE1, VE2, VE4 and VE5."
    )


def test_studies_that_cannot_be_compared(fitted: Study) -> None:
    other = Study(fitted.sessions, fitted.scene.with_inference(level=0.9))
    with pytest.raises(UsageError, match=r"level of 0\.99 and 0\.9"):
        compare_studies(fitted, other)
    table = fitted.sessions.table.assign(environment="elsewhere")
    apart = Study(dataclasses.replace(fitted.sessions, table=table), fitted.scene)
    with pytest.raises(RefusalError, match="no environment in common"):
        compare_studies(fitted, apart)
