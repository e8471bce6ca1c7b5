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
from percept.study.checks import subject_tables, trial_noise_p_value
from percept.study.responses import ResponseScale, Trials
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
    assert not found.subjects["outlier"].any()
    assert not found.cells["outlier"].any()
    assert found.elpd == pytest.approx(found.subjects["elpd"].sum())
    assert len(found.cells) == 60
    # Probabilities under the model: even over the subjects, and over the cells (which hang
    # together).
    assert stats.kstest(found.subjects["farther"], stats.uniform.cdf).pvalue > 1e-3
    assert stats.kstest(found.cells["below"], stats.uniform.cdf).pvalue > 1e-4
    assert not clean.parts.checks.statistics["unusual"].any()


def test_planted_subjects_are_named_with_what_to_do(planted):
    found = planted.parts.checks.loo
    rows = found.subjects.set_index("subject")
    assert rows.index[rows["outlier"]].tolist() == ["S04", "S07"]
    # Others lie near the limit of the index, and on either side of it from one run to the next.
    assert rows.loc[["S04", "S07"], "influential"].all()
    cells = found.cells[found.cells["outlier"]]
    assert {("S04", "VE1"), ("S04", "VE3")} <= set(
        zip(cells["subject"], cells["environment"], strict=True)
    )
    text = " ".join(found.messages)
    assert "S04 lies far from what the others predict" in text
    assert "S07 lies far from what the others predict" in text
    assert "S04 set stiffness in VE1 to" in text
    assert "far above what the others predict" in text
    (influential,) = (message for message in found.messages if "results are rough" in message)
    assert influential.startswith("The results lean on ")
    rule = tomllib.loads(re.search(r"exclude = \[\{.*?\}\]", influential)[0])["exclude"]
    assert {"S04", "S07"} <= set(rule[0]["equals"])
    # The rule is one that a scene takes.
    assert Scene(sessions={"exclude": rule}).sessions.exclude[0].column == "subject"
    # Without repeats nothing tells whether trial noise differs.
    assert "scatter more" not in influential
    # As a statistic of the cell, too: S04 is farther from the mean than the farthest of 12 users
    # should be.
    unusual = planted.parts.checks.statistics.query("unusual and statistic == 'farthest'")
    assert "VE3" in set(unusual["environment"])


def test_false_alarms_are_shared_among_the_subjects(clean):
    """One study in twenty names somebody: of ten subjects each has a probability of 0.005."""
    farther = np.array([0.0049, 0.0051, *[0.5] * 8])
    loo = Loo(np.zeros(10), np.zeros(10), 0.7, np.zeros((1, 1)), np.ones((1, 10)))
    predicted = Predicted(np.full((10, 2, 3), 0.5), farther)
    found = subject_tables(clean.parts.fit, clean.parts.fit.subjects, loo, predicted)
    assert found.subjects["outlier"].tolist() == [True] + [False] * 9


def tables_of(study, pareto_k):
    """Checks of a study's subjects whose Pareto indices are given."""
    density = study.parts.fit.subjects
    count = len(pareto_k)
    loo = Loo(np.zeros(count), np.array(pareto_k), 0.7, np.zeros((1, 1)), np.ones((1, count)))
    return subject_tables(study.parts.fit, density, loo, Predicted(
        np.full(density.density.statistics.cell_means.shape, 0.5), np.full(count, 0.5)
    ))  # fmt: skip


def test_over_a_third_of_the_subjects_is_one_sentence(clean):
    (few,) = tables_of(clean, [0.9] * 3 + [0.2] * 7).messages
    assert few.startswith("The results lean on S01, S02, S03 (Pareto index above 0.70).")
    (many,) = tables_of(clean, [0.9] * 4 + [0.2] * 6).messages
    assert many == (
        "Leave-one-out results are rough: 4 of 10 subjects are influential (Pareto index above"
        " 0.70)."
    )


