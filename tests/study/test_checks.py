"""Checks of fits: planted subjects are named, and files open with ArviZ."""

import numpy as np
import pytest
from scipy import stats

import percept
from percept import Scene, Study, read_sessions
from percept.results import Skipped
from tests import DATASETS
from tests.fits import SHARED
from tests.study.checked import study_of, table_of


@pytest.fixture(scope="module")
def clean():
    return study_of(table_of(("k", "b")), checks={}, tolerance=0.1)


@pytest.fixture(scope="module")
def planted():
    """Subject S04 twice as stiff everywhere, and S07 off in VE2 alone."""
    table = table_of(subjects=12, seed=3)
    table.loc[table["subject"] == "S04", "k_adj"] *= np.exp(1.5)
    low = (table["subject"] == "S07") & (table["environment"] == "VE2")
    table.loc[low, "k_adj"] *= np.exp(-1.6)
    return study_of(table, checks={}, tolerance=0.1)


def test_subjects_who_fit_are_not_named(clean):
    found = clean.checks.loo
    assert not any(check.outlier for check in found.subjects)
    assert found.cells == ()
    # Probabilities under the model: even over the subjects.
    farther = [check.farther for check in found.subjects]
    assert stats.kstest(farther, stats.uniform.cdf).pvalue > 1e-3
    assert not any(check.unusual for check in clean.checks.statistics)


def test_planted_subjects_are_named_with_what_to_do(planted):
    found = planted.checks.loo
    outliers = [check.subject for check in found.subjects if check.outlier]
    assert outliers == ["S04", "S07"]
    # Without S04 the draws say little: what rests on them is withheld.
    unreliable = [check.subject for check in found.subjects if check.pareto_k > found.good_k]
    assert "S04" in unreliable
    names = [check.subject for check in found.subjects]
    for row in planted.checks.without:
        withheld = [name for name, value in zip(names, row.estimate, strict=True) if value is None]
        assert withheld == unreliable
    cells = {(cell.subject, cell.environment) for cell in found.cells}
    assert {("S04", "VE1"), ("S04", "VE3")} <= cells
    text = " ".join(found.messages)
    for said in (
        "S04 is an outlier",
        "S07 is an outlier",
        "S04 set stiffness in VE1 to",
        "far above",
    ):
        assert said in text
    # As a statistic of the cell, too: S04 is farther from the mean than the farthest of 12 users
    # should be.
    unusual = [check for check in planted.checks.statistics if check.unusual]
    assert "VE3" in {check.environment for check in unusual if check.statistic == "farthest"}


def test_headlines_without_a_subject_are_those_of_a_fit_without_it():
    """The average user's intervals, and the probability that what is displayed feels real."""
    references = [[100.0, 1e3], [1.0, 5.0]]
    table = table_of(("k", "b"), subjects=12, seed=3, references=references)
    tables = {
        "device": {"mass": 1.0, "damping": 5.0, "period": 0.001},
        "coupling": {"stiffness": 5e3, "damping": 20.0},
        "inference": {"method": "bayesian", "tolerance": 0.05, "seed": 7},
    }
    whole = Study(table, Scene(**tables, checks={}), store=SHARED)
    refit = Study(table[table["subject"] != "S01"], Scene(**tables), store=SHARED)
    subject = whole.sessions.subjects.index("S01")
    means = refit.intervals.query("kind == 'mean'").set_index(["environment", "parameter"])
    for row in whole.checks.without:
        cell = (row.environment, row.parameter)
        wanted = np.log(means.loc[cell, ["lower", "estimate", "upper"]].astype(float))
        found = np.log([row.lower[subject], row.estimate[subject], row.upper[subject]])
        half = 0.5 * (wanted["upper"] - wanted["lower"])
        # Both have errors of some hundredths of a half-width.
        np.testing.assert_allclose(found, wanted, atol=0.15 * half)
    (before,), (without,) = (
        [one for one in study.verdict_rows if one.environment == "VE2" and one.coupled]
        for study in (whole, refit)
    )
    error = np.hypot(before.bayesian.error, without.bayesian.error)
    assert abs(before.without[subject] - without.probability) < 3.0 * error
    assert abs(before.probability - without.probability) > 4.0 * error
    assert refit.verdict_rows[0].without == ()


def test_a_new_user_differs_from_the_mean_by_the_spread_between_users(clean):
    named = {
        name: found.to_numpy() for name, found in clean.posterior["posterior"].data_vars.items()
    }
    users = clean.posterior["posterior_predictive/new_user"].to_numpy()
    spread = np.hypot(named["sigma"], named["sigma_u"][..., None])
    within = np.abs(np.log(users / named["population_mean"])) < stats.norm.ppf(0.75) * spread
    # Cells of one draw share the subject's effects.
    assert np.mean(within) == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / (within.size / 6)))


def test_the_tree_says_who_made_it_and_no_time(clean):
    tree = clean.posterior
    for name in tree.children:
        made = {key: value for key, value in tree[name].attrs.items() if key.startswith("creat")}
        assert made == {
            "creation_library": "percept",
            "creation_library_version": percept.__version__,
        }


def test_published_limits_have_no_subjects_to_leave_out():
    scene = Scene(
        inference={"tolerance": 0.3, "method": "bayesian", "parameters": ["k"]}, checks={}
    )
    study = Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene)
    assert isinstance(study.fit.subjects, Skipped)
    assert study.checks is None
