import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference import check_normality, t_interval
from percept.inference.classical.trials import subject_means

TRIALS = np.array([3.0, 10.0, 5.0, 7.0, 12.0, 6.0])
WHO = np.array(["b", "a", "b", "c", "a", "b"])


def test_n_is_subjects_each_counting_once():
    found = subject_means(TRIALS, WHO)
    assert found.values == pytest.approx([14 / 3, 11.0, 7.0], rel=1e-15)
    interval = t_interval(found.moments())
    assert interval.n == 3
    assert interval.repeats
    assert interval.mean == pytest.approx((14 / 3 + 11 + 7) / 3, rel=1e-15)


def test_lognormal_averages_logarithms():
    found = subject_means(TRIALS, WHO, family="lognormal")
    assert found.values == pytest.approx([90 ** (1 / 3), np.sqrt(120.0), 7.0], rel=1e-14)
    assert found.moments().scale == "log"
    assert found.moments().mean == pytest.approx(np.log(found.values).mean(), rel=1e-14)


def test_one_trial_each_has_no_sd_between_trials():
    found = subject_means([1.0, 2.0, 4.0], [3, 1, 2])
    assert found.trial_sd is None
    assert found.moments().repeats is False


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


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: subject_means(TRIALS, WHO[:5]),
            UsageError,
            r"One subject per trial .* \(6,\) and \(5,\)",
        ),
        (lambda: subject_means([], []), UsageError, "array is empty"),
        (
            lambda: subject_means([1.0, 2.0], [np.nan, 1.0]),
            UsageError,
            "every trial needs a subject",
        ),
        (lambda: subject_means([1.0, 2.0], [None, "a"]), UsageError, "every trial needs a subject"),
        (
            lambda: subject_means([1.0, 0.0], [1, 2], family="lognormal"),
            RefusalError,
            "zero or negative",
        ),
        (lambda: subject_means(TRIALS, WHO, family="free"), UsageError, '"normal", "lognormal"'),
        (
            lambda: subject_means([1.0, 2.0], ["a", "a"]).moments(),
            RefusalError,
            "At least 2 subjects",
        ),
        (lambda: check_normality(X[:2]), RefusalError, "At least 3 subjects"),
        (lambda: check_normality(np.arange(5001.0)), RefusalError, "up to n = 5000; here n = 5001"),
        (lambda: check_normality([1.0, 1.0, 1.0]), RefusalError, "no distribution to test"),
        (lambda: check_normality([X, X]), UsageError, "One sample at a time"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
