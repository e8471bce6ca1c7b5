import itertools

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.special import stdtrit

from percept.errors import RefusalError, UsageError
from percept.inference import (
    Moments,
    prediction_interval,
    t_interval,
    tolerance_interval,
)
from percept.inference.classical.intervals import factor_of_tails

KINDS = (t_interval, prediction_interval, tolerance_interval)
X = np.random.default_rng(10).lognormal(2.0, 0.3, 10)


@pytest.mark.parametrize("nu", [1, 2, 9, 29, 999, 10**6])
@pytest.mark.parametrize("level", [0.5, 0.99, 1.0 - 2.0**-13, 1.0 - 2.0**-30, 1.0 - 2.0**-50])
def test_t_keeps_its_digits_in_the_tail(nu, level):
    t = t_interval(Moments(0.0, 1.0, nu + 1), level=level).factor * np.sqrt(nu + 1)
    tail = (1.0 - level) / 2.0
    with mp.workdps(40):
        x, exact = mp.mpf(t), mp.mpf(tail)
        above = (
            mp.betainc(mp.mpf(nu) / 2, mp.mpf("0.5"), 0, nu / (nu + x * x), regularized=True) / 2
        )
        log_scale = (
            mp.loggamma(mp.mpf(nu + 1) / 2) - mp.loggamma(mp.mpf(nu) / 2) - mp.log(mp.pi * nu) / 2
        )
        density = mp.exp(log_scale - mp.mpf(nu + 1) / 2 * mp.log1p(x * x / nu))
        assert abs((above - exact) / (density * x)) <= 1e-14
    assert t == pytest.approx(stats.t.isf(tail, nu), rel=1e-15)


def test_half_widths_of_ten_subjects():
    for make, printed in zip(KINDS, ("1.02769", "3.40846", "4.43691"), strict=True):
        interval = make(X)
        assert f"{interval.factor:.5f}" == printed
        half = (interval.upper - interval.lower) / 2
        assert half == pytest.approx(interval.factor * interval.sd, rel=1e-14)
        assert (interval.upper + interval.lower) / 2 == pytest.approx(interval.mean, rel=1e-14)


@pytest.mark.parametrize("n", [2, 5, 30, 10**6, 10**9])
@pytest.mark.parametrize("level", [1e-12, 1e-3, 0.5, 0.99])
def test_the_expected_share_keeps_its_digits_near_zero(n, level):
    nu, t = n - 1, -stdtrit(n - 1.0, (1.0 - level) / 2.0)
    with mp.workdps(40):
        share = mp.mpf(t) ** 2 / (n + 1) / (nu + mp.mpf(t) ** 2 / (n + 1))
        exact = mp.betainc(0.5, mp.mpf(nu) / 2, 0, share, regularized=True)
    found = t_interval(Moments(0.0, 1.0, n), level=level).expected_share
    assert found == pytest.approx(float(exact), rel=2e-14)


@pytest.mark.parametrize("make", KINDS)
def test_lognormal_is_normal_on_the_log(make):
    log = make(np.log(X))
    interval = make(X, family="lognormal")
    assert (interval.lower, interval.upper) == pytest.approx(
        (np.exp(log.lower), np.exp(log.upper)), rel=1e-14
    )
    assert interval.estimate == pytest.approx(stats.gmean(X), rel=1e-14)
    assert interval.mean == pytest.approx(log.mean, rel=1e-15)


@pytest.mark.parametrize("make", KINDS)
@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_many_at_once_are_each_alone(make, family):
    x = np.random.default_rng(0).lognormal(0.0, 0.2, (2, 3, 600))
    options = {"level": 0.95, "family": family}
    together = make(x, **options)
    for i, j in itertools.product(range(2), range(3)):
        alone = make(x[i, j], **options)
        assert together.lower[i, j] == pytest.approx(alone.lower, rel=1e-14)
        assert together.upper[i, j] == pytest.approx(alone.upper, rel=1e-14)
    assert together.covers == alone.covers


@pytest.mark.parametrize("make", [t_interval, prediction_interval])
def test_bonferroni_halves_the_tail(make):
    assert make(X, level=0.75, joint="bonferroni").factor == make(X, level=0.875).factor


def test_bonferroni_halves_both_tails_of_a_share():
    wide = tolerance_interval(X, joint="bonferroni")
    assert wide.factor == factor_of_tails(10, (1 - 0.99) / 2, (1 - 0.95) / 2)
    assert (wide.share, wide.confidence) == (0.99, 0.95)


@pytest.mark.parametrize("make", KINDS)
def test_published_limits_under_lognormal_are_approximate(make):
    published = Moments.from_limits(944.85, 1017.2, 10)
    interval = make(published, family="lognormal")
    assert interval.approximate
    assert "moment matching" in interval.covers
    assert interval.estimate < published.mean < interval.upper
    assert not make(published).approximate


@pytest.mark.parametrize("make", KINDS)
@pytest.mark.parametrize(
    ("x", "options", "error", "message"),
    [
        ([2.0, 2.0, 2.0], {}, RefusalError, "same value: with no scatter"),
        ([[1.0, 2.0], [3.0, 3.0]], {}, RefusalError, r"first at index \[1\]"),
        ([1.0, 2.0], {"level": 1.0}, UsageError, "level must lie strictly between 0 and 1"),
        ([1.0, 2.0], {"level": [0.9, 0.99]}, UsageError, "level must be one number"),
        (
            [1.0, 2.0],
            {"family": "gamma"},
            UsageError,
            'family must be one of "normal", "lognormal"',
        ),
        (
            [1.0, 2.0],
            {"joint": "hotelling"},
            UsageError,
            'joint must be one of "marginal", "bonferroni"',
        ),
        (Moments(0.0, 1.0, 5, scale="log"), {}, UsageError, "moments of logarithms"),
    ],
)
def test_what_is_wrong_is_said(make, x, options, error, message):
    with pytest.raises(error, match=message):
        make(x, **options)


@pytest.mark.parametrize("name", ["share", "confidence"])
def test_a_share_and_its_confidence_are_one_number_each(name):
    with pytest.raises(UsageError, match=f"{name} must be one number"):
        tolerance_interval(X, **{name: [0.8, 0.9]})


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.integers(-1000, 1000), min_size=2, max_size=12).filter(
        lambda values: len(set(values)) > 1
    ),
    st.integers(-60, 60),
    st.integers(-(10**6), 10**6),
)
def test_a_change_of_unit_and_origin_changes_nothing_else(values, power, origin):
    x = np.array(values, dtype=float)
    for make in KINDS:
        plain = make(x)
        scaled = make(x * 2.0**power)
        shifted = make(x + origin)
        turned = make(-x)
        assert scaled.lower == plain.lower * 2.0**power
        assert shifted.sd == pytest.approx(plain.sd, rel=4 * np.finfo(float).eps)
        assert (turned.lower, turned.upper) == (-plain.upper, -plain.lower)
        assert plain.lower < plain.mean < plain.upper
    assert t_interval(x).upper < prediction_interval(x).upper
