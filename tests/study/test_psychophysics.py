"""The psychophysics table against slow twins, SciPy and the study's own intervals."""

import math
import re
from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study
from percept.results import Measure
from tests.study.checked import study_of, table_of
from tests.study.within import only, reasons


def repeated(subjects=5, reference=8.0, repeats=3, seed=4):
    """Two environments, in which every subject adjusts several times."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(subjects):
        own = rng.normal(0.0, 0.8)
        for environment in ("weich", "hart"):
            here = own + rng.normal(0.0, 0.4)
            for trial in range(repeats):
                adjusted = reference + here + rng.normal(0.0, 0.1)
                rows.append((f"S{subject}", environment, reference, trial + 1, adjusted))
    return pd.DataFrame(rows, columns=["subject", "environment", "k_ref", "trial", "k_adj"])


def classical(table, **tables):
    inference = {"method": "classical", "level": 0.9} | tables.pop("inference", {})
    return Study(table, Scene(inference=inference, **tables)).psychophysics


def numbers(table, measure, environment=None):
    row = only(table, measure=measure, environment=environment)
    return row["estimate"], row["lower"], row["upper"]


@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_each_cell_equals_a_slow_twin(family):
    data = repeated()
    found = classical(data, inference={"family": family})
    log = family == "lognormal"
    for environment, cell in data.groupby("environment"):
        values = np.log(cell["k_adj"]) if log else cell["k_adj"]
        groups = [values[cell["subject"] == subject] for subject in cell["subject"].unique()]
        means = np.array([group.mean() for group in groups])

        def step(sd, log=log):
            return 8.0 * np.expm1(sd) if log else sd

        between = means.std(ddof=1) * np.sqrt(4 / np.array([4, *stats.chi2.isf([0.05, 0.95], 4)]))
        within = math.sqrt(np.mean([group.var(ddof=1) for group in groups]))
        trial = within * np.sqrt(10 / np.array([10, *stats.chi2.isf([0.05, 0.95], 10)]))
        expected = {
            "sd_subjects": step(between),
            "jnd": step(trial),
            "weber": step(trial) / 8,
            "sigma_e": trial if log else trial / 8,
        }
        for measure, values in expected.items():
            assert numbers(found, measure, environment) == pytest.approx(values, rel=1e-9)
        f = stats.f_oneway(*groups).statistic
        icc = (f - 1) / (f + 2)
        assert numbers(found, "icc_1", environment)[0] == pytest.approx(icc, rel=1e-9)


def test_components_over_environments_equal_expected_mean_squares():
    data = repeated()
    found = classical(data, inference={"family": "normal"})
    y = data["k_adj"].to_numpy().reshape(5, 2, 3) / 8.0 - 1.0
    cells = y.mean(axis=2)
    rest = cells - cells.mean(axis=1, keepdims=True) - cells.mean(axis=0) + cells.mean()
    ms_error = (rest**2).sum() / 4
    ms_subjects = 2 * cells.mean(axis=1).var(ddof=1)
    ms_trials = y.var(axis=2, ddof=1).mean()
    expected = {
        "sigma_u": math.sqrt((ms_subjects - ms_error) / 2),
        "sigma_w": math.sqrt(ms_error - ms_trials / 3),
        "sigma_e": math.sqrt(ms_trials),
    }
    for measure, value in expected.items():
        assert numbers(found, measure)[0] == pytest.approx(value, rel=1e-9)


def test_differences_from_zero_and_negative_references_are_in_the_unit():
    for reference in (0.0, -3.0):
        data = repeated(reference=reference)
        tables = {"inference": {"family": "normal"}}
        scaled = classical(data, model={"scale": {"k": 2.0}}, **tables)
        plain = classical(data, **tables)
        pd.testing.assert_frame_equal(plain, scaled, rtol=1e-12)
        assert set(plain[plain["measure"].isin(["sigma_u", "sigma_e"])]["unit"]) == {"N/m"}
        assert ("weber" in set(plain["measure"])) == (reference != 0.0)


@pytest.mark.parametrize(("subjects", "has"), [(2, False), (3, True)])
def test_two_subjects_tell_no_correlation(subjects, has):
    """Two pairs always lie on a line."""
    table = table_of(("k", "b"), subjects=subjects)
    found = study_of(table, method="classical").psychophysics
    assert ("correlation" in set(found["measure"])) == has


def test_posterior_rows_follow_from_the_draws(fitted):
    found = fitted.psychophysics
    bayesian = found[found["method"] == "bayesian"]
    fit = fitted.fit
    every = fit.run.points.reshape(-1, fit.points.shape[1])
    _, shared = fit.model.scales(every)["sigma_u"]
    draws = {name: values for name, (_, values) in fit.model.scales(fit.points).items()}
    row = only(bayesian, measure="sigma_u", parameter="k")
    limits = np.quantile(shared[:, 0], [0.005, 0.995])
    assert (row["lower"], row["upper"]) == pytest.approx(limits, rel=1e-12)

    def covariances(sd, correlation):
        matrix = np.tile(np.eye(2), (len(sd), 1, 1))
        matrix[:, 0, 1] = matrix[:, 1, 0] = correlation
        return sd[:, :, None] * matrix * sd[:, None, :]

    decades = fit.model.statistics.x[:, 2]
    whole = covariances(np.abs(decades) * draws["sigma_v:trend"], draws["rho_v:trend"])
    whole += covariances(draws["sigma_u"], draws["rho_u"])
    whole += covariances(draws["sigma"][..., 2], draws["rho_w"])
    twin = np.median(whole[:, 0, 1] / np.sqrt(whole[:, 0, 0] * whole[:, 1, 1]))
    of_pair = only(bayesian, measure="correlation", environment="VE3")
    assert of_pair["estimate"] == pytest.approx(twin, rel=1e-9)
    assert (bayesian["error"] > 0.0).all()
    assert found[found["method"] == "classical"]["error"].isna().all()


def test_the_page_of_measures_names_each():
    text = (Path(__file__).parents[2] / "docs" / "methods.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE))
    assert named == set(get_args(Measure))


@pytest.mark.parametrize(
    ("query", "with_jnd", "why"),
    [
        ("trial > 0", {"weich", "hart"}, {}),
        (
            "trial == 1 or environment == 'weich'",
            {"weich"},
            {"JND of stiffness in hart": "it needs repeated trials"},
        ),
        ("trial == 1", set(), {"JND of stiffness": "it needs repeated trials"}),
    ],
)
def test_what_has_no_jnd_is_named_with_the_reason(query, with_jnd, why):
    study = Study(repeated().query(query), Scene(inference={"method": "classical"}))
    measures = study.psychophysics
    assert set(measures[measures["measure"] == "jnd"]["environment"]) == with_jnd
    assert {what: said for what, said in reasons(study).items() if "JND" in what} == why


def test_an_sd_that_leads_beyond_the_doubles_has_no_upper_limit():
    adjusted = 10.0 * np.exp([-3.6, 3.6])
    table = pd.DataFrame({"subject": ["Ann", "Ben"], "k_ref": 10.0, "k_adj": adjusted})
    found = classical(table.assign(environment="VE1"), inference={"level": 0.99})
    (row,) = found[found["measure"] == "sd_subjects"].itertuples()
    sd = 7.2 / np.sqrt(2.0)
    assert row.estimate == pytest.approx(10.0 * np.expm1(sd))
    # One degree of freedom at 99 %: the SD is at most 5.09 * 159.6, whose e has no double.
    assert sd / np.sqrt(stats.chi2.ppf(0.005, 1)) > np.log(np.finfo(float).max)
    assert row.upper == np.inf
