"""Coordinate maps against 40-digit quantile functions, far into both tails."""

import numpy as np
import pytest
from mpmath import mp
from scipy import special

from percept.inference.model import priors as coordinates

POINTS = np.array(
    [-30.0, -12.5, -8.0, -3.0, -1.0, -0.3, -1e-3, 0.0, 1e-8, 0.2, 1.0, 4.0, 8.3, 12.5, 30.0]
)


def exact_cdf(u):
    """Standard normal CDF of the double `u`, and its complement."""
    root = mp.sqrt(2)
    return mp.erfc(-mp.mpf(float(u)) / root) / 2, mp.erfc(mp.mpf(float(u)) / root) / 2


def relative(value, exact):
    return float(abs((mp.mpf(float(value)) - exact) / exact))


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


def test_half_normal_increases_through_zero():
    u = np.concatenate([np.linspace(-34.9, 34.9, 4001), np.array([-1e-15, 0.0, 1e-15])])
    values = coordinates.half_normal(np.sort(u), 0.5)
    assert np.all(np.diff(values) >= 0)
    assert np.all(values > 0)
    assert np.isclose(
        coordinates.half_normal(np.zeros(1), 0.5)[0], 0.5 * special.ndtri(0.75), rtol=1e-15
    )


def test_correlation_of_beta_2_2_keeps_the_distance_from_one():
    rho, rest = coordinates.correlation(POINTS)
    with mp.workdps(250):
        for u, r, gap in zip(POINTS, rho, rest, strict=True):
            tail = min(exact_cdf(u))
            # P(p < q) = q²(3 - 2q) for Beta(2, 2), and 1 - |rho| = 2q.
            q = mp.mpf(1) / 2 - mp.sin(mp.asin(1 - 2 * tail) / 3)
            assert abs(q * q * (3 - 2 * q) / tail - 1) < mp.mpf(10) ** -20
            assert relative(gap, max(2 * q, mp.mpf(10) ** -70)) < 4e-14, u
            assert abs(float(mp.mpf(float(abs(r))) - (1 - 2 * q))) < 4e-16
            assert r == 0 or np.sign(r) == np.sign(u)


@pytest.mark.parametrize("shape", [1.0, 1.5, 2.0, 3.5, 10.0])
def test_correlation_of_any_beta_matches_its_distribution(shape):
    points = POINTS if shape > 3.0 else POINTS[np.abs(POINTS) <= 12.5]  # above the floor of 1e-70
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


def test_correlation_is_odd_and_stays_inside():
    u = np.linspace(0, 34.9, 501)
    for shape in (2.0, 3.5):
        up, rest_up = coordinates.correlation(u, shape)
        down, rest_down = coordinates.correlation(-u, shape)
        np.testing.assert_array_equal(up, -down)
        np.testing.assert_array_equal(rest_up, rest_down)
        assert np.all(rest_up > 0)
