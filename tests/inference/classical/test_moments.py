from decimal import Decimal

import mpmath as mp
import numpy as np
import pytest

from percept.errors import RefusalError, UsageError
from percept.inference import Moments, OneMinus, t_interval

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


def test_published_limits_as_arrays():
    low, high = (np.array([float(row[i]) for row in TABLE]) for i in (0, 1))
    together = Moments.from_limits(low, high, 10)
    assert together.mean.tolist() == [
        Moments.from_limits(a, b, 10).mean for a, b in zip(low, high, strict=True)
    ]
    assert together.n.tolist() == [10] * 10


def test_log_moments_are_those_of_logarithms():
    x = np.array([1.0, np.e, np.e**2])
    moments = Moments.from_values(x, log=True)
    assert moments.mean == pytest.approx(1.0, rel=1e-15)
    assert moments.sd == pytest.approx(1.0, rel=1e-15)
    assert moments.scale == "log"


def test_moment_matching_gives_back_mean_and_sd():
    matched = Moments(981.03, 35.2, 10).lognormal()
    with mp.workdps(30):
        mu, variance = mp.mpf(matched.mean), mp.mpf(matched.sd) ** 2
        assert float(mp.exp(mu + variance / 2)) == pytest.approx(981.03, rel=1e-14)
        assert float(mp.exp(mu + variance / 2) * mp.sqrt(mp.expm1(variance))) == pytest.approx(
            35.2, rel=1e-13
        )


def test_the_axis_of_subjects_is_the_one_stated():
    x = np.random.default_rng(3).normal(size=(4, 10, 3))
    moved = Moments.from_values(x, axis=1)
    for i in range(4):
        for j in range(3):
            alone = Moments.from_values(x[i, :, j])
            assert moved.mean[i, j] == pytest.approx(alone.mean, rel=1e-15)
            assert moved.sd[i, j] == pytest.approx(alone.sd, rel=1e-15)


def test_equal_weights_are_no_weights():
    x = np.random.default_rng(4).normal(size=12) + 1e9
    plain, weighted = Moments.from_values(x), Moments.from_weighted(x, np.full(12, 3.0))
    assert weighted.mean == pytest.approx(plain.mean, rel=1e-15)
    assert weighted.sd == pytest.approx(plain.sd, rel=1e-12)


