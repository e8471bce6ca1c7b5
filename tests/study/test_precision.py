"""Ratios of SDs between trials: against SciPy's tests of log SDs, and what lacks them."""

import itertools

import numpy as np
import pytest
from scipy import integrate, stats

from percept import UsageError
from tests.fits import SHARED
from tests.study.within import frame, reasons, study

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
    rows = [row for row in made.contrast_rows if row.of == "precision"]
    return {row.environment: row for row in rows}


def log_sds(table):
    """Each subject's log SD in every cell without its bias, from the law of χ by quadrature."""

    def bias(df):
        law = stats.chi(df, scale=df**-0.5)
        return integrate.quad(lambda x: np.log(x) * law.pdf(x), 0.0, np.inf)[0]

    values = np.log(table["k_adj"] / table["k_ref"])
    cells = values.groupby([table["subject"], table["hand"], table["environment"]])
    unbiased = np.log(cells.std()) - cells.count().map(lambda count: bias(count - 1))
    return unbiased.unstack(["hand", "environment"])


def test_conditions_are_compared_by_the_paired_t_test_of_unbiased_log_sds():
    """With other numbers of trials at the levels, log SDs are biased unequally."""
    table = planted(1)
    table = table[(table["hand"] == "left") | (table["trial"] < 4)]
    rows = precision_of(opened(table))
    wide = log_sds(table)
    for environment in ("VE1", "VE2", None):
        columns = slice(None) if environment is None else [environment]
        left, right = (wide[level][columns].mean(axis=1) for level in ("left", "right"))
        test = stats.ttest_rel(right, left)
        interval = test.confidence_interval(0.95)
        row = rows[environment]
        ends = [interval.low, (right - left).mean(), interval.high]
        assert np.log([row.lower, row.estimate, row.upper]) == pytest.approx(ends, rel=1e-7)
        assert (row.p_value, row.n, row.unit) == (pytest.approx(test.pvalue, rel=1e-7), 8, "")
    assert set(rows) == {"VE1", "VE2", None}


def test_groups_are_compared_by_welch_s_test_of_unbiased_log_sds():
    table = planted(2, apart=True)
    wide = log_sds(table)
    left, right = (wide[level].mean(axis=1).dropna() for level in ("left", "right"))
    test = stats.ttest_ind(right, left, equal_var=False)
    interval = test.confidence_interval(0.95)
    row = precision_of(opened(table))[None]
    assert np.log([row.lower, row.upper]) == pytest.approx([interval.low, interval.high], rel=1e-7)
    assert row.p_value == pytest.approx(test.pvalue, rel=1e-7)


def test_what_has_no_ratio_is_named():
    table = planted(3, subjects=6)
    first = (table["subject"] == "S2") & (table["hand"] == "left") & (table["environment"] == "VE1")
    table.loc[first, "k_adj"] = 11.0
    table = table[(table["environment"] == "VE1") | (table["trial"] == 1)]
    made = opened(table)
    rows = precision_of(made)
    assert list(rows) == ["VE1"]
    assert rows["VE1"].n == 5
    why = reasons(made)
    assert why["S2 in the precision of stiffness"] == (
        "all trials in VE1 (left) are equal, and zero has no logarithm"
    )
    what = "contrast of precision of stiffness, right against left, in VE2"
    once = opened(table[table["trial"] == 1])
    assert not precision_of(once)
    why = reasons(once)
    assert why[what.replace("VE2", "VE1, VE2")] == "there are no repeated trials at all its levels"
    fit = opened(table, **FITTED)
    rows = [row for row in fit.contrast_rows if row.of == "precision"]
    assert [(row.environment, row.method) for row in rows] == [
        ("VE1", "classical"),
        ("VE1", "bayesian"),
    ]
    assert all(row.lower < RATIO < row.upper for row in rows)
    why = reasons(fit)
    assert why[what] == "there are no repeated trials at all its levels"


def test_only_factors_of_the_model_have_a_precision():
    with pytest.raises(UsageError, match=r"model\.precision.*foot.*no factor of the model"):
        list(opened(planted(1), precision="foot").contrast_rows)


@pytest.fixture(scope="module")
def with_pairs():
    return opened(frame(subjects=6), None, level=0.9, **(FITTED | {"kinds": ["mean", "user"]}))


def test_probabilities_and_d_z_are_those_of_draws(with_pairs):
    """Of the average and the next user, drawn from the posterior."""
    fit = with_pairs.fit
    rows = np.array([own.row for own in fit.contrasts if own.comparison.is_of_users])
    points = fit.run.points.reshape(-1, fit.run.points.shape[-1])
    averages, users = fit.model.draw(points, np.random.default_rng(1), rows)
    sds = fit.model.user_sds(points, rows)
    found = [row for row in with_pairs.contrast_rows if row.method == "bayesian" and row.kind]
    names = ["mean", "user"]
    for index, (kind, row) in enumerate(itertools.product(names, range(rows.shape[0]))):
        drawn = (averages if kind == "mean" else users)[:, row]
        assert found[index].kind == kind
        assert found[index].probability_above == pytest.approx((drawn > 0.0).mean(), abs=0.01)
        d_z = np.median(averages[:, row] / sds[:, row]) if kind == "mean" else None
        assert found[index].d_z == (d_z if d_z is None else pytest.approx(d_z, abs=0.03))
