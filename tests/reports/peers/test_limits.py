"""Limits from raw draws."""

import numpy as np
import pytest
from scipy import stats

from reports.peers.nutpie import limits_of_draws


def test_limits_of_independent_draws_of_a_known_law():
    """Means N(0.2, 0.1²), spread 0.5: quantiles are known, and so is the size of the errors."""
    rng = np.random.default_rng(11)
    chains, draws, cells = 4, 3000, 20
    beta = 0.2 + 0.1 * rng.standard_normal((chains, draws, cells))
    spread = np.full(beta.shape, 0.5) * np.exp(1e-12 * rng.standard_normal(beta.shape))
    value, error, effective = limits_of_draws(beta, spread, rng)
    z = stats.norm.isf(0.005)
    wide = np.hypot(0.1, 0.5)
    exact = 0.2 + z * np.array([-0.1, 0.1, -wide, wide])
    apart = (value.reshape(4, cells) - exact[:, None]) / error.reshape(4, cells)
    # 80 standardised errors: their mean square has an SD of sqrt(2/80), and more as they are
    # estimated.
    assert np.mean(apart**2) == pytest.approx(1.0, abs=5 * 1.2 * np.sqrt(2 / 80))
    assert effective == pytest.approx(chains * draws, rel=0.2)


def test_errors_see_autocorrelation():
    rng = np.random.default_rng(12)
    noise = rng.standard_normal((4, 4000, 2))
    slow = np.zeros_like(noise)
    for t in range(1, noise.shape[1]):
        slow[:, t] = 0.9 * slow[:, t - 1] + np.sqrt(1 - 0.81) * noise[:, t]
    spread = np.exp(0.1 * noise)
    (_, quick_error, quick), (_, error, found) = (
        limits_of_draws(draws, spread, rng) for draws in (noise, slow)
    )
    # The mean of an AR(1) with 0.9 has (1 + 0.9)/(1 - 0.9) = 19 times the variance of independent
    # draws.
    assert found < quick / 6
    assert (error[0] > 1.7 * quick_error[0]).all()
