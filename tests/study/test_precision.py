"""Ratios of SDs between trials: against SciPy's tests of log SDs, and what lacks them."""

from functools import cache

import numpy as np
import pytest
from scipy import integrate, stats

from percept import UsageError
from tests.fits import SHARED
from tests.study.within import ends_of, frame, only, reasons, study

RATIO = 1.5
FITTED = {"method": "both", "tolerance": 0.3, "kinds": ["mean"]}


def planted(seed, *, subjects=8, trials=5, apart=False):
    """Trials whose SD is 1.5 times as large at the second level; `apart` gives each subject one."""
    table = frame(subjects, trials, seed=seed, sds=(0.1, 0.1 * RATIO))
    table = table[table["environment"] != "VE3"]
    if apart:
        is_odd = table["subject"].str[1:].astype(int) % 2 == 1
        table = table[is_odd == (table["hand"] == "right")]
    return table


def opened(table, precision="hand", **inference):
    return study(table, store=SHARED, model={"precision": precision}, inference=inference)


def precision_of(made):
    return made.contrasts.query("of == 'precision'")


@cache
def bias(df):
    """Of a log SD, from the law of χ by quadrature."""
    law = stats.chi(df, scale=df**-0.5)
    return integrate.quad(lambda x: np.log(x) * law.pdf(x), 0.0, np.inf)[0]


def log_sds(table):
    """Each subject's log SD in every cell without its bias."""
    values = np.log(table["k_adj"] / table["k_ref"])
    cells = values.groupby([table["subject"], table["hand"], table["environment"]])
    unbiased = np.log(cells.std()) - cells.count().map(lambda count: bias(count - 1))
    return unbiased.unstack(["hand", "environment"])


@pytest.mark.parametrize("environment", ["VE1", "VE2", None])
def test_conditions_are_compared_by_the_paired_t_test_of_unbiased_log_sds(environment):
    """With other numbers of trials at the levels, log SDs are biased unequally."""
    table = planted(1).query("hand == 'left' or trial < 4")
    wide = log_sds(table)
    columns = slice(None) if environment is None else [environment]
    left, right = (wide[level][columns].mean(axis=1) for level in ("left", "right"))
    test = stats.ttest_rel(right, left)
    interval = test.confidence_interval(0.95)
    row = only(precision_of(opened(table)), environment=environment)
    ends = [interval.low, (right - left).mean(), interval.high]
    assert np.log(ends_of(row)) == pytest.approx(ends, rel=1e-7)
    assert (row["p_value"], row["n"], row["unit"]) == (pytest.approx(test.pvalue, rel=1e-7), 8, "")


def test_groups_are_compared_by_welch_s_test_of_unbiased_log_sds():
    table = planted(2, apart=True)
    wide = log_sds(table)
    left, right = (wide[level].mean(axis=1).dropna() for level in ("left", "right"))
    test = stats.ttest_ind(right, left, equal_var=False)
    interval = test.confidence_interval(0.95)
    row = only(precision_of(opened(table)), environment=None)
    ends = [interval.low, right.mean() - left.mean(), interval.high]
    assert np.log(ends_of(row)) == pytest.approx(ends, rel=1e-7)
    assert row["p_value"] == pytest.approx(test.pvalue, rel=1e-7)


def test_what_has_no_ratio_is_named():
    table = planted(3, subjects=6)
    steady = table.eval("subject == 'S2' and hand == 'left' and environment == 'VE1'")
    table.loc[steady, "k_adj"] = 11.0
    table = table.query("environment == 'VE1' or trial == 1")
    fit = opened(table, **FITTED)
    found = precision_of(fit)
    assert found["environment"].tolist() == ["VE1", "VE1"]
    assert found["method"].tolist() == ["classical", "bayesian"]
    assert only(found, method="classical")["n"] == 5
    assert ((found["lower"] < RATIO) & (found["upper"] > RATIO)).all()
    why = reasons(fit)
    equal = "all trials in VE1 (left) are equal, and zero has no logarithm"
    assert why["S2 in the precision of stiffness"] == equal
    what = "contrast of precision of stiffness, right against left, in {}"
    once = opened(table[table["trial"] == 1])
    assert precision_of(once).empty
    for made, where in ((fit, "VE2"), (once, "VE1, VE2")):
        there = "there are no repeated trials at all its levels"
        assert reasons(made)[what.format(where)] == there


def test_only_factors_of_the_model_have_a_precision():
    with pytest.raises(UsageError, match=r"model\.precision.*foot.*no factor of the model"):
        list(opened(planted(1), precision="foot").contrast_rows)


def test_probabilities_and_d_z_are_those_of_draws():
    """Of the average and the next user, drawn from the posterior."""
    made = opened(frame(subjects=6), None, level=0.9, **(FITTED | {"kinds": ["mean", "user"]}))
    fit = made.fit
    rows = np.array([own.row for own in fit.contrasts if own.is_of_users])
    points = fit.run.points.reshape(-1, fit.run.points.shape[-1])
    averages, users = fit.model.draw(points, np.random.default_rng(1), rows)
    d_z = np.median(averages / fit.model.moments(points, rows).population_sd, axis=0)
    found = made.contrasts.query("method == 'bayesian'")
    for kind, drawn in {"mean": averages, "user": users}.items():
        of_kind = found[found["kind"] == kind]
        above = (drawn > 0.0).mean(axis=0)
        np.testing.assert_allclose(of_kind["probability_above"], above, atol=0.01)
    np.testing.assert_allclose(found.query("kind == 'mean'")["d_z"], d_z, atol=0.03)
    assert found.query("kind == 'user'")["d_z"].isna().all()