def repeated(noise):
    """Five trials in each cell, with a trial SD per subject."""
    rng = np.random.default_rng(5)
    table = table_of(subjects=10, seed=4)
    table = table.loc[table.index.repeat(5)].reset_index(drop=True)
    table["trial"] = table.groupby(["subject", "environment"]).cumcount() + 1
    sd = dict(zip(table["subject"].unique(), noise, strict=True))
    table["k_adj"] *= np.exp(rng.normal(0.0, 1.0, len(table)) * table["subject"].map(sd))
    return table


def test_trial_noise_is_the_cause_only_where_a_test_shows_that_it_differs():
    pareto_k = [0.9] * 5 + [0.2] * 5
    same = study_of(repeated([0.1] * 10), checks={}, tolerance=0.3)
    assert trial_noise_p_value(same.parts.fit.trials) > 0.05
    assert "scatter more" not in tables_of(same, pareto_k).messages[0]
    differs = study_of(repeated([0.05, 0.15] * 5), checks={}, tolerance=0.3)
    assert trial_noise_p_value(differs.parts.fit.trials) < 1e-3
    assert (
        tables_of(differs, pareto_k)
        .messages[0]
        .endswith(
            "The trials of some subjects scatter more than those of others, which the model takes to be"
            " alike."
        )
    )


@pytest.mark.evidence(reduced=True)
def test_the_test_of_trial_noise_keeps_its_size():
    """Trials of unequal counts, environments of unequal noise, heavy tails: p-values stay uniform."""
    rng = np.random.default_rng(8)
    found = []
    studies = 2000 if LONG else 150
    for _ in range(studies):
        counts = rng.integers(1, 5, size=(8, 3))
        cells = np.repeat(np.indices(counts.shape).reshape(2, -1), counts.ravel(), axis=1)
        noise = (
            rng.standard_t(4, size=(cells.shape[1], 2)) * np.array([0.05, 0.5, 5.0])[cells[1], None]
        )
        found.append(trial_noise_p_value(trials_of(noise, *cells)))
    rejected = np.mean(np.array(found) < 0.05)
    assert rejected < 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / studies)
    assert (
        trial_noise_p_value(trials_of(np.zeros((2, 1)), np.array([0, 1]), np.array([0, 0]))) == 1.0
    )


def trials_of(response, subject, environment):
    """Trials of which only responses and codes matter."""
    reference = np.ones((response.shape[1], environment.max() + 1))
    return Trials(
        response, subject, environment, (), (), (), reference,
        ResponseScale.of(reference, "normal"), (),
    )  # fmt: skip


def test_statistics_above_their_range_are_hardly_ever_larger(planted):
    found = planted.parts.checks.statistics
    high = found[found["observed"] > found["upper"]]
    assert len(high) > 0
    # Half of one per cent lies above a limit, which is a quantile of the same draws.
    assert (high["above"] < 0.006).all()


def test_tree_is_the_posterior_and_a_file_that_opens(clean, tmp_path):
    tree = clean.posterior
    assert set(tree.children) == {"posterior", "posterior_predictive", "sample_stats"}
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
    prior = clean.parts.checks.prior.set_index(["environment", "parameter", "kind"])
    for (environment, parameter), reference in {("VE1", "k"): 100.0, ("VE3", "b"): 25.0}.items():
        row = prior.loc[(environment, parameter, "mean")]
        # The prior of a mean's bias is centred at none; log is near N(0, 1 + gamma and tau shares).
        assert np.log(row["q50"] / reference) == pytest.approx(
            0.0, abs=5 * 1.3 * 1.26 / np.sqrt(40_000)
        )
        assert 1.0 < np.log(row["q95"] / reference) / stats.norm.ppf(0.95) < 1.4
        user = prior.loc[(environment, parameter, "user")]
        assert user["q95"] > row["q95"]
        assert user["q5"] < row["q5"]


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
