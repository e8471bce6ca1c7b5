"""Coordinate maps against 40-digit quantile functions, far into both tails."""

import numpy as np
import pytest
from mpmath import mp

from percept.inference.model import priors as coordinates

POINTS = np.array(
    [-30.0, -12.5, -8.0, -3.0, -1.0, -0.3, -1e-3, 0.0, 1e-8, 0.2, 1.0, 4.0, 8.3, 12.5, 30.0]
)


def exact_cdf(u):
    """Standard normal CDF of the double `u`, and its complement."""
    root = mp.sqrt(2)
    return mp.erfc(-mp.mpf(float(u)) / root) / 2, mp.erfc(mp.mpf(float(u)) / root) / 2


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_half_normal_has_the_prior_s_tail_probability(scale):
    values = coordinates.half_normal(POINTS, scale)
    with mp.workdps(60):
        for u, value in zip(POINTS, values, strict=True):
            below, above = exact_cdf(u)
            if u == -30.0:
                assert value == 1e-70  # squares of squares of the SD must not underflow
                continue
            ratio = mp.mpf(float(value)) / mp.mpf(scale) / mp.sqrt(2)
            # The quantile's relative error, from the probability's by the density: P/(x p).
            density = 2 / mp.sqrt(mp.pi) * mp.exp(-(ratio**2)) * ratio
            error = mp.erf(ratio) - below if u < 0 else above - mp.erfc(ratio)
            assert abs(error / density) < 1e-13, u


@pytest.mark.parametrize("shape", [1.0, 1.5, 2.0, 3.5, 10.0])
def test_correlation_of_any_beta_matches_its_distribution(shape):
    points = POINTS[np.abs(POINTS) <= 12.5]  # above the floor of 1e-70
    rho, rest = coordinates.correlation(points, shape)
    with mp.workdps(50):
        for u, r, gap in zip(points, rho, rest, strict=True):
            tail = min(exact_cdf(u))
            q = mp.mpf(float(gap)) / 2
            found = mp.betainc(shape, shape, 0, q, regularized=True)
            # A relative error e of q changes the tail by at most `shape` e.
            assert float(abs(found / tail - 1)) < shape * 1e-12, (u, shape)
            assert np.isclose(1.0 - abs(r), gap, rtol=0, atol=3e-16)
            assert r == 0 or np.sign(r) == np.sign(u)
