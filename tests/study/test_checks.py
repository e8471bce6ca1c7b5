"""Checks of fits: planted subjects are named, and files open with ArviZ."""

import re
import tomllib

import arviz_stats
import numpy as np
import pytest
import xarray
from scipy import stats

import percept
from percept import Scene, Study, read_sessions
from percept.inference.checks.left_out import Loo, Predicted
from percept.study.basics import Skipped
from percept.study.checks import subject_tables
from tests import DATASETS, LONG
from tests.study.checked import study_of, table_of


@pytest.fixture(scope="module")
def clean():
    return study_of(table_of(("k", "b")), checks={}, tolerance=0.1)


@pytest.fixture(scope="module")
def planted():
    """Subject S04 twice as stiff everywhere, and S07 off in VE2 alone."""
    table = table_of(subjects=12, seed=3)
    table.loc[table["subject"] == "S04", "k_adj"] *= np.exp(1.5)
    table.loc[(table["subject"] == "S07") & (table["environment"] == "VE2"), "k_adj"] *= np.exp(
        -1.6
    )
    return study_of(table, checks={}, tolerance=0.1)


def test_subjects_who_fit_are_not_named(clean):
    found = clean.parts.checks.loo
    assert not any(check.outlier for check in found.subjects)
    assert not any(check.influential for check in found.subjects)
    assert not any(cell.outlier for cell in found.cells)
    assert found.elpd == pytest.approx(sum(check.elpd for check in found.subjects))
    assert len(found.cells) == 60
    # Probabilities under the model: even over the subjects, and over the cells (which hang
    # together).
    farther = [check.farther for check in found.subjects]
    below = [cell.below for cell in found.cells]
    assert stats.kstest(farther, stats.uniform.cdf).pvalue > 1e-3
    assert stats.kstest(below, stats.uniform.cdf).pvalue > 1e-4
    assert not any(check.unusual for check in clean.parts.checks.statistics)


def test_planted_subjects_are_named_with_what_to_do(planted):
    found = planted.parts.checks.loo
    outliers = [check.subject for check in found.subjects if check.outlier]
    assert outliers == ["S04", "S07"]
    influential = [check.subject for check in found.subjects if check.influential]
    assert set(influential) & {"S04", "S07"}
    cells = {(cell.subject, cell.environment) for cell in found.cells if cell.outlier}
    assert {("S04", "VE1"), ("S04", "VE3")} <= cells
    text = " ".join(found.messages)
    assert "S04 lies far from what the others predict" in text
    assert "S07 lies far from what the others predict" in text
    assert "S04 set stiffness in VE1 to" in text
    assert "far above what the others predict" in text
    said = next(
        message for message in found.messages if f"{influential[0]} is influential" in message
    )
    rule = tomllib.loads(re.search(r"exclude = \[\{.*?\}\]", said)[0])["exclude"]
    assert rule[0]["equals"] == [influential[0]]
    # The rule is one that a scene takes.
    assert Scene(sessions={"exclude": rule}).sessions.exclude[0].column == "subject"
    # As a statistic of the cell, too: S04 is farther from the mean than the farthest of 12 users
    # should be.
    unusual = [check for check in planted.parts.checks.statistics if check.unusual]
    assert "VE3" in {check.environment for check in unusual if check.statistic == "farthest"}


def test_false_alarms_are_shared_among_the_subjects(clean):
    """One study in twenty names somebody: of ten subjects each has a probability of 0.005."""
    farther = np.array([0.0049, 0.0051, *[0.5] * 8])
    loo = Loo(np.zeros(10), np.zeros(10), 0.7, np.zeros((1, 1)), np.ones((1, 10)))
    predicted = Predicted(np.full((10, 2, 3), 0.5), farther)
    fit = clean.parts.fit
    found = subject_tables(fit, fit.subjects, loo, predicted, {})
    assert [check.outlier for check in found.subjects] == [True] + [False] * 9


def refit_without(table, subject):
    return study_of(table[table["subject"] != subject], tolerance=0.1).parts.fit


