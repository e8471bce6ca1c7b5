"""Fiducial populations: their margins are those of the t and chi-square, whatever is combined."""

import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from percept.inference.classical.fiducial import fiducial_draws

DRAWS = 40_000
#: Smallest p-value of a test that holds: eighteen tests are made.
LEAST_P = 1e-4


def subjects(n, seed):
    rng = np.random.default_rng(seed)
    return rng.multivariate_normal([1.0, -2.0], [[1.0, 0.6], [0.6, 0.5]], size=n)


@pytest.mark.parametrize("n", [3, 6, 30])
@pytest.mark.parametrize("weights", [(1.0, 0.0), (0.0, 1.0), (0.3, -2.0)])
def test_linear_margins_are_exact(n, weights):
    values = subjects(n, n)
    mean, covariance = fiducial_draws(values, DRAWS, np.random.default_rng(1))
    weights = np.array(weights)
    combined = values @ weights
    sd = combined.std(ddof=1)
    variance = np.einsum("p,dpq,q->d", weights, covariance, weights)
    chi_square = (n - 1) * sd**2 / variance
    assert stats.kstest(chi_square, stats.chi2(n - 1).cdf).pvalue > LEAST_P
    t = (mean @ weights - combined.mean()) * np.sqrt(n) / sd
    assert stats.kstest(t, stats.t(n - 1).cdf).pvalue > LEAST_P


def test_one_degree_of_freedom_less_is_caught():
    values = subjects(4, 3)
    _, covariance = fiducial_draws(values, DRAWS, np.random.default_rng(3))
    chi_square = 2 * values[:, 0].var(ddof=1) / covariance[:, 0, 0]
    assert stats.kstest(chi_square, stats.chi2(2).cdf).pvalue < LEAST_P


def test_refusals():
    rng = np.random.default_rng(0)
    with pytest.raises(RefusalError, match="2 quantities needs at least 3 subjects"):
        fiducial_draws(np.ones((2, 2)), 10, rng)
    with pytest.raises(RefusalError, match="follows exactly from the others"):
        fiducial_draws(np.outer(np.arange(5.0), [1.0, 2.0]), 10, rng)
