"""Contrasts against SciPy's t-tests, and Pitman and Morgan's against the test they invert."""

import numpy as np
import pytest
from scipy import stats

from percept import RefusalError
from percept.inference.classical.contrasts import group_contrast, paired_contrast, spread_ratio
from percept.inference.classical.moments import Moments

CLAIM = {"level": 0.9, "share": 0.9, "confidence": 0.95}


def pairs(n=9, seed=1, slope=0.8):
    rng = np.random.default_rng(seed)
    first = rng.normal(1.0, 0.3, n)
    return first, slope * first + rng.normal(0.2, 0.4, n)


def test_the_mean_contrast_is_the_paired_t_test():
    first, second = pairs()
    found, p_value, d_z = paired_contrast(second - first, "mean", **CLAIM)
    test = stats.ttest_rel(second, first)
    expected = test.confidence_interval(0.9)
    np.testing.assert_allclose(
        [found.lower, found.upper], [expected.low, expected.high], rtol=1e-12
    )
    np.testing.assert_allclose(p_value, test.pvalue, rtol=1e-10)
    np.testing.assert_allclose(d_z, test.statistic / np.sqrt(len(first)), rtol=1e-12)


def test_the_contrast_of_groups_is_welch_s_t_test():
    first, second = np.arange(5.0) ** 2, np.array([3.0, 8.0, 4.0])
    found = group_contrast(Moments.from_values(first), Moments.from_values(second), level=0.9)
    test = stats.ttest_ind(second, first, equal_var=False)
    expected = test.confidence_interval(0.9)
    np.testing.assert_allclose(
        [found.lower, found.upper, found.p_value],
        [expected.low, expected.high, test.pvalue],
        rtol=1e-10,
    )


def test_equal_spreads_are_tested_by_the_correlation_of_sum_and_difference():
    first, second = pairs()
    found = spread_ratio(first, second, level=0.9)
    np.testing.assert_allclose(found.estimate, second.std(ddof=1) / first.std(ddof=1), rtol=1e-12)
    np.testing.assert_allclose(
        found.p_value, stats.pearsonr(first + second, second - first).pvalue, rtol=1e-10
    )


@pytest.mark.parametrize("slope", [0.8, -1.5, 40.0])
def test_limits_of_spread_are_ratios_that_the_test_just_rejects(slope):
    first, second = pairs(n=6, seed=4, slope=slope)
    found = spread_ratio(first, second, level=0.95)
    for end in (found.lower, found.upper):
        scaled = second / end
        assert stats.pearsonr(first + scaled, scaled - first).pvalue == pytest.approx(
            0.05, rel=1e-9
        )
    inverse = spread_ratio(second, first, level=0.95)
    np.testing.assert_allclose(
        [1.0 / inverse.upper, 1.0 / inverse.lower], [found.lower, found.upper]
    )


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ([1.0, 2.0], [1.0, 3.0], "fewer than three pairs"),
        ([1.0, 1.0, 1.0], [1.0, 3.0, 2.0], "all values of a condition are equal"),
        ([1.0, 2.0, 4.0], [2.0, 4.0, 8.0], "in proportion"),
        ([1.0, 2.0, 4.0], [-2.0, -4.0, -8.0], "in proportion"),
    ],
)
def test_pairs_without_a_ratio_are_refused(first, second, message):
    with pytest.raises(RefusalError, match=message):
        spread_ratio(np.array(first), np.array(second), level=0.9)


def test_subjects_who_differ_alike_have_no_interval():
    with pytest.raises(RefusalError, match="all differences are equal"):
        paired_contrast(np.array([0.5, 0.5, 0.5]), "mean", **CLAIM)
