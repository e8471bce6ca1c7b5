"""Checks of fits: planted subjects are named, conflicts are seen, and files open with ArviZ."""

import warnings

import arviz_stats
import numpy as np
import pandas as pd
import pytest
import xarray
from scipy import stats

import percept
from percept import Scene, Study, UsageError, read_sessions
from percept.inference.checks.left_out import Loo, Predicted
from percept.study.basics import Skipped
from percept.study.checks import (
    SubjectChecks,
    compare_models,
    correlation_table,
    power_scaling,
    ranked,
    sentence_of,
    subject_tables,
)
from percept.study.posterior import posterior_tree
from tests import DATASETS
from tests.study.checked import study_of, table_of


@pytest.fixture(scope="module")
def clean():
    return study_of(table_of(("k", "b")), checks={}, tolerance=0.1)


@pytest.fixture(scope="module")
def planted():
    """Subject S04 twice as stiff everywhere, and S07 off in VE2 alone."""
    table = table_of(subjects=12, seed=3)
    table.loc[table["subject"] == "S04", "k_adj"] *= np.exp(1.5)
    table.loc[(table["subject"] == "S07") & (table["environment"] == "VE2"), "k_adj"] *= np.exp(-1.6)
    return study_of(table, checks={"refit": True}, tolerance=0.1)


def test_subjects_who_fit_are_not_named(clean):
    found = clean.checks.loo
    assert not found.subjects["outlier"].any()
    assert not found.cells["outlier"].any()
    assert found.elpd == pytest.approx(found.subjects["elpd"].sum())
    assert len(found.cells) == 60
    # Probabilities under the model: even over the subjects, and over the cells (which hang together).
    assert stats.kstest(found.subjects["farther"], stats.uniform.cdf).pvalue > 1e-3
    assert stats.kstest(found.cells["below"], stats.uniform.cdf).pvalue > 1e-4
    assert not clean.checks.statistics["unusual"].any()


def test_planted_subjects_are_named_with_what_to_do(planted):
    found = planted.checks.loo
    rows = found.subjects.set_index("subject")
    assert rows.index[rows["outlier"]].tolist() == ["S04", "S07"]
    # Others lie near the limit of the index, and on either side of it from one run to the next.
    assert rows.loc[["S04", "S07"], "influential"].all()
    cells = found.cells[found.cells["outlier"]]
    assert {("S04", "VE1"), ("S04", "VE3")} <= set(zip(cells["subject"], cells["environment"], strict=True))
    text = " ".join(found.messages)
    assert "S04 lies far from what the others predict" in text
    assert "S07 lies far from what the others predict" in text
    assert "S04 set stiffness in VE1 to" in text
    assert "far above what the others predict" in text
    assert "report the intervals with and without them" in text
    stays = [message for message in found.messages if "stays rough, though sampled again" in message]
    assert len(stays) == 1
    assert "S07" in stays[0]
    # As a statistic of the cell, too: S04 is farther from the mean than the farthest of 12 users should be.
    unusual = planted.checks.statistics.query("unusual and statistic == 'farthest'")
    assert "VE3" in set(unusual["environment"])


def test_false_alarms_are_shared_among_the_subjects(clean):
    """One study in twenty names somebody: of ten subjects each has a probability of 0.005."""
    farther = np.array([0.0049, 0.0051, *[0.5] * 8])
    loo = Loo(np.zeros(10), np.zeros(10), 0.7, np.zeros((1, 1)), np.ones((1, 10)))
    predicted = Predicted(np.full((10, 2, 3), 0.5), farther)
    found = subject_tables(clean.fit, loo, predicted, np.zeros(10, dtype=bool), refit=False)
    assert found.subjects["outlier"].tolist() == [True] + [False] * 9


def test_statistics_above_their_range_are_hardly_ever_larger(planted):
    found = planted.checks.statistics
    high = found[found["observed"] > found["upper"]]
    assert len(high) > 0
    # Half of one per cent lies above a limit, which is a quantile of the same draws.
    assert (high["above"] < 0.006).all()


