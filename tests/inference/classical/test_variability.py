"""Reliability, SDs and correlations against published tables, SciPy, mpmath and slow twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from percept.inference.classical.trials import subject_means
from percept.inference.classical.variability import (
    component_sd,
    correlation,
    icc_agreement,
    icc_consistency,
    mean_squares,
    sd_interval,
    trial_mean_squares,
)


def slow_agreement_limits(table, level):
    """McGraw and Wong (1996), Table 7, case ICC(A,1), letter by letter, by SciPy's F."""
    n, k = table.shape
    grand = table.mean()
    msr = k * sum((row.mean() - grand) ** 2 for row in table) / (n - 1)
    msc = n * sum((column.mean() - grand) ** 2 for column in table.T) / (k - 1)
    total = ((table - grand) ** 2).sum()
    mse = (total - msr * (n - 1) - msc * (k - 1)) / ((n - 1) * (k - 1))
    r = (msr - mse) / (msr + (k - 1) * mse + k / n * (msc - mse))
    a = k * max(r, 0) / (n * (1 - r))
    b = 1 + k * max(r, 0) * (n - 1) / (n * (1 - r))
    v = (a * msc + b * mse) ** 2 / ((a * msc) ** 2 / (k - 1) + (b * mse) ** 2 / ((n - 1) * (k - 1)))
    tail = (1 - level) / 2
    f1 = stats.f.isf(tail, n - 1, v)
    f2 = stats.f.isf(tail, v, n - 1)
    lower = n * (msr - f1 * mse) / (f1 * (k * msc + (k * n - k - n) * mse) + n * msr)
    upper = n * (f2 * msr - mse) / (k * msc + (k * n - k - n) * mse + n * f2 * msr)
    return r, lower, upper


@pytest.mark.parametrize("shape", [(2, 2), (3, 2), (4, 5), (12, 3)])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_agreement_and_consistency_equal_slow_twins(shape, offset):
    rng = np.random.default_rng(shape[0])
    table = rng.normal(size=shape) + rng.normal(size=(shape[0], 1)) + rng.normal(size=shape[1])
    squares = mean_squares(table + offset)
    found = icc_agreement(squares, level=0.9)
    # The offset itself rounds the data to 1e-10.
    near = {"rel": 1e-9, "abs": 1e-12} if offset == 0.0 else {"rel": 1e-6}
    assert (found.estimate, found.lower, found.upper) == pytest.approx(
        slow_agreement_limits(table, 0.9), **near
    )
    found = icc_consistency(squares, level=0.9)
    df = (shape[0] - 1, (shape[0] - 1) * (shape[1] - 1))
    at = [
        squares.ratio,
        squares.ratio / stats.f.isf(0.05, *df),
        squares.ratio / stats.f.ppf(0.05, *df),
    ]
    twin = [(f - 1.0) / (f + shape[1] - 1.0) for f in at]
    assert (found.estimate, found.lower, found.upper) == pytest.approx(twin, rel=1e-9)


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
    found = subject_means(values, who)
    squares = trial_mean_squares(found.values, np.array([2.0, 3.0, 1.0]), found.trial_sd)
    groups = [values[who == name] for name in "abc"]
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
    same = icc_agreement(mean_squares(np.array([[1.0, 1.0], [2.0, 2.0]])), level=0.9)
    assert (same.estimate, same.lower) == (1.0, 1.0)
    alike = icc_consistency(mean_squares(np.array([[1.0, 2.0], [2.0, 3.0]])), level=0.9)
    assert (alike.estimate, alike.lower, alike.upper) == (1.0, 1.0, 1.0)
