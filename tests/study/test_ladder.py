"""Classical against Bayesian intervals: in pairs, and the steps from one to the other."""

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions
from tests import DATASETS
from tests.study.checked import study_of, table_of

REFERENCE = {"pooling": "none", "prior": "reference"}


@pytest.fixture(scope="module")
def outlying():
    """Three environments of one bias and one whose users adjust 30 % lower; a fifth met by one
    subject."""
    references = [[100.0, 1e3, 1e4, 3e4, 5e4]]
    table = table_of(references=references, alpha=0.3, tau=0.02, sigma_u=0.0, s=0.2)
    table.loc[table["environment"] == "VE2", "k_adj"] *= 0.7
    table = table[(table["environment"] != "VE5") | (table["subject"] == "S01")]
    return study_of(table, method="both", family="normal")


def steps_of(study, query):
    """Effects of every step on the intervals of the average user, by cause."""
    effects = pd.DataFrame(study.ladder.effects).query(f"kind == 'mean' and {query}")
    return effects.set_index("cause")


def test_the_same_method_twice_makes_no_difference_beyond_its_error():
    """Under the reference prior without pooling the posterior is Eq. 15's t, whose limits have
    no error."""
    study = study_of(
        table_of(("k", "b"), subjects=6), model=REFERENCE, method="both", family="normal"
    )
    effects = pd.DataFrame(study.ladder.effects)
    assert list(effects["cause"].unique()) == ["all", "sampling"]
    assert len(effects) == 2 * 6 * 3
    apart = effects["log_width"] / effects["log_width_error"]
    assert apart.abs().max() < 4.0
    # Of six independent environments and parameters.
    assert 0.3 < np.sqrt((apart**2).mean()) < 2.0
    assert effects["log_width_error"].max() < 0.05
    # Each draw's law is centred on the mean: the interval's centre has no error but rounding.
    assert effects["centre"].abs().max() < 1e-12


def test_an_outlying_environment_is_moved_by_pooling(outlying):
    found = steps_of(outlying, "environment == 'VE2'")
    assert list(found.index) == ["all", "prior", "pooling"]
    assert found.loc["pooling", "centre"] > 0.05
    assert found.loc["pooling", "centre"] > abs(found.loc["prior", "centre"])


def test_an_environment_that_cannot_stand_alone_has_a_note_and_no_ladder(outlying):
    (note,) = outlying.ladder.notes
    assert note.startswith(
        "VE5: the step of the prior is missing: at least two subjects are needed"
    )
    environments = {effect.environment for effect in outlying.ladder.effects}
    assert environments == {"VE1", "VE2", "VE3", "VE4"}


def test_steps_lead_from_the_classical_interval_to_the_bayesian(outlying):
    effects, intervals = pd.DataFrame(outlying.ladder.effects), outlying.intervals
    rows = intervals.query("joint == 'marginal' and family == 'normal'").set_index(
        ["method", "environment", "parameter", "kind"]
    )
    for cell, steps in effects.groupby(["environment", "parameter", "kind"]):
        whole, rest = steps.iloc[0], steps.iloc[1:]
        old, new = (rows.loc[method, *cell] for method in ("classical", "bayesian"))
        width = old["upper"] - old["lower"]
        assert whole["log_width"] == pytest.approx(np.log((new["upper"] - new["lower"]) / width))
        shift = new["upper"] + new["lower"] - old["upper"] - old["lower"]
        assert whole["centre"] == pytest.approx(shift / width)
        for name in ("log_width", "centre"):
            assert rest[name].sum() == pytest.approx(whole[name], abs=1e-12)


def test_pairs_by_hand(fitted):
    pairs = fitted.comparison
    assert len(pairs) == 30
    where = {"environment": "VE3", "parameter": "b", "kind": "user", "family": "lognormal"}
    (pair,) = [one for one in pairs if where.items() <= vars(one).items()]
    rows = [one for one in fitted.interval_rows if where.items() <= vars(one).items()]
    old, new = [one for one in rows if one.joint == "marginal"]
    assert pair.width_ratio == pytest.approx((new.upper - new.lower) / (old.upper - old.lower))
    assert pair.shift == pytest.approx(new.estimate / old.estimate - 1.0)


def test_levels_of_a_factor_have_a_ladder_each():
    """An environment by itself has one level: its step leaves the factor out."""
    scene = Scene.load(DATASETS / "sleep.toml").with_inference(tolerance=0.2, kinds=["mean"])
    study = Study(read_sessions(DATASETS / "sleep.csv", scene=scene), scene)
    ladder = study.ladder
    assert ladder.notes == ()
    effects = pd.DataFrame(ladder.effects)
    causes = effects.groupby("environment")["cause"].agg(list).to_dict()
    steps = ["all", "prior", "pooling"]
    assert causes == {"nights (first)": steps, "nights (second)": steps}