def test_reweighting_says_it_is_rough_and_sampling_anew_says_how_far_off(planted):
    quick = Study(planted.sessions, Scene.from_tables(planted.scene.to_dict() | {"checks": {}}))
    quick.__dict__["_fitted"] = planted.fit
    found = quick.checks.loo
    assert not found.subjects["refitted"].any()
    rough = [message for message in found.messages if "are rough" in message]
    assert len(rough) == 1
    assert "S04" in rough[0]
    assert "S07" in rough[0]
    assert "--refit" in rough[0]
    # The wild subjects widen the spread that reweighting starts from: it can only be too kind to them.
    kind, sharp = (study.checks.loo.subjects.set_index("subject")["farther"] for study in (quick, planted))
    assert (sharp[["S04", "S07"]] < 0.2 * kind[["S04", "S07"]]).all()


def test_tree_is_the_posterior_with_groups_that_arviz_understands(clean, tmp_path):
    tree = clean.posterior
    assert set(tree.children) == {
        "posterior", "posterior_predictive", "sample_stats", "log_likelihood", "log_prior", "prior",
        "prior_predictive",
    }  # fmt: skip
    plain = posterior_tree(clean.fit, seed=7, full=False)
    np.testing.assert_array_equal(plain["posterior/population_mean"], tree["posterior/population_mean"])
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with xarray.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as opened:
        assert opened.equals(tree)
        assert opened["log_likelihood/trials"].dims == ("chain", "draw", "subject")
        assert opened["prior_predictive/new_user"].dims == ("chain", "draw", "parameter", "environment")
        with warnings.catch_warnings():
            # Whether a subject's tail is worth a warning depends on the draws.
            warnings.filterwarnings("ignore", "Estimated shape parameter of Pareto")
            by_arviz = arviz_stats.loo(opened, pointwise=True, reff=1.0)
        ours = clean.checks.loo
        # Weights with drawn locations are noisier: equal within what that noise makes of ten subjects.
        assert by_arviz.elpd == pytest.approx(ours.elpd, abs=1.5)
        np.testing.assert_array_equal(by_arviz.elpd_i["subject"], ours.subjects["subject"])
        sensitivity = arviz_stats.psense_summary(opened, var_names=["population_mean"])
        assert sensitivity["likelihood"].gt(0.02).all()


def test_a_new_user_differs_from_the_mean_by_the_spread_between_users(clean):
    tree = posterior_tree(clean.fit, seed=7, full=True)
    arrays = {of: {name: found.to_numpy() for name, found in tree[of].data_vars.items()} for of in tree}
    for of, users in (("posterior", "posterior_predictive"), ("prior", "prior_predictive")):
        named = arrays[of]
        # Far tails of the priors are beyond what a double holds in N/m: quartiles, and no moments.
        with np.errstate(all="ignore"):
            off = np.log(arrays[users]["new_user"] / named["population_mean"])
        within = np.abs(off) < stats.norm.ppf(0.75) * np.hypot(named["sigma"], named["sigma_u"][..., None])
        # Cells of one draw share the subject's effects.
        assert np.mean(within) == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / (within.size / 6)))


def test_log_likelihood_is_that_of_the_stored_draws(clean):
    tree = posterior_tree(clean.fit, seed=7, full=True)
    posterior = tree["posterior"].to_dataset().isel(chain=1, draw=[0, 5])
    data = clean.fit.trials
    for d in range(2):
        at = posterior.isel(draw=d)
        beta = np.log(at["population_mean"].to_numpy() / data.reference)
        sigma, sigma_u = at["sigma"].to_numpy(), at["sigma_u"].to_numpy()
        rho_w, rho_u = float(at["rho_w"]), float(at["rho_u"])
        shared = np.outer(sigma_u, sigma_u) * np.array([[1.0, rho_u], [rho_u, 1.0]])
        covariance = np.kron(np.ones((3, 3)), shared)
        for j in range(3):
            own = np.outer(sigma[:, j], sigma[:, j]) * np.array([[1.0, rho_w], [rho_w, 1.0]])
            covariance[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] += own
        law = stats.multivariate_normal(beta.T.ravel(), covariance)
        for i in range(10):
            response = data.response[data.subject == i].ravel()
            ours = tree["log_likelihood/trials"].isel(chain=1, draw=[0, 5][d], subject=i)
            assert float(ours) == pytest.approx(law.logpdf(response), rel=1e-8)


