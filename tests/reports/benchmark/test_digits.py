"""Digits kept: NIST's certified sets, exact arithmetic, and proof that an error would be seen."""

import math

import numpy as np
import pytest
from mpmath import mp

from reports.benchmark import digits as bench
from reports.benchmark import twins as twin
from reports.benchmark.digits import (
    collapsed,
    density_digits,
    moment_digits,
    number_accuracy,
)
from tests.inference.model import exact

LEVELS = twin.Levels(between=0.2, shared=1e-4, trial=30.0, tau=0.5, rest=1e-7)
X = np.array([[-1.0, 1.0], [-0.5, 0.5]])


def test_means_and_sds_are_rounded_as_promised():
    rows = moment_digits()
    assert len(rows) == 2 * 4 + 2 * 4
    assert max(row.over_promise for row in rows) <= 1.0


def test_sums_of_squares_would_be_seen():
    # Squares of 1e6 hold their last digit at 1e-4: two digits of an SD of 0.1 are left.
    values, _, sd = number_accuracy(3)
    direct = math.sqrt(
        (np.dot(values, values) - values.size * values.mean() ** 2) / (values.size - 1)
    )
    assert bench._moment_row("SD", "NumAcc3", direct, sd).over_promise > 1e10
    assert bench._moment_row("mean", "of zeros", 5e-324, 0.0).over_promise == math.inf


def one_covariance_over_all_trials(response, levels):
    """The log density by a Cholesky factor of one 60-digit matrix."""
    subject, environment, _ = (axis.ravel() for axis in np.indices(response.shape[:3]))

    def level(sd):
        return exact.covariance((sd, sd), 1.0, levels.rest)

    environments = response.shape[1]
    return exact.log_likelihood(
        response.reshape(-1, 2),
        subject,
        environment,
        X,
        between=[level(levels.between)] * environments,
        shared=level(levels.shared),
        trial=[level(levels.trial)] * environments,
        tau=(levels.tau, levels.tau),
    )


def test_the_twin_is_the_multivariate_normal():
    response = np.random.default_rng(1).normal(size=(2, 2, 2, 2))
    with mp.workdps(exact.DIGITS):
        wanted = one_covariance_over_all_trials(response, LEVELS)
        assert abs(twin.exact(response, X, LEVELS) - wanted) < mp.mpf(10) ** -40


def test_an_error_and_a_nan_are_seen():
    def off(response, x, levels):
        value = collapsed(response, x, levels)
        return value + 1e-6 * (1.0 + abs(value))

    for row in density_digits(1, along=("subjects",), formula=off):
        assert row.digits == pytest.approx(6.0, abs=0.01)
        assert row.over_promise == pytest.approx(1000.0, rel=1e-3)
    first, *_ = density_digits(1, along=("subjects",), formula=lambda *_: math.nan)
    assert (first.digits, first.over_promise) == (0.0, math.inf)
