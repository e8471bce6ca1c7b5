import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference import check_normality
from percept.inference.classical.moments import subject_means

TRIALS = np.array([3.0, 10.0, 5.0, 7.0, 12.0, 6.0])
WHO = np.array(["b", "a", "b", "c", "a", "b"])


def test_trials_are_averaged_in_the_order_of_subjects():
    assert subject_means(TRIALS, WHO) == pytest.approx([14 / 3, 11.0, 7.0], rel=1e-15)


def test_lognormal_averages_logarithms():
    found = subject_means(TRIALS, WHO, family="lognormal")
    assert found == pytest.approx([90 ** (1 / 3), np.sqrt(120.0), 7.0], rel=1e-14)


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
        (lambda: subject_means([], []), UsageError, "array is empty"),
        (
            lambda: subject_means([1.0, 0.0], [1, 2], family="lognormal"),
            RefusalError,
            "zero or negative",
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