def test_the_weighted_mean_covers_where_variances_go_with_the_weights():
    random = np.random.default_rng(6)
    weights = np.array([1.0, 2.0, 5.0, 9.0])
    studies, level = 4000, 0.9
    x = random.normal(7.0, 1.0 / np.sqrt(weights), (studies, 4))
    intervals = [t_interval(Moments.from_weighted(row, weights), level=level) for row in x]
    held = np.mean([interval.lower <= 7.0 <= interval.upper for interval in intervals])
    assert abs(held - level) <= 4 * np.sqrt(level * (1 - level) / studies)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: Moments.from_values([]), UsageError, "array is empty"),
        (lambda: Moments.from_values([1.0]), RefusalError, "At least 2 subjects are needed; there is 1"),
        (lambda: Moments.from_values([1.0, np.nan]), UsageError, r"value nan: .* index \[1\]"),
        (
            lambda: Moments.from_values([[1.0, 2.0], [np.inf, 1.0]]),
            UsageError,
            r"inf: .* index \[1, 0\]",
        ),
        (
            lambda: Moments.from_values([[1.0, 2.0, np.nan], [np.inf, 1.0, 2.0]]),
            UsageError,
            r"nan: .* index \[0, 2\]",
        ),
        (lambda: Moments.from_values([[1.0, 2.0], [1.0]]), UsageError, "unequal length"),
        (lambda: Moments.from_values(["a", "b"]), UsageError, "must be real numbers"),
        (lambda: Moments.from_values([1j, 2.0]), UsageError, "must be real numbers; their type is complex"),
        (lambda: Moments.from_values([True, False]), UsageError, "their type is bool"),
        (lambda: Moments.from_values([object(), 1.0]), UsageError, "their type is object"),
        (lambda: Moments.from_values(3.0), UsageError, "not a single number"),
        (lambda: Moments.from_values([1.0, 2.0], axis=1), UsageError, "there is no axis 1"),
        (lambda: Moments.from_values([1.0, 0.0], log=True), RefusalError, "zero or negative"),
        (lambda: Moments(1.0, -1.0, 5), UsageError, "cannot be negative"),
        (lambda: Moments(1.0, 1.0, 5.5), UsageError, "must be whole"),
        (lambda: Moments(1.0, 1.0, 1), RefusalError, "At least 2 subjects"),
        (lambda: Moments(np.ones(2), np.ones(3), 5), UsageError, "shapes that do not fit"),
        (lambda: Moments.from_limits(2.0, 1.0, 5), UsageError, "value 2.0: A lower limit lies above"),
        (lambda: Moments.from_limits([1, 2], [2, 3, 4], 5), UsageError, "shapes that do not fit"),
        (lambda: Moments.from_limits(1.0, 2.0, 5, level=99), UsageError, "99 percent is written 0.99"),
        (lambda: Moments.from_weighted([1.0, 2.0], [1.0]), UsageError, "One weight per subject"),
        (lambda: Moments.from_weighted([1.0, 2.0], [1.0, 0.0]), UsageError, "Weights must be positive"),
        (lambda: Moments(-1.0, 1.0, 5).lognormal(), RefusalError, "positive mean"),
        (
            lambda: Moments.from_weighted([1.0, 2.0], [1.0, 2.0]).lognormal(),
            UsageError,
            r"is not that of users.*log=True",
        ),
        (
            lambda: Moments(1.0, 1.0, 5, scale="Log"),
            UsageError,
            r"value 'Log': scale must be .linear. or .log.",
        ),
        (lambda: Moments(1.0, 1.0, 1e300), UsageError, "No study has so many subjects"),
        (
            lambda: Moments.from_values(np.ma.masked_array([1.0, 2.0, 9e9], mask=[0, 0, 1])),
            UsageError,
            "values are masked",
        ),
        (lambda: OneMinus(0.0), UsageError, "strictly between 0 and 1"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_decimals_and_integers_are_numbers():
    assert Moments.from_values([Decimal("1.5"), Decimal("2.5")]).mean == 2.0
    assert Moments.from_values(np.array([1, 3])).mean == 2.0


@pytest.mark.parametrize(
    "x", [1e15 + np.array([0.0, 1.0, 3.0, 2.0, 7.0]), 1000.0 * (1.0 + 1e-13 * np.arange(5.0) ** 2)]
)
def test_logarithms_keep_the_digits_of_values_that_hardly_differ(x):
    moments = Moments.from_values(x, log=True)
    with mp.workdps(40):
        logs = [mp.log(mp.mpf(float(v))) for v in x]
        mean = sum(logs) / 5
        sd = mp.sqrt(sum((v - mean) ** 2 for v in logs) / 4)
        assert moments.mean == pytest.approx(float(mean), rel=1e-15)
        assert moments.sd == pytest.approx(float(sd), rel=1e-14, abs=0.0)


def test_logarithms_of_values_hundreds_of_decades_apart():
    wide = Moments.from_values([1e-300, 1e300, 1.0], log=True)
    assert wide.sd == pytest.approx(300 * np.log(10.0), rel=1e-14)


def test_a_weighted_sd_does_not_mind_an_offset():
    x, weights = np.array([0.0, 8.0, 16.0, 40.0]), [1.0, 2.0, 3.0, 4.0]
    near, far = Moments.from_weighted(x, weights), Moments.from_weighted(x + 1e15, weights)
    assert far.sd == pytest.approx(near.sd, rel=1e-14)
