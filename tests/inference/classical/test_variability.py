"""Reliability, SDs and correlations against published tables, SciPy, mpmath and slow twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from percept.inference.classical.variability import (
    component_sd,
    correlation,
    icc_one_way,
    mean_squares,
    sd_interval,
    trial_mean_squares,
)


@pytest.mark.parametrize("counts", [(2, 2), (3, 2, 4), (5, 5, 5, 5)])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_reliability_is_that_of_scipys_one_way_f(counts, offset):
    rng = np.random.default_rng(len(counts))
    groups = [rng.normal(size=count) + rng.normal() for count in counts]
    groups = [group + offset for group in groups]
    means = np.array([group.mean() for group in groups])
    within = sum(np.square(group - group.mean()).sum() for group in groups)
    trial_sd = math.sqrt(within / (sum(counts) - len(counts)))
    squares = trial_mean_squares(means, np.array(counts, float), trial_sd)
    found = icc_one_way(squares, level=0.9)
    df = (len(counts) - 1, sum(counts) - len(counts))
    k = (sum(counts) - sum(count**2 for count in counts) / sum(counts)) / df[0]
    f = stats.f_oneway(*groups).statistic
    at = [f, f / stats.f.isf(0.05, *df), f / stats.f.ppf(0.05, *df)]
    twin = [(ratio - 1.0) / (ratio + k - 1.0) for ratio in at]
    # The offset itself rounds the data to 1e-10.
    near = {"rel": 1e-9} if offset == 0.0 else {"rel": 1e-6}
    assert (found.estimate, found.lower, found.upper) == pytest.approx(twin, **near)


def test_an_sd_is_bounded_by_chi_square_as_scipy_has_it():
    found = sd_interval(2.5, 9, level=0.99)
    ends = 2.5 * np.sqrt(9 / stats.chi2.isf([0.005, 0.995], 9))
    assert (found.lower, found.upper) == pytest.approx(tuple(ends), rel=1e-11)
    one = sd_interval(1.0, 1, level=0.999999)
    mp = pytest.importorskip("mpmath")
    with mp.workdps(40):
        # One degree of freedom: χ² is the square of a normal.
        z = mp.sqrt(2) * mp.erfinv(mp.mpf(0.5e-6))
        assert one.upper == pytest.approx(float(1 / z), rel=1e-9)


def test_unequal_counts_of_trials_have_an_effective_number():
    values = np.array([1.0, 2.0, 4.0, 4.5, 5.0, 9.0])
    who = np.array(["a", "a", "b", "b", "b", "c"])
    groups = [values[who == name] for name in "abc"]
    means = np.array([group.mean() for group in groups])
    within = sum(np.square(group - group.mean()).sum() for group in groups) / 3
    squares = trial_mean_squares(means, np.array([2.0, 3.0, 1.0]), np.sqrt(within))
    assert squares.ratio == pytest.approx(stats.f_oneway(*groups).statistic, rel=1e-12)
    assert squares.k == pytest.approx((6 - 14 / 6) / 2)
    assert squares.error_df == 3


def test_the_between_subject_component_covers_at_about_its_level():
    rng = np.random.default_rng(11)
    studies = 2000
    sigma_u = 0.6
    held = 0
    for _ in range(studies):
        table = sigma_u * rng.normal(size=(8, 1)) + rng.normal(size=(8, 4))
        found = component_sd(mean_squares(table), level=0.9)
        held += found.lower <= sigma_u <= found.upper
    error = math.sqrt(0.9 * 0.1 / studies)
    assert abs(held / studies - 0.9) < 4 * error
    flat = component_sd(mean_squares(np.array([[1.0, 2.0], [2.0, 1.0]])), level=0.9)
    assert (flat.estimate, flat.lower) == (0.0, 0.0)


def test_a_correlation_is_bounded_as_scipy_bounds_it():
    rng = np.random.default_rng(2)
    pairs = rng.normal(size=(9, 2)) @ np.array([[1.0, 0.7], [0.0, 0.6]])
    found = correlation(pairs, level=0.95)
    twin = stats.pearsonr(*pairs.T)
    ends = twin.confidence_interval(0.95)
    assert (found.estimate, found.lower, found.upper) == pytest.approx(
        (twin.statistic, ends.low, ends.high), rel=1e-12
    )
    few = correlation(pairs[:3], level=0.95)
    assert (few.lower, few.upper) == (-1.0, 1.0)
    line = correlation(np.array([[1.0, 2.0], [2.0, 4.0], [3.0, 6.0], [4.0, 8.0]]), level=0.9)
    assert line.estimate == pytest.approx(1.0)


def test_what_has_no_reliability_is_refused():
    with pytest.raises(RefusalError, match="A table of 1 by 3 has no mean squares"):
        mean_squares(np.ones((1, 3)))
    with pytest.raises(RefusalError, match="All values of the table are equal"):
        mean_squares(np.ones((3, 3)))
    with pytest.raises(RefusalError, match="do not differ between subjects"):
        correlation(np.ones((4, 2)), level=0.9)
    alike = icc_one_way(mean_squares(np.array([[1.0, 2.0], [2.0, 3.0]])), level=0.9)
    assert (alike.estimate, alike.lower, alike.upper) == (1.0, 1.0, 1.0)
