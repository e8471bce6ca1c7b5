import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference import Moments, coefficient_of_variation, weber_fraction

STUDIES = 3000


@pytest.mark.parametrize(("n", "cv"), [(3, 0.3), (10, 0.05), (10, 0.9), (30, 0.2)])
@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_the_interval_of_the_cv_covers(n, cv, family):
    random = np.random.default_rng(n)
    level = 0.9
    if family == "lognormal":
        x = random.lognormal(1.0, np.sqrt(np.log1p(cv**2)), (STUDIES, n))
    else:
        x = random.normal(1.0, cv, (STUDIES, n))
        x = x[x.mean(axis=1) > 0]
    found = coefficient_of_variation(x, level=level, family=family)
    # a sample of mean zero or below is refused: it counts as missed from below, which has its own tail
    high = np.count_nonzero(found.upper < cv) / STUDIES
    low = np.count_nonzero(found.lower > cv) / STUDIES + (STUDIES - len(x)) / STUDIES
    error = 4 * np.sqrt(0.05 * 0.95 / STUDIES)
    assert abs(high - 0.05) <= error
    assert abs(low - 0.05) <= error


def test_the_limits_invert_the_noncentral_t():
    found = coefficient_of_variation(Moments(10.0, 2.0, 12), level=0.95)
    t = np.sqrt(12) * 5.0
    assert stats.nct.sf(t, 11, np.sqrt(12) / found.upper) == pytest.approx(0.025, rel=1e-6)
    assert stats.nct.cdf(t, 11, np.sqrt(12) / found.lower) == pytest.approx(0.025, rel=1e-6)
    assert found.estimate == 0.2


@pytest.mark.parametrize("ratio", [1.6, 2.0, 3.0])
def test_the_lower_limit_of_two_subjects_inverts_the_noncentral_t(ratio):
    found = coefficient_of_variation(Moments(ratio, 1.0, 2), level=0.9)
    tail = stats.nct.cdf(ratio * np.sqrt(2), 1, np.sqrt(2) / found.lower)
    assert tail == pytest.approx(0.05, rel=1e-8)


def test_a_mean_that_may_be_zero_bounds_no_cv():
    found = coefficient_of_variation(Moments([1.0, 10.0], [1.0, 1.0], 4))
    assert found.upper[0] == np.inf
    assert np.isfinite(found.upper[1])
    # the t-interval of the first holds zero: the same statement
    assert stats.t.isf(0.005, 3) > 2.0


def test_published_figures_of_table_1():
    found = coefficient_of_variation(Moments([14.914, 0.68455], [3.9954, 0.63147], 10))
    assert found.estimate == pytest.approx([0.27, 0.92], abs=0.005)


def test_lognormal_and_weber_are_chi_square():
    x = np.random.default_rng(1).lognormal(2.0, 0.2, 15)
    sigma = np.log(x).std(ddof=1)
    ends = sigma * np.sqrt(14 / stats.chi2.isf([0.005, 0.995], 14))
    found = coefficient_of_variation(x, family="lognormal")
    assert (found.lower, found.upper) == pytest.approx(tuple(np.sqrt(np.expm1(ends**2))), rel=1e-11)
    weber = weber_fraction(x, 8.0)
    ends = x.std(ddof=1) * np.sqrt(14 / stats.chi2.isf([0.005, 0.995], 14)) / 8.0
    assert (weber.lower, weber.upper) == pytest.approx(tuple(ends), rel=1e-11)
    assert weber.estimate == pytest.approx(x.std(ddof=1) / 8.0, rel=1e-14)


def test_sentences():
    assert "fraction of their average lies between" in coefficient_of_variation([1.0, 2.0, 4.0]).covers
    assert "fraction of the reference lies between" in weber_fraction([1.0, 2.0, 4.0], 2.0).covers


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: coefficient_of_variation([-1.0, 0.5]), RefusalError, "needs a positive mean"),
        (lambda: coefficient_of_variation(Moments(0.0, 1.0, 5)), RefusalError, "needs a positive mean"),
        (lambda: coefficient_of_variation([1.0, 1.0]), RefusalError, "no scatter"),
        (lambda: coefficient_of_variation([1.0, 2.0], family="free"), UsageError, '"normal" or "lognormal"'),
        (lambda: weber_fraction([1.0, 2.0], -1.0), RefusalError, "has no ratio"),
        (
            lambda: weber_fraction(Moments.from_weighted([1.0, 2.0], [1.0, 2.0]), 1.0),
            UsageError,
            "single users",
        ),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
