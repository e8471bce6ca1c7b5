"""Bayesian contrasts of a study: the model it builds, what it reports, and what it cannot carry."""

import numpy as np
import pytest

from percept import UsageError
from percept.study.prepare import prepare
from tests.study.within import crossed, frame, study

BAYESIAN = {"method": "bayesian", "tolerance": 0.05}


@pytest.fixture(scope="module")
def made():
    table = frame(subjects=30, trials=1)
    return study(table[(table["subject"] != "S3") | (table["environment"] != "VE2")])


@pytest.fixture(scope="module")
def computed(made):
    bayesian = made.over(made.sessions, made.scene.with_inference(**BAYESIAN))
    return [vars(row) for row in bayesian.contrast_rows]


def test_many_subjects_leave_little_to_the_priors(made, computed):
    """Limits of both methods' average user lie within a fifth of the classical half-width."""
    classical = made.contrasts.query("of == 'bias' and kind == 'mean'").to_dict("records")
    bayesian = [row for row in computed if row["kind"] == "mean" and row["of"] == "bias"]
    assert [row["environment"] for row in bayesian] == ["VE1", "VE2", "VE3", None]
    assert [row["n"] for row in bayesian] == [30, 29, 30, 30]
    c, b = classical[0], bayesian[0]
    half = np.log(c["upper"] / c["lower"]) / 2.0
    for end in ("lower", "estimate", "upper"):
        assert abs(np.log(b[end] / c[end])) < 0.2 * half


def test_ratios_of_spread_hold_the_truth(computed):
    spreads = [row for row in computed if row["of"] == "spread"]
    assert [row["environment"] for row in spreads] == ["VE1", "VE2", "VE3", None]
    # Effects of subjects, of the second level, of cells and of trials have SDs .2, .15, .1, .05.
    of_cells = 0.1**2 + 0.05**2
    each = np.sqrt((0.2**2 + 0.15**2 + of_cells) / (0.2**2 + of_cells))
    assert all(row["lower"] < each < row["upper"] for row in spreads[:3])
    assert all(row["lower"] < row["estimate"] < row["upper"] for row in spreads)


def skipped(table, **tables):
    asked = {"method": "both", "tolerance": 0.3, "kinds": ["mean"]}
    made = study(table, inference=asked, **tables)
    return {part.what: part.why for part in made.skipped_before_curves}


def test_what_the_model_cannot_carry_is_said():
    table = frame()
    still = table.assign(k_adj=table["k_ref"] * (1.0 + 0.1 * (table["environment"] == "VE1")))
    still.loc[table["environment"] == "VE1", "k_adj"] += table["trial"] * (table.index % 7)
    assert "zero scatter has no proper posterior" in skipped(still)["Bayesian intervals"]
    none = {"model": {"pooling": "none", "prior": "reference"}}
    assert "partial" in skipped(table, **none)["Bayesian contrasts of stiffness"]
    zero = table.assign(k_adj=np.where(table.index == 0, 0.0, table["k_adj"]))
    assert "have no logarithm" in skipped(zero)["VE1 (left), in the hierarchical model"]


@pytest.mark.parametrize(
    ("bias", "model", "change", "message"),
    [
        ("hand * dose", {}, {}, "holds a column of numbers, which takes no interactions"),
        (
            "hand + same",
            {},
            {"same": lambda t: t["hand"]},
            "'same': says nothing that the environments",
        ),
        (
            "hand + place",
            {},
            {"place": lambda t: t["environment"]},
            "'place': says nothing that the",
        ),
        ("hand + dose", {"spread": "dose"}, {}, "is no factor of the model"),
    ],
)
def test_terms_that_the_data_cannot_carry_are_refused_by_name(bias, model, change, message):
    table = crossed().query("load == 'low'").assign(**change)
    with pytest.raises(UsageError, match=message):
        study(table, bias=bias, model=model)


def test_factors_that_are_not_in_spread_have_no_ratio():
    """The classical method has each factor's."""
    made = study(crossed(), bias="hand * load + group + dose", model={"spread": "hand"})
    compared = prepare(made.data).contrasts
    assert {one.factor for one in compared if one.of == "spread"} == {"hand"}
    spreads = made.contrasts.query("of == 'spread'")
    assert set(spreads["factor"]) == {"hand", "load", "group"}
