import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference import check_normality, influence, prediction_interval, t_interval, tolerance_interval

X = np.append(np.random.default_rng(7).normal(10.0, 1.0, 11), 16.0)


def test_normality_is_shapiros_and_does_not_mind_an_offset():
    reference = stats.shapiro(X)
    for values in (X, X * 1e-200, X * 2.0**40 + 2.0**40):
        found = check_normality(values)
        assert found.statistic == pytest.approx(reference.statistic, rel=1e-6)
        assert found.p_value == pytest.approx(reference.pvalue, rel=1e-4)
    assert found.p_value < 0.05
    log = check_normality(X, family="lognormal")
    assert log.statistic == pytest.approx(stats.shapiro(np.log(X)).statistic, rel=1e-10)


def test_normality_rejects_as_often_as_it_says():
    random = np.random.default_rng(17)
    studies, alpha = 2000, 0.1
    rate = np.mean([check_normality(random.normal(size=10)).p_value < alpha for _ in range(studies)])
    assert abs(rate - alpha) <= 4 * np.sqrt(alpha * (1 - alpha) / studies)


@pytest.mark.parametrize(
    ("kind", "make"), [("mean", t_interval), ("user", prediction_interval), ("share", tolerance_interval)]
)
@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_influence_is_leaving_each_out(kind, make, family):
    found = influence(X, kind=kind, level=0.95, family=family)
    for i in range(X.size):
        without = make(np.delete(X, i), level=0.95, family=family)
        assert found.lower[i] == pytest.approx(without.lower, rel=1e-12)
        assert found.upper[i] == pytest.approx(without.upper, rel=1e-12)
    scale = np.log if family == "lognormal" else np.asarray
    whole = make(X, level=0.95, family=family)
    half = (scale(whole.upper) - scale(whole.lower)) / 2
    assert found.upper_shift == pytest.approx((scale(found.upper) - scale(whole.upper)) / half, abs=1e-12)
    assert found.most == 11


def test_influence_of_every_one_of_many_subjects():
    x = np.random.default_rng(9).normal(10.0, 1.0, 1500)
    found = influence(x)
    n = x.size - 1
    mean = (x.sum() - x) / n
    sd = np.sqrt(((x**2).sum() - x**2 - n * mean**2) / (n - 1))
    half = stats.t.isf(0.005, n - 1) * sd / np.sqrt(n)
    # Sums of squares a hundred times the variance cost two digits, sums over 1500 values as many.
    np.testing.assert_allclose(found.lower, mean - half, rtol=1e-12)
    np.testing.assert_allclose(found.upper, mean + half, rtol=1e-12)


def test_influence_does_not_mind_an_offset():
    near, far = influence(np.round(X * 8)), influence(np.round(X * 8) + 1e15)
    assert far.lower_shift == pytest.approx(near.lower_shift, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: check_normality(X[:2]), RefusalError, "At least 3 subjects"),
        (lambda: check_normality(np.arange(5001.0)), RefusalError, "up to n = 5000; here n = 5001"),
        (lambda: check_normality([1.0, 1.0, 1.0]), RefusalError, "no distribution to test"),
        (lambda: check_normality([X, X]), UsageError, "One sample at a time"),
        (lambda: influence(X, kind="all"), UsageError, 'kind must be "mean"'),
        (lambda: influence([1.0, 1.0, 2.0]), RefusalError, r"first at index \[2\]"),
        (lambda: influence(-X, family="lognormal"), RefusalError, "zero or negative"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
