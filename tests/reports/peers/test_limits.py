"""Limits from raw draws."""

import numpy as np
import pytest
from scipy import optimize, special, stats

from reports.fitted import CONFIDENCE, SHARE
from reports.peers.nutpie import limits_of_draws, share_half_widths


@pytest.mark.parametrize("off", [0.0, 1e-9, 0.01, 0.5, 3.0, 40.0])
@pytest.mark.parametrize("share", [0.5, 0.99, 0.9999])
def test_share_half_width_is_the_root(off, share):
    spread = 0.3

    def missing(h):
        return special.ndtr((off - h) / spread) + special.ndtr((-off - h) / spread) - (1.0 - share)

    expected = optimize.brentq(missing, 0.0, off + 10.0, xtol=1e-15, rtol=1e-15)
    # Of opposite signs alike.
    found = share_half_widths(np.array([off, -off]), np.array([spread, spread]), share)
    assert found == pytest.approx([expected, expected], rel=1e-11)


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
    apart = (value[:2].reshape(4, cells) - exact[:, None]) / error[:2].reshape(4, cells)
    # 80 standardised errors: their mean square has an SD of sqrt(2/80), and more as they are
    # estimated.
    assert np.mean(apart**2) == pytest.approx(1.0, abs=5 * 1.2 * np.sqrt(2 / 80))
    off = stats.norm.isf(0.5 * (1 - CONFIDENCE)) * 0.1
    half = share_half_widths(np.array(off), np.array(0.5), SHARE)
    assert np.abs((value[2, 1] - value[2, 0]) / 2 - half).max() < 5 * error[2].max()
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
