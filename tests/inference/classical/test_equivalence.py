"""Two one-sided tests against SciPy, published power, and simulated studies at the edge."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, special, stats

from percept.errors import RefusalError, UsageError
from percept.inference.classical.contrasts import tost
from percept.inference.classical.fiducial import tost_power
from percept.inference.classical.moments import Moments


@pytest.mark.parametrize("shift", [-3.0, -0.4, 0.0, 0.9, 5.0])
def test_p_values_are_those_of_two_t_tests(shift):
    values = np.random.default_rng(5).normal(shift, 1.0, 7)
    found = tost(Moments.from_values(values), -1.5, 2.0)
    above = stats.ttest_1samp(values, -1.5, alternative="greater").pvalue
    below = stats.ttest_1samp(values, 2.0, alternative="less").pvalue
    assert found.p_within == pytest.approx(max(above, below), rel=1e-9)
    outside = min(
        stats.ttest_1samp(values, -1.5, alternative="less").pvalue,
        stats.ttest_1samp(values, 2.0, alternative="greater").pvalue,
    )
    assert found.p_beyond == pytest.approx(min(2.0 * outside, 1.0), rel=1e-9)
    # The same by the intervals of level 1 - 2 alpha and of level 1 - alpha.
    low, high = stats.ttest_1samp(values, 0.0).confidence_interval(0.9)
    assert (found.p_within <= 0.05) == (low > -1.5 and high < 2.0)
    low, high = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert (found.p_beyond <= 0.05) == (high < -1.5 or low > 2.0)


def test_a_limit_may_be_infinite_and_not_crossed():
    moments = Moments.from_values([1.0, 2.0, 4.0])
    found = tost(moments, -math.inf, 3.0)
    assert found.p_within == pytest.approx(
        stats.ttest_1samp([1.0, 2.0, 4.0], 3.0, alternative="less").pvalue, rel=1e-12
    )
    # Only one limit can be passed, so its p-value stands.
    assert found.p_beyond == pytest.approx(
        stats.ttest_1samp([1.0, 2.0, 4.0], 3.0, alternative="greater").pvalue, rel=1e-12
    )


def test_samples_without_scatter_are_refused():
    moments = Moments.from_values(np.array([[2.0, 2.0, 2.0], [1.0, 2.0, 4.0]]).T)
    with pytest.raises(RefusalError, match="All values of a sample are equal"):
        tost(moments, 1.0, 3.0)


@pytest.mark.parametrize(("df", "low", "high"), [(1, 3.0, 3.0), (4, 2.5, 6.0), (60, 2.0, 2.2)])
def test_power_is_an_integral_over_the_sample_sd(df, low, high):
    t = stats.t.isf(0.05, df)

    def integrand(w):
        density = stats.chi2.pdf(df * w * w, df) * 2.0 * df * w
        return density * max(special.ndtr(high - t * w) - special.ndtr(t * w - low), 0.0)

    twin, _ = integrate.quad(integrand, 0.0, (low + high) / (2 * t), epsabs=1e-13, limit=200)
    assert tost_power(low, high, df, size=0.05) == pytest.approx(twin, abs=1e-10)


def test_with_one_limit_power_is_a_noncentral_t():
    assert tost_power(5.0, math.inf, 9, size=0.05) == pytest.approx(
        stats.nct.sf(stats.t.isf(0.05, 9), 9, 5.0), rel=1e-10
    )
    assert tost_power(0.1, 0.1, 2, size=0.01) == pytest.approx(0.0, abs=1e-4)
    assert tost_power(math.inf, math.inf, 3, size=0.05) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("size", [0.0, 0.6, math.nan])
def test_a_size_out_of_range_is_refused(size):
    with pytest.raises(UsageError, match=r"the size must be above 0 and at most 0\.5"):
        tost_power(1.0, 1.0, 4, size=size)
