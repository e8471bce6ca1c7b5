import math
from decimal import Decimal
from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from percept.errors import RefusalError, UsageError
from percept.inference import Moments, t_interval
from percept.inference.classical.moments import mean_and_sd

# Table 1: limits as printed, n = 10, 99 %, and the mean and SD they come from
TABLE = [
    ("10.808", "19.02", 14.914, 3.9954),
    ("0.0356", "1.3335", 0.68455, 0.63147),
    ("944.85", "1017.2", 981.03, 35.200),
    ("1.2404", "1.5316", 1.3860, 0.14168),
    ("8979.9", "9954.1", 9467.0, 473.98),
    ("8.188", "13.146", 10.667, 2.4122),
    ("23316", "24968", 24142.0, 803.75),
    ("21.447", "27.549", 24.498, 2.9688),
    ("39498", "47829", 43664.0, 4053.3),
    ("79.933", "112.34", 96.137, 15.767),
]


@pytest.mark.parametrize(("lower", "upper", "mean", "sd"), TABLE)
def test_published_limits_come_back_to_the_printed_digits(lower, upper, mean, sd):
    moments = Moments.from_limits(float(lower), float(upper), 10)
    assert moments.mean == pytest.approx(mean, rel=3e-5)
    assert moments.sd == pytest.approx(sd, rel=3e-5)
    again = t_interval(moments)
    for text, value in ((lower, again.lower), (upper, again.upper)):
        digits = -Decimal(text).as_tuple().exponent
        assert f"{value:.{digits}f}" == text


def test_moment_matching_gives_back_mean_and_sd():
    matched = Moments(981.03, 35.2, 10).on_scale("lognormal")
    with mp.workdps(30):
        mu, variance = mp.mpf(matched.mean), mp.mpf(matched.sd) ** 2
        assert float(mp.exp(mu + variance / 2)) == pytest.approx(981.03, rel=1e-14)
        assert float(mp.exp(mu + variance / 2) * mp.sqrt(mp.expm1(variance))) == pytest.approx(
            35.2, rel=1e-13
        )


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: Moments.from_values([]), UsageError, "array is empty"),
        (
            lambda: Moments.from_values([1.0]),
            RefusalError,
            "At least 2 subjects are needed; there is 1",
        ),
        (
            lambda: Moments.from_values([[1.0, 2.0, np.nan], [np.inf, 1.0, 2.0]]),
            UsageError,
            r"nan: .* index \[0, 2\]",
        ),
        (lambda: Moments.from_values([[1.0, 2.0], [1.0]]), UsageError, "unequal length"),
        (
            lambda: Moments.from_values([1j, 2.0]),
            UsageError,
            "must be real numbers; their type is complex",
        ),
        (lambda: Moments.from_values(3.0), UsageError, "not a single number"),
        (lambda: Moments.from_values([1.0, 0.0], log=True), RefusalError, "zero or negative"),
        (lambda: Moments(1.0, -1.0, 5), UsageError, "cannot be negative"),
        (lambda: Moments(1.0, 1.0, 5.5), UsageError, "must be whole"),
        (lambda: Moments(1.0, 1.0, 1), RefusalError, "At least 2 subjects"),
        (lambda: Moments(np.ones(2), np.ones(3), 5), UsageError, "shapes that do not fit"),
        (
            lambda: Moments.from_limits(2.0, 1.0, 5),
            UsageError,
            "value 2.0: A lower limit lies above",
        ),
        (
            lambda: Moments.from_limits(1.0, 2.0, 5, level=99),
            UsageError,
            "99 percent is written 0.99",
        ),
        (lambda: Moments(-1.0, 1.0, 5).on_scale("lognormal"), RefusalError, "positive mean"),
        (
            lambda: Moments(1.0, 1.0, 5, scale="Log"),
            UsageError,
            r"value 'Log': scale must be one of .linear., .log.",
        ),
        (
            lambda: Moments.from_values(np.ma.masked_array([1.0, 2.0, 9e9], mask=[0, 0, 1])),
            UsageError,
            "values are masked",
        ),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(
    "x",
    [
        1e15 + np.array([0.0, 1.0, 3.0, 2.0, 7.0]),
        1000.0 * (1.0 + 1e-13 * np.arange(5.0) ** 2),
        np.array([1e-300, 1e300, 1.0]),
    ],
)
def test_logarithms_keep_the_digits_of_values_close_together_and_far_apart(x):
    moments = Moments.from_values(x, log=True)
    with mp.workdps(40):
        logs = [mp.log(mp.mpf(float(v))) for v in x]
        mean = sum(logs) / len(x)
        sd = mp.sqrt(sum((v - mean) ** 2 for v in logs) / (len(x) - 1))
        assert moments.mean == pytest.approx(float(mean), rel=1e-15)
        assert moments.sd == pytest.approx(float(sd), rel=1e-14, abs=0.0)
    assert moments.scale == "log"


def exact(values):
    """Return the correctly rounded mean and SD, from rational arithmetic."""
    fractions = [Fraction(value) for value in np.asarray(values).tolist()]
    mean = sum(fractions, Fraction(0)) / len(fractions)
    variance = sum((value - mean) ** 2 for value in fractions) / (len(fractions) - 1)
    with mp.workdps(40):
        return float(mean), float(mp.sqrt(mp.mpf(variance.numerator) / variance.denominator))


def assert_within_four_ulp(samples):
    """Compare every sample along the last axis with rational arithmetic."""
    for row, *found in zip(samples, *mean_and_sd(samples), strict=True):
        for value, truth in zip(found, exact(row), strict=True):
            assert abs(value - truth) <= 4 * math.ulp(truth), row


@settings(max_examples=100, deadline=None)
@given(
    arrays(
        float, st.tuples(st.integers(1, 12), st.integers(2, 7)), elements=st.floats(-1e307, 1e307)
    )
)
def test_any_samples_are_within_four_ulp(samples):
    assert_within_four_ulp(samples)


@pytest.mark.parametrize("n", [2, 3, 10, 33, 1000])
def test_hard_samples_are_within_four_ulp(n):
    random = np.random.default_rng(n)
    base = random.normal(size=(3 if n > 100 else 40, n))
    shape = base.shape
    for samples in (
        base,
        base + 1e15,
        base * 1e-12 + 1.0,
        base * 10.0 ** random.integers(-300, 140, shape),
        base * 1e-310,
        base * 1e307,
        5e-324 * random.integers(0, 50, shape),
        np.full(shape, 0.1),
        np.full(shape, 1.0 - 2.0**-53),
    ):
        assert_within_four_ulp(samples)


def test_means_that_cancel_keep_their_digits():
    assert_within_four_ulp(
        np.array([[1e16, 1.0, -1e16], [1e300, 1.0, -1e300], [1.5e308, 1.0, -1.5e308]])
    )
    nearly = np.random.default_rng(3).random((40, 3))
    nearly[:, 1] = -nearly[:, 0]
    nearly[:, 2] *= 1e-25
    assert_within_four_ulp(nearly)


def test_an_sd_beyond_the_largest_double_is_refused():
    with pytest.raises(UsageError, match="standard deviations must be finite"):
        Moments.from_values([1.7e308, -1.7e308])
