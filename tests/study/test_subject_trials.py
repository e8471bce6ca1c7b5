"""Trial SDs of subjects' own: what is planted is found, and one SD for all is told on."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study
from percept.study.prepare import prepare

SUBJECTS = 6
#: Planted trial SDs: threefold from the steadiest subject to the least steady.
SDS = np.geomspace(0.04, 0.12, SUBJECTS)


def table(trials=5, seed=8, sds=SDS):
    """Two references at two levels of a factor."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject, sd in enumerate(sds):
        own = rng.normal(0.0, 0.1)
        for environment, reference in (("VE1", 10.0), ("VE2", 100.0)):
            for level, hand in enumerate(("left", "right")):
                centre = own + 0.1 * level + rng.normal(0.0, 0.05)
                for trial in range(1, trials + 1):
                    adjusted = reference * np.exp(centre + sd * rng.normal())
                    rows.append([f"S{subject}", environment, hand, reference, trial, adjusted])
    names = ["subject", "environment", "hand", "k_ref", "trial", "k_adj"]
    return pd.DataFrame(rows, columns=names)


def study(made, *, bias="hand", **model):
    inference = {"method": "bayesian", "tolerance": 0.3, "level": 0.99}
    return Study(made, Scene(model={"bias": bias, **model}, inference=inference))


@pytest.fixture(scope="module")
def found():
    return study(table())


def test_each_subject_has_the_trial_sd_that_was_planted(found):
    rows = found.psychophysics
    own = rows[rows["subject"].notna() & rows["measure"].eq("sigma_e")]
    assert own["subject"].tolist() == [f"S{i}" for i in range(SUBJECTS)]
    assert ((own["lower"] < SDS) & (own["upper"] > SDS)).all()
    # One of 20 cells' trials has the standard error 1/sqrt(2 * 16); shared priors move it less.
    trials = found.sessions.table
    responses = np.log(trials["k_adj"] / trials["k_ref"])
    variances = responses.groupby([trials["subject"], trials["environment"]]).var()
    sample = np.sqrt(variances.groupby("subject").mean()).to_numpy()
    assert np.abs(np.log(own["estimate"].to_numpy() / sample)).max() < 1.5 / np.sqrt(32.0)
    # Their intervals are about as wide as those of chi-squared laws: other subjects narrow them,
    # and what cells have of their own widens them.
    tails = stats.chi2.ppf([0.995, 0.005], 16.0)
    width = 0.5 * np.log(tails[0] / tails[1])
    widths = np.log(own["upper"] / own["lower"]).to_numpy()
    assert ((0.6 * width < widths) & (widths < 1.4 * width)).all()
    fraction = rows[rows["subject"].notna() & rows["measure"].eq("weber")]
    np.testing.assert_allclose(fraction["estimate"], np.expm1(own["estimate"]), rtol=1e-12)


def plain(made, **model):
    """Prepare a study without factors."""
    numbered = made.assign(trial=made.groupby(["subject", "environment"]).cumcount() + 1)
    return prepare(study(numbered.drop(columns="hand"), bias=None, **model).data)


def has_own(found):
    return any(name.startswith("phi[") for name in found.model.names)


@pytest.mark.parametrize(
    ("made", "model", "why"),
    [
        (table(trials=2), {}, "half of the subjects repeat a trial fewer than 8 times; [model]"),
        (table(trials=3, sds=[0.05] * 61), {}, "the study has more than 60 subjects; [model]"),
        (table().query("environment == 'VE1'"), {}, "the study has one environment"),
        (table(), {"common_spread": True}, "they do not go with [model] common_spread"),
        (table(), {"subjects_trial_sd": False}, "[model] subjects_trial_sd = false"),
    ],
)
def test_plain_studies_without_them_say_why(made, model, why):
    found = plain(made, **model)
    (skipped,) = found.skipped
    assert skipped.what == "subjects' own trial SDs of stiffness"
    assert skipped.why.startswith(why)
    assert not has_own(found)


@pytest.mark.parametrize(
    ("alike", "why"),
    [
        ("subject == 'S2'", "the repeats of S2 in VE1, VE2 are alike, and a trial SD of zero has"),
        (
            "subject != 'S2' and environment == 'VE1'",
            "the repeats of S0, S1, S3, S4, S5 in VE1 are alike",
        ),
    ],
)
@pytest.mark.parametrize("setting", ["auto", True])
def test_repeats_without_scatter_are_named(alike, why, setting):
    made = table()
    rows = made.query(alike).index
    # Rounding of the mean leaves squares of 1e-33 about it.
    made.loc[rows, "k_adj"] = 1.1 * made.loc[rows, "k_ref"]
    found = plain(made, subjects_trial_sd=setting)
    (skipped,) = found.skipped
    assert skipped.why.startswith(why)
    assert not has_own(found)


def test_groups_with_trial_sds_of_their_own_have_jnds_of_their_own():
    sds = {"novice": 0.30, "expert": 0.06}
    made = table(trials=10, seed=1, sds=[*sds.values()] * 5).query("hand == 'left'")
    groups = np.where(made["subject"].str[1:].astype(int) % 2 == 0, "novice", "expert")
    grouped = made.drop(columns="hand").assign(group=groups)
    found = study(grouped, bias="group", subjects_trial_sd=True).psychophysics
    webers = found[(found["measure"] == "weber") & found["environment"].notna()]
    assert len(webers) == 4
    for row in webers.itertuples():
        group = row.environment.split("(")[1].removesuffix(")")
        other = sds["expert" if group == "novice" else "novice"]
        assert row.lower < sds[group] < row.upper
        # An average over both groups' cells would lie between the two SDs.
        assert not row.lower < np.sqrt(sds[group] * other) < row.upper
