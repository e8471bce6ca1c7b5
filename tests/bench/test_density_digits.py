import dataclasses
import math

import numpy as np
import pytest
from mpmath import mp

from percept.bench import _density_reference as reference
from percept.bench.density_digits import DensityDigits, collapsed, density_digits
from tests.inference.hierarchy import exact

LEVELS = reference.Levels(between=0.2, shared=1e-4, trial=30.0, tau=0.5, rest=1e-7)
X = np.array([[-1.0, 1.0], [-0.5, 0.5]])


@pytest.fixture(scope="module")
def rows() -> list[DensityDigits]:
    return density_digits(1)


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


def test_reference_is_the_multivariate_normal():
    response = np.random.default_rng(1).normal(size=(2, 2, 2, 2))
    with mp.workdps(exact.DIGITS):
        wanted = one_covariance_over_all_trials(response, LEVELS)
        assert abs(reference.exact(response, X, LEVELS) - wanted) < mp.mpf(10) ** -40


def test_formulas_in_doubles_are_right_where_nothing_is_extreme():
    response = np.random.default_rng(2).normal(size=(4, 2, 2, 2))
    mild = dataclasses.replace(LEVELS, shared=0.3, trial=0.4, rest=0.6)
    wanted = float(reference.exact(response, X, mild))
    for formula in (reference.dense, reference.woodbury, collapsed):
        assert formula(response, X, mild) == pytest.approx(wanted, rel=1e-12)


def test_promise_is_kept_over_every_sweep(rows):
    assert {row.sweep for row in rows} == {
        "all variances", "variance of between, others 1e-12", "variance of shared, others 1e-12",
        "variance of trial, others 1e-12", "variance of tau, others 1e-12", "1 - correlation", "subjects",
        "offset",
    }  # fmt: skip
    worst = max(rows, key=lambda row: row.worst)
    assert worst.worst <= 1.0, worst
    assert min(row.ours for row in rows) > 14.0


def test_direct_formulas_lose_what_the_page_says(rows):
    at = {(row.sweep, row.value): row for row in rows}
    apart = at["variance of shared, others 1e-12", 10.0**12]
    assert (apart.dense, apart.woodbury) == (0.0, 0.0)
    assert at["1 - correlation", 10.0**-9].dense < 7.0
    assert at["subjects", 1000].dense is None
    assert at["all variances", 1.0].woodbury > 14.0


def test_an_error_and_a_nan_are_seen():
    def off(response, x, levels):
        value = collapsed(response, x, levels)
        return value + 1e-6 * (1.0 + abs(value))

    for row in density_digits(1, sweeps=("offset",), formula=off):
        assert row.ours == pytest.approx(6.0, abs=0.01)
        assert row.worst == pytest.approx(1000.0, rel=1e-3)
    first, *_ = density_digits(1, sweeps=("offset",), formula=lambda *_: math.nan)
    assert (first.ours, first.worst) == (0.0, math.inf)


def test_sweeps_repeat():
    assert density_digits(1, sweeps=("offset",)) == density_digits(1, sweeps=("offset",))