def test_an_influential_subject_comes_with_what_the_interval_becomes_without_it():
    table = table_of(subjects=12, seed=3)
    off = (table["subject"] == "S07") & (table["environment"] == "VE2")
    table.loc[off, "k_adj"] *= np.exp(1.6)
    study = study_of(table, checks={}, tolerance=0.1)
    found = study.parts.checks.loo
    assert [check.subject for check in found.subjects if check.influential] == ["S07"]
    (said,) = (message for message in found.messages if "influential" in message)
    own = study.parts.fit
    other = refit_without(table, "S07")
    c = own.column["k", "VE2"]
    kind = "mean" if "the average user" in said else "user"
    words = [
        f"{fit.limits[kind][0][c]:.4g} to {fit.limits[kind][1][c]:.4g} N/m" for fit in (other, own)
    ]
    assert f"becomes {words[0]} instead of {words[1]}." in said
    move = re.search(r"moves by ([\d.]+) of its half-width, more than in 95 % of such", said)
    before = np.log([ends[c] for ends in own.limits[kind]])
    after = np.log([ends[c] for ends in other.limits[kind]])
    half = 0.5 * (before[1] - before[0])
    assert float(move[1]) == pytest.approx(np.abs(after - before).max() / half, abs=0.006)


@pytest.mark.evidence(reduced=True)
def test_in_five_of_a_hundred_correct_studies_a_subject_is_called_influential():
    studies = 500 if LONG else 2
    named = 0
    for seed in range(studies):
        table = table_of(("k", "b"), references=[[400.0, 1500.0], [2.0, 6.0]], seed=1000 + seed)
        study = study_of(table, checks={}, tolerance=0.1)
        named += any(check.influential for check in study.parts.checks.loo.subjects)
    assert stats.binomtest(named, studies, 0.05).pvalue > 0.01


@pytest.mark.evidence
def test_a_planted_subject_is_mostly_called_influential():
    named = 0
    for seed in range(4):
        table = table_of(("k", "b"), references=[[400.0, 1500.0], [2.0, 6.0]], seed=2000 + seed)
        off = (table["subject"] == "S03") & (table["environment"] == "VE1")
        table.loc[off, "k_adj"] *= np.exp(1.5)
        study = study_of(table, checks={}, tolerance=0.2)
        named += any(
            check.influential and check.subject == "S03"
            for check in study.parts.checks.loo.subjects
        )
    assert named >= 3


def test_statistics_above_their_range_are_hardly_ever_larger(planted):
    found = planted.parts.checks.statistics
    high = [check for check in found if check.observed > check.upper]
    assert high
    # Half of one per cent lies above a limit, which is a quantile of the same draws.
    assert all(check.above < 0.006 for check in high)


def test_tree_is_the_posterior_and_a_file_that_opens(clean, tmp_path):
    tree = clean.posterior
    assert set(tree.children) == {
        "posterior", "posterior_predictive", "sample_stats", "log_likelihood", "observed_data",
        "prior",
    }  # fmt: skip
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with xarray.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as opened:
        assert opened.equals(tree)
        assert opened["posterior_predictive/new_user"].dims == (
            "chain",
            "draw",
            "parameter",
            "environment",
        )
        found = arviz_stats.summary(
            opened, var_names=["population_mean"], kind="diagnostics", fmt="xarray"
        )
        assert set(found["environment"].to_numpy()) == {"VE1", "VE2", "VE3"}


def test_a_new_user_differs_from_the_mean_by_the_spread_between_users(clean):
    named = {
        name: found.to_numpy() for name, found in clean.posterior["posterior"].data_vars.items()
    }
    users = clean.posterior["posterior_predictive/new_user"].to_numpy()
    spread = np.hypot(named["sigma"], named["sigma_u"][..., None])
    within = np.abs(np.log(users / named["population_mean"])) < stats.norm.ppf(0.75) * spread
    # Cells of one draw share the subject's effects.
    assert np.mean(within) == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / (within.size / 6)))


def test_prior_quantiles_are_in_native_units(clean):
    prior = {
        (row.environment, row.parameter, row.kind): row.quantiles
        for row in clean.parts.checks.prior
    }
    for (environment, parameter), reference in {("VE1", "k"): 100.0, ("VE3", "b"): 25.0}.items():
        mean = prior[environment, parameter, "mean"]
        # The prior of a mean's bias is centred at none; log is near N(0, 1 + gamma and tau shares).
        assert np.log(mean["50"] / reference) == pytest.approx(
            0.0, abs=5 * 1.3 * 1.26 / np.sqrt(40_000)
        )
        assert 1.0 < np.log(mean["95"] / reference) / stats.norm.ppf(0.95) < 1.4
        user = prior[environment, parameter, "user"]
        assert user["95"] > mean["95"]
        assert user["5"] < mean["5"]


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
    assert isinstance(study.parts.fit.subjects, Skipped)
    assert study.parts.checks is None
