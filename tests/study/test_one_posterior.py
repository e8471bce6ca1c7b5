"""One posterior of a study with factors: its cells, contrasts, families and options."""

import itertools

import numpy as np
import pytest

from percept import UsageError
from percept.study.prediction import predict
from percept.study.prepare import prepare
from tests.fits import SHARED
from tests.study.within import crossed, frame, study

ASKED = {"method": "bayesian", "tolerance": 0.3, "level": 0.9}


@pytest.fixture(scope="module")
def parts():
    """Three levels, one trial each."""
    table = frame(trials=1, levels=("left", "right", "both"), subjects=5)
    return study(table, inference=ASKED, store=SHARED)


@pytest.mark.evidence
def test_contrasts_are_those_of_the_cells(parts):
    estimates = parts.intervals.query("kind == 'mean'").set_index("environment")["estimate"]
    contrasts = parts.contrasts.query("kind == 'mean' and of == 'bias'")
    for row in contrasts.dropna(subset="environment").itertuples():
        cells = [f"{row.environment} ({level})" for level in (row.second, row.first)]
        second, first = estimates[cells]
        assert row.estimate == pytest.approx(second / first, rel=1e-9)


def test_limits_that_hold_together_contain_the_single_ones(parts):
    """By less than Bonferroni's: the contrasts of a factor share cells."""
    rows = parts.contrasts
    family = rows[rows["of"].eq("bias") & rows["kind"].isin(["mean", "user"])]
    assert (family["lower_together"] < family["lower"]).all()
    assert (family["upper_together"] > family["upper"]).all()
    rest = rows.drop(family.index)
    assert rest["lower_together"].isna().all()
    # Twelve contrasts: three pairs of levels at three references and overall.
    wider = np.log(family["upper_together"] / family["lower_together"])
    ratio = wider / np.log(family["upper"] / family["lower"])
    assert ratio.max() < 1.8
    assert family.groupby(["parameter", "kind"]).size().eq(12).all()


def test_an_environment_nobody_tested_is_predicted_in_each_condition(parts):
    """At a tested reference the next user is told less than there, and about the same."""
    prediction = predict(parts, stiffness=100.0)
    users = prediction.intervals.query("kind == 'user'").set_index("environment")
    tested = parts.intervals.query("kind == 'user'").set_index("environment")
    assert list(users.index) == ["new (left)", "new (right)", "new (both)"]
    for level in ("left", "right", "both"):
        new = users.loc[f"new ({level})"]
        own = tested.loc[f"VE2 ({level})"]
        assert np.log(new["upper"] / new["lower"]) > np.log(own["upper"] / own["lower"])
        assert own["lower"] < new["estimate"] < own["upper"]
    assert users["monte_carlo"].max() < ASKED["tolerance"]


@pytest.mark.parametrize(
    ("option", "why"),
    [
        ({"common_spread": True}, "the spread of each cell is estimated"),
        ({"subject_effect": False}, "comparisons within subjects rest on it"),
    ],
)
def test_simpler_models_without_factors_are_refused_by_name(option, why):
    (key,) = option
    made = study(frame(trials=1, subjects=3), bias="hand", model=option, inference=ASKED)
    with pytest.raises(UsageError, match=rf"{key}.*{why}"):
        prepare(made.data)


def test_three_factors_have_an_interaction_of_their_own():
    """The difference of the differences of differences of cells."""
    table = crossed(subjects=4)
    block = np.where(table["trial"] == 1, "early", "late")
    made = study(table.assign(block=block), bias="hand * load * block", inference=ASKED)
    found = prepare(made.data)
    of_term = [own for own in found.contrasts if own.factor == "hand:load:block"]
    assert [own.environment for own in of_term] == ["VE1", "VE2", "VE3", None]
    second = of_term[1]
    assert (second.first, second.second) == (
        "left, low, early",
        "right, high, late",
    )
    weights = dict(zip(found.model.cells, second.row, strict=False))
    levels = [("left", "right"), ("low", "high"), ("early", "late")]
    for corner in itertools.product(*levels):
        sign = (-1.0) ** sum(level in ("left", "low", "early") for level in corner)
        assert weights.pop(("k", f"VE2 ({', '.join(corner)})")) == sign
    assert not any(weights.values())
