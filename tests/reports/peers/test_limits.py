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