def test_a_prior_against_the_data_is_seen():
    table = table_of(alpha=0.6, subjects=8, seed=5)
    study = study_of(
        table, model={"priors": {"alpha_sd": 0.05, "gamma_sd": 0.01, "tau_scale": 0.05}}, tolerance=0.1
    )
    found = power_scaling(posterior_tree(study.fit, seed=7, full=True))
    means = found[found["quantity"] == "mean"]
    assert (means["prior"] > 0.05).all()
    assert means["diagnosis"].str.contains("priors \\(of bias most\\)").all()
    assert (means["prior_bias"] > 5 * means["prior_spread"]).all()


def test_a_prior_that_hardly_matters_is_left_alone(clean):
    found = clean.checks.sensitivity
    means = found[(found["quantity"] == "mean") & (found["environment"] == "VE2")]
    assert (means["diagnosis"] == "").all()
    assert (means["likelihood"] > 0.05).all()


def test_sensitivities_go_by_the_quantities_they_are_of(clean):
    found = clean.checks.sensitivity.set_index(["quantity", "environment", "parameter"])
    for quantity, name in (("mean", "population_mean"), ("spread", "population_sd")):
        arviz = arviz_stats.psense_summary(clean.posterior, var_names=[name], round_to=10)
        for (environment, parameter), row in found.loc[quantity].iterrows():
            theirs = arviz.loc[f"{name}[{parameter}, {environment}]"]
            assert row["prior"] == pytest.approx(float(theirs["prior"]), rel=1e-6)
            assert row["likelihood"] == pytest.approx(float(theirs["likelihood"]), rel=1e-6)


def test_correlation_that_was_simulated_is_found():
    study = study_of(table_of(("k", "b"), subjects=40, seed=8, rho_u=0.8, rho_w=0.8), tolerance=0.2)
    table = correlation_table(study.fit, study.fit.subjects, level=0.99)
    found = table.set_index(["of", "environment"])
    for at in [("within", ""), ("population", "VE1"), ("population", "VE3")]:
        assert found.loc[at, "lower"] < 0.8 < found.loc[at, "upper"]
        assert found.loc[at, "positive"] > 0.99


def test_prior_quantiles_are_in_native_units(clean):
    prior = clean.checks.prior.set_index(["environment", "parameter", "kind"])
    for (environment, parameter), reference in {("VE1", "k"): 100.0, ("VE3", "b"): 25.0}.items():
        row = prior.loc[(environment, parameter, "mean")]
        # The prior of a mean's bias is centred at none; log is near N(0, 1 + gamma and tau shares).
        assert np.log(row["q50"] / reference) == pytest.approx(0.0, abs=5 * 1.3 * 1.26 / np.sqrt(40_000))
        assert 1.0 < np.log(row["q95"] / reference) / stats.norm.ppf(0.95) < 1.4
        user = prior.loc[(environment, parameter, "user")]
        assert user["q95"] > row["q95"]
        assert user["q5"] < row["q5"]


def test_shrinkage_lies_between_raw_mean_and_trend(clean):
    found = clean.checks.shrinkage
    reference = found["environment"].map({"VE1": 0, "VE2": 1, "VE3": 2})
    cells = clean.sessions.table.assign(log=lambda t: np.log(t["k_adj"]))
    raw = np.exp(cells.groupby("environment", sort=False)["log"].mean().to_numpy())
    k = found["parameter"] == "k"
    np.testing.assert_allclose(found.loc[k, "raw"], raw[reference[k]], rtol=1e-12)
    moved = found["moved"].dropna()
    assert moved.between(0.0, 1.0).all()
    way = np.log(found["trend"] / found["raw"])
    np.testing.assert_allclose(
        (found["moved"] * way).dropna(), np.log(found["centre"] / found["raw"])[found["moved"].notna()]
    )


