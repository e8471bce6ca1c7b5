"""Two studies side by side: their difference, what is said with it, and whom it refuses to
divide."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import RefusalError, Scene, Study, UsageError
from percept.sessions import Sessions
from percept.study.compare import compare_studies
from percept.study.conditions import told_apart
from tests.documents import build_document


def scattered(prefix, centre, sd, count, seed):
    k = centre * np.exp(sd * np.random.default_rng(seed).standard_normal(count))
    subjects = [f"{prefix}{i}" for i in range(count)]
    table = pd.DataFrame({"subject": subjects, "environment": "VE1", "k_ref": 100.0, "k_adj": k})
    scene = Scene(inference={"method": "classical", "level": 0.9})
    return Study(table, scene), np.log(k)


def without_device(study, **inference):
    return study.scene.model_copy(update={"device": None}).with_inference(**inference)


def others(table):
    """The same values of other subjects."""
    return table.assign(subject="other " + table["subject"].astype(str))


def test_limits_of_a_difference_are_welch_s_and_those_of_a_ratio_of_spreads_fisher_s():
    """Four subjects and nine, of four times the spread."""
    first, a = scattered("A", 100.0, 0.1, 4, seed=2)
    second, b = scattered("B", 120.0, 0.4, 9, seed=3)
    row, spread = compare_studies(first, second).differences.itertuples()
    welch = stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.9)
    np.testing.assert_allclose(np.log([row.lower, row.upper]), [welch.low, welch.high], rtol=1e-9)
    fisher = b.var(ddof=1) / a.var(ddof=1) / stats.f(8, 3).ppf([0.95, 0.05])
    np.testing.assert_allclose([spread.lower, spread.upper], np.sqrt(fisher), rtol=1e-9)


def test_blank_levels_are_named_with_their_row():
    study, _ = scattered("A", 15.0, 0.1, 5, seed=0)
    table = study.sessions.table.assign(hand=["L", "R", "L", "", "R"])
    by_hand = Scene(study={"factor": "hand"})
    whole = Sessions.from_frame(table, scene=Scene(sessions={"groups": ["hand"]}))
    with pytest.raises(UsageError, match=r"<frame>:5, column 'hand': 1 row without a value"):
        told_apart(whole, by_hand)
    # Of a part of the table the labels are those of the whole.
    some = dataclasses.replace(whole, table=whole.table.iloc[2:])
    with pytest.raises(UsageError, match=r"<frame>:5, column 'hand'"):
        told_apart(some, by_hand)


def test_a_study_against_a_shifted_copy_of_itself(fitted):
    table = others(fitted.sessions.table.query("environment in ('VE1', 'VE4')"))
    table["k_adj"] *= 1.25
    other = Study(table, without_device(fitted, tolerance=0.2))
    found = compare_studies(fitted, other).differences
    k = found.query("parameter == 'k' and method == 'classical'").set_index("of")["estimate"]
    np.testing.assert_allclose(k["bias"], 1.25, rtol=1e-9)
    np.testing.assert_allclose(k["spread"], 1.0, rtol=1e-6)
    b = found.query("parameter == 'b' and method == 'bayesian' and of == 'bias'")
    assert ((b["lower"] < 1.0) & (b["upper"] > 1.0)).all()
    assert b["probability_above"].between(0.2, 0.8).all()
    bayes = found.query("parameter == 'k' and method == 'bayesian'")
    stiff = bayes.query("environment == 'VE4' and of == 'bias'")
    assert stiff["probability_above"].item() > 0.999
    spread = bayes.query("of == 'spread'")
    assert ((spread["lower"] < 1.0) & (spread["upper"] > 1.0)).all()


def test_what_only_one_study_has_is_named(fitted):
    table = fitted.sessions.table
    some = table[table["environment"].isin(["VE3", "VE5"])].drop(columns=["b_ref", "b_adj"])
    scene = without_device(fitted, method="classical")
    studies = [Study(own, scene) for own in (fitted.sessions, others(some))]
    for name, pair in (("A", studies), ("B", studies[::-1])):
        assert compare_studies(*pair).notes == (
            f"Only {name} has VE1, VE2, VE4: left out.",
            f"Only {name} has b: left out.",
        )


def test_an_environment_without_a_difference_is_named(fitted):
    scene = without_device(fitted, method="classical")
    table = fitted.sessions.table.drop(columns=["b_ref", "b_adj"])
    other = others(table)
    # One value of VE3 has no logarithm.
    other.loc[other.index[other["environment"] == "VE3"][0], "k_adj"] = -463.0
    studies = [Study(own, scene) for own in (table, other)]
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


def test_studies_that_cannot_be_compared(fitted):
    other = Study(fitted.sessions, fitted.scene.with_inference(level=0.9))
    with pytest.raises(UsageError, match=r"level of 0\.99 and 0\.9"):
        compare_studies(fitted, other)
    table = fitted.sessions.table.assign(environment="elsewhere")
    apart = Study(dataclasses.replace(fitted.sessions, table=table), fitted.scene)
    with pytest.raises(RefusalError, match="no environment in common"):
        compare_studies(fitted, apart)
