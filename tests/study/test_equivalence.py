"""Whether biases are smaller than one JND: verdicts against SciPy and against draws."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study
from percept.errors import UsageError
from tests.study.test_psychophysics import repeated
from tests.study.within import reasons


def judged(table, jnd, *, method="classical", family="normal", **tables):
    inference = {"method": method, "family": family, "tolerance": 0.3}
    return Study(table, Scene(study={"jnd": {"k": jnd}}, inference=inference, **tables))


def settings(centre, sd, subjects=6):
    """One environment with reference 8, in which subjects scatter about a centre."""
    quantiles = stats.norm.ppf((np.arange(subjects) + 0.5) / subjects)
    rows = [(f"S{i}", "A", 8.0, centre + sd * z) for i, z in enumerate(quantiles)]
    return pd.DataFrame(rows, columns=["subject", "environment", "k_ref", "k_adj"])


@pytest.mark.parametrize(
    ("centre", "sd", "outcome"),
    [
        (8.1, 0.2, "within"),
        (9.8, 0.2, "beyond"),
        (6.1, 0.2, "beyond"),
        (8.9, 0.5, "too little data"),
    ],
)
@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_the_three_outcomes_follow_the_interval(centre, sd, outcome, family):
    table = settings(centre, sd)
    values = table["k_adj"]
    low, high = 7.0, 9.0
    if family == "lognormal":
        values, low, high = np.log(values), np.log(low), np.log(high)
    (row,) = judged(table, 0.125, family=family).equivalence.itertuples()
    assert row.outcome == outcome
    above = stats.ttest_1samp(values, low, alternative="greater").pvalue
    below = stats.ttest_1samp(values, high, alternative="less").pvalue
    assert row.p_within == pytest.approx(max(above, below), rel=1e-9)
    # Of the tests that it is larger the smaller one, doubled.
    assert row.p_beyond == pytest.approx(min(1.0, 2.0 * (1.0 - max(above, below))), rel=1e-9)
    assert row.jnd == 1.0


def test_a_value_has_its_unit_and_a_fraction_its_reference():
    table = settings(8.1, 0.2)
    by_fraction = judged(table, 0.125).equivalence
    by_value = judged(table, "0.001 N/mm").equivalence
    pd.testing.assert_frame_equal(by_fraction, by_value)
    zero = table.assign(k_ref=0.0, k_adj=table["k_adj"] - 8.0)
    of_zero = judged(zero, "1 N/m").equivalence["p_within"]
    assert of_zero.item() == pytest.approx(by_value["p_within"].item(), rel=1e-9)
    study = judged(zero, 0.125)
    assert study.equivalence.empty
    why = reasons(study)["whether stiffness of A is within one JND"]
    assert why.startswith("a fraction of a reference")


def test_a_jnd_of_a_reference_has_no_lower_limit_of_positive_values():
    (row,) = judged(settings(8.1, 0.2), 1.0, family="lognormal").equivalence.itertuples()
    values = np.log(settings(8.1, 0.2)["k_adj"])
    p = stats.ttest_1samp(values, np.log(16.0), alternative="less").pvalue
    assert row.p_within == pytest.approx(p, rel=1e-9)


def assert_is_share(found, inside):
    """The probability is the share of draws inside, within both Monte Carlo errors."""
    error = np.sqrt(inside.mean() * (1.0 - inside.mean()) / inside.size)
    assert abs(found["probability"] - inside.mean()) < 5.0 * (error + found["error"])


def test_the_posterior_probability_is_the_share_of_draws_within():
    study = judged(repeated(), 0.05, method="bayesian")
    found = study.equivalence.set_index("environment")
    draws = study.posterior["posterior"]["population_mean"].sel(parameter="k")
    for name in ("weich", "hart"):
        inside = np.abs(draws.sel(environment=name).to_numpy() - 8.0) < 0.4
        assert_is_share(found.loc[name], inside)
    by_trials = judged(repeated(), "trials", method="both", family="lognormal")
    fit = by_trials.fit
    _, trial_sd = fit.model.scales(fit.points)["sigma_e"]
    means, _ = fit.model.draw(fit.points, np.random.default_rng(1))
    found = by_trials.equivalence.set_index("environment")
    assert set(found["method"]) == {"bayesian"}
    for j, name in enumerate(fit.environments):
        bias = np.abs(np.exp(means[:, j]) - 1.0)
        assert_is_share(found.loc[name], bias < np.expm1(trial_sd[:, 0, j]))
    why = reasons(by_trials)["classical verdict whether stiffness is within one JND"]
    assert "has an error that the tests do not know" in why


@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_under_the_reference_prior_the_posterior_is_the_t(family):
    table = settings(8.6, 0.7)
    model = {"pooling": "none", "prior": "reference"}
    study = judged(table, 0.125, method="bayesian", family=family, model=model)
    values, low, high = table["k_adj"], 7.0, 9.0
    if family == "lognormal":
        values, low, high = np.log(values), np.log(low), np.log(high)
    law = stats.t(5, values.mean(), stats.sem(values))
    (row,) = study.equivalence.itertuples()
    assert abs(row.probability - (law.cdf(high) - law.cdf(low))) < 4.0 * row.error


@pytest.mark.parametrize(
    ("jnd", "message"),
    [
        ({"k": "150"}, r'study\.jnd\.k = .150.: no positive amount .* Write it as "150 N/m"'),
        ({"k": "soft N/m"}, "no positive amount of stiffness"),
        ({"k": "3 kg"}, "not a unit of stiffness"),
        ({"z": 0.2}, "there is no such quantity; there are k, b"),
        ({"k": 0.0}, "must be a positive fraction of the reference"),
        ({"k": True}, "must be a positive fraction of the reference"),
    ],
)
def test_a_jnd_that_is_none_is_refused(jnd, message):
    with pytest.raises(UsageError, match=message):
        Scene(study={"jnd": jnd})


def test_subjects_who_adjusted_alike_have_no_verdict_and_a_reason():
    alike = settings(8.1, 0.2).assign(k_adj=8.1)
    study = judged(pd.concat([alike, settings(8.1, 0.2).assign(environment="B")]), 0.125)
    assert list(study.equivalence["environment"]) == ["B"]
    what = "classical verdict whether stiffness is within one JND in A"
    assert reasons(study)[what] == "all subjects made the same adjustments"