def test_exact_weber_loses_where_the_spread_grows():
    """Kappa 0.5 over three decades of stiffness: the spread grows by exp(1.5) = 4.5 from end to end."""
    table = table_of(subjects=12, references=[[100.0, 1e3, 1e4, 1e5]], seed=11, kappa=0.5, s=0.12)
    study = study_of(table, tolerance=0.1)
    found = compare_models(study.sessions, study.scene, ("k",), models=("common spread", "exact Weber"))
    assert found.table["model"].tolist() == ["common spread", "exact Weber"]
    behind = found.table.iloc[1]
    assert behind["difference"] < -2.0 * behind["difference_se"]
    assert behind["difference"] < -4.0
    assert '"common spread" predicts a subject left out best; exact Weber clearly worse' in found.sentence
    # The fit itself says the same of kappa.
    kappa = study.checks.weber.iloc[0]
    assert kappa["lower"] < 0.5 < kappa["upper"]
    assert kappa["positive"] > 0.9


def checks_of(elpd, influential, refitted):
    table = pd.DataFrame({"elpd": elpd, "influential": influential, "refitted": refitted})
    return SubjectChecks(float(np.sum(elpd)), 1.0, 0.7, table, table, ())


def test_models_are_apart_by_their_sums_over_subjects():
    none = [False] * 3
    found = ranked(
        {
            "a": checks_of([1.0, 2.0, 3.0], none, none),
            "b": checks_of([0.5, 0.5, 2.75], [True, True, False], [True, False, False]),
        }
    )
    assert found["model"].tolist() == ["a", "b"]
    assert found["difference"].tolist() == [0.0, -2.25]
    # Of a sum over three subjects.
    wanted = np.sqrt(3) * np.std([-0.5, -1.5, -0.25], ddof=1)
    assert found["difference_se"].tolist() == pytest.approx([0.0, wanted])
    # One influential subject was sampled again; the other stays rough.
    assert found["rough"].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("difference", "said"),
    [
        (-3.9, '"a" predicts a subject left out best, not distinguishable from b.'),
        (-4.1, '"a" predicts a subject left out best; b clearly worse.'),
    ],
)
def test_a_model_is_clearly_worse_from_a_difference_of_four(difference, said):
    """However small its standard error: below that it cannot be trusted."""
    table = pd.DataFrame({"model": ["a", "b"], "difference": [0.0, difference], "difference_se": [0.0, 0.1]})
    assert sentence_of(table.assign(rough=0)) == said


def test_models_must_exist_and_need_several_environments(clean):
    with pytest.raises(UsageError, match="no such model; there are full, Weber trend"):
        compare_models(clean.sessions, clean.scene, ("k",), models=("fullest",))
    one = study_of(table_of(references=[[100.0]]), tolerance=0.2)
    with pytest.raises(ValueError, match="one environment there is one model only"):
        compare_models(one.sessions, one.scene, ("k",))


def test_the_tree_says_who_made_it_and_no_time(clean):
    tree = clean.posterior
    for name in tree.children:
        made = {key: value for key, value in tree[name].attrs.items() if key.startswith("creat")}
        assert made == {"creation_library": "percept", "creation_library_version": percept.__version__}


def test_published_limits_have_no_subjects_to_leave_out():
    scene = Scene.from_tables(
        {"inference": {"tolerance": 0.3, "method": "bayesian", "parameters": ["k"]}, "checks": {}}
    )
    study = Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene)
    assert isinstance(study.fit.subjects, Skipped)
    assert study.checks is None
    assert "log_likelihood" not in study.posterior.children
    with pytest.raises(ValueError, match="compared on the sessions of subjects"):
        compare_models(study.sessions, study.scene, ("k",), models=("full",))
