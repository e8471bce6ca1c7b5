"""Convergence measures on chains whose theory is known."""

import numpy as np
import pytest
from arviz_stats.base import array_stats
from scipy import signal, stats

from percept.inference.sampling.diagnostics import (
    autocorrelation_time,
    monte_carlo_error,
    normal_scores,
    split_rhat,
)


def autoregressive(rho, shape, rng):
    """Stationary AR(1) of unit variance along axis 1 of (E, T, W, Q)."""
    noise = rng.standard_normal(shape)
    noise[:, 1:] *= np.sqrt(1 - rho**2)
    return signal.lfilter([1.0], [1.0, -rho], noise, axis=1)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, -0.5])
def test_autocorrelation_time_of_ar1(rho):
    series = autoregressive(rho, (4, 500, 64, 3), np.random.default_rng(1))
    wanted = max((1 + rho) / (1 - rho), 1.0)
    # Sokal's variance: (4 M + 2)/N relative, M the window; and its bias exp(-window).
    relative = np.sqrt((4 * 5 * wanted + 2) / (4 * 500 * 64)) + 0.01 + wanted / 500 * 2
    assert np.all(np.abs(autocorrelation_time(series) / wanted - 1) < 4 * relative)


def test_autocorrelation_time_sees_walkers_apart():
    """Walkers that each stay somewhere are not mixing, however white their noise."""
    rng = np.random.default_rng(2)
    series = rng.normal(size=(4, 200, 64, 1)) + 3 * rng.normal(size=(1, 1, 64, 1))
    assert autocorrelation_time(series)[0] > 50
    constant = np.ones((4, 50, 64, 1))
    assert np.isinf(autocorrelation_time(constant)[0])


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_monte_carlo_error_is_the_scatter_of_repeated_means(rho):
    rng = np.random.default_rng(3)
    repeats = 300
    z = []
    for _ in range(repeats):
        series = autoregressive(rho, (4, 120, 16, 1), rng)
        z.append(series.mean() / monte_carlo_error(series - series.mean())[0])
    # The standard error of an SD, three times.
    assert abs(np.std(z) - 1) < 3 / np.sqrt(2 * repeats)


def test_rhat_of_constants():
    constant = np.ones((4, 20, 1))
    each_its_own = constant * np.arange(4.0)[:, None, None]
    for method in ("rank", "split"):
        assert split_rhat(constant, method)[0] == 1.0
        assert split_rhat(each_its_own, method)[0] == np.inf


@pytest.mark.parametrize("method", ["rank", "split"])
def test_rhat_is_that_of_arviz(method):
    chains = np.random.default_rng(4).standard_t(3, size=(4, 51, 2))
    chains[..., 1] = chains[..., 1].round()
    wanted = array_stats.rhat(chains, chain_axis=0, draw_axis=1, method=method)
    np.testing.assert_allclose(split_rhat(chains, method), wanted, rtol=1e-13)


def test_normal_scores_are_those_of_ranks():
    values = np.array([[3.0], [-1.0], [10.0], [3.0]])
    ranks = np.array([2.5, 1.0, 4.0, 2.5])
    wanted = stats.norm.ppf((ranks - 0.375) / 4.25)
    np.testing.assert_allclose(normal_scores(values)[:, 0], wanted, rtol=1e-14)
    cauchy = np.random.default_rng(7).standard_cauchy((50, 4, 2))
    scores = normal_scores(cauchy)
    assert scores.shape == cauchy.shape
    assert abs(scores[..., 0].std() - 1) < 0.02


def test_autocorrelation_time_waits_for_a_small_part_that_is_slow():
    """A tenth of the variance remembers fifty positions, and the rest none."""
    rng, shape = np.random.default_rng(1), (4, 1600, 64, 1)
    series = np.sqrt(0.1) * autoregressive(0.98, shape, rng) + np.sqrt(0.9) * rng.standard_normal(
        shape
    )
    # Sokal's window: the first of five times the sum of the autocorrelations up to it.
    lags = np.arange(1, 400)
    times = 1.0 + 2.0 * 0.1 * np.cumsum(0.98**lags)
    wanted = times[np.argmax(lags >= 5.0 * times)]
    # The sum's standard error is sqrt((4 M + 2)/N), 3 % here; where the window ends moves with it.
    assert autocorrelation_time(series)[0] == pytest.approx(wanted, rel=0.2)


def test_ranks_see_a_chain_that_is_wider():
    values = np.random.default_rng(5).normal(size=(4, 200, 1))
    values[3] *= 3.0
    assert split_rhat(values, "split")[0] < 1.02
    assert split_rhat(values, "rank")[0] > 1.05
