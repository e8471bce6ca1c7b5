"""Coordinates of spreads against dense Gaussian algebra in 60 digits."""

import mpmath
import numpy as np
import pytest
from mpmath import mp

from percept.inference.model.rough import RoughLikelihood, _tie
from percept.inference.model.trend_map import TrendMap

CENTRE = -1.6
WEIGHTS = {
    "all": (18.0, 18.0, 18.0, 18.0),
    "uneven": (38.0, 0.0, 2.0, 18.0),
    "none": (0.0, 0.0, 0.0, 0.0),
}
LOADINGS = {
    "trend": ((1.0, 1.0, 1.0, 1.0), (-0.6, -0.1, 0.2, 0.5)),
    "off centre": ((1.0, 1.0, 1.0, 1.0), (0.6, 0.1, 0.2, 0.5)),
    "weber": ((1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0)),
    "no trend": ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
}
ROUGH = np.array([-0.9, -2.0, -1.7, -1.2])


def column(values):
    return mpmath.matrix([mp.mpf(float(v)) for v in values])


def square_root(matrix):
    values, vectors = mp.eigsy(matrix)
    return vectors * mpmath.diag([mp.sqrt(v) for v in values]) * vectors.T


def dense(loadings, weights, omega, u, trend):
    """log sigma, trend and log density by the textbook's formulas."""
    size = len(u)
    basis = mpmath.matrix(np.array(loadings).T.tolist())
    prior = basis * basis.T + omega**2 * mpmath.eye(size)
    weight = mpmath.diag(weights)
    covariance = (prior**-1 + weight) ** -1
    mean = column([CENTRE] * size) + covariance * weight * column(ROUGH - CENTRE)
    # Any square root would do; the one used is symmetric about the cells' own SDs.
    own = mpmath.diag([omega / mp.sqrt(1 + w * omega**2) for w in weights])
    value = mean + own * square_root(own**-1 * covariance * own**-1) * column(u)
    off = value - column([CENTRE] * size)
    log_density = -(off.T * prior**-1 * off)[0] / 2 - mp.log(mp.det(prior)) / 2
    log_density += (mp.log(mp.det(covariance)) - size * mp.log(2 * mp.pi)) / 2
    gain = basis.T * prior**-1
    left = mpmath.eye(2) - gain * basis
    given = gain * off + square_root(left) * column(trend)
    return value, given, log_density


@pytest.mark.parametrize("omega", [1e-8, 1e-2, 0.4, 50.0])
@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("loadings", LOADINGS)
def test_map_is_dense_algebra(loadings, weights, omega):
    rng = np.random.default_rng(8)
    u = np.array([[2.0, -3.0, 0.1, 1.0], rng.normal(size=4)]).T
    trend = rng.normal(size=(2, 2))
    basis, weight = np.array(LOADINGS[loadings]), np.array(WEIGHTS[weights])
    spreads = TrendMap(CENTRE, basis, ROUGH, weight)(trend, u, np.full(2, omega))
    with mp.workdps(60):
        for w in range(2):
            arguments = (LOADINGS[loadings], WEIGHTS[weights], mp.mpf(omega), u[:, w], trend[:, w])
            value, given, wanted = dense(*arguments)
            for cell in range(4):
                assert abs(spreads.log_sigma[cell, w] - float(value[cell])) < 1e-12
            for part in range(2):
                assert abs(spreads.multiples[part, w] - float(given[part])) < 1e-9
            assert abs(spreads.log_density[w] - float(wanted)) < 1e-10 * (1 + abs(float(wanted)))


@pytest.mark.parametrize("omega", [1e-70, 1e70])
def test_extreme_spreads_keep_their_digits(omega):
    basis, weight = np.array(LOADINGS["trend"]), np.array(WEIGHTS["uneven"])
    u, trend = np.array([[30.0], [-30.0], [0.0], [1.0]]), np.ones((2, 1))
    spreads = TrendMap(CENTRE, basis, ROUGH, weight)(trend, u, np.full(1, omega))
    with mp.workdps(400):
        arguments = (LOADINGS["trend"], WEIGHTS["uneven"], mp.mpf(omega), u[:, 0], trend[:, 0])
        value, given, log_density = dense(*arguments)
    found = (spreads.log_sigma, spreads.multiples, spreads.log_density)
    for part, exact in zip(found, (value, given, [log_density]), strict=True):
        np.testing.assert_allclose(
            part.ravel(), np.array([float(one) for one in exact]), rtol=1e-13
        )


def test_tied_spreads_have_the_rough_likelihood_s_correlation():
    """Under a flat prior the map is l + A u with AA' the covariance of the rough likelihood."""
    mean, weight = np.array([[-1.0, -2.0], [-1.5, -2.5]]), np.array([[20.0, 30.0], [45.0, 0.0]])
    rough = RoughLikelihood.tied(mean, weight, 0.98)
    u = np.concatenate([np.zeros((4, 1)), np.eye(4)], axis=1).reshape(2, 2, 5)
    omega, trend, basis = np.full(5, 1e7), np.zeros((2, 5)), np.zeros((2, 2))
    maps = [TrendMap(CENTRE, basis, rough.mean[p], rough.weight[p]) for p in range(2)]
    of_first = maps[0](trend, u[0], omega).log_sigma
    of_second = maps[1](trend, u[1], omega, rough.shift_of_second(of_first)).log_sigma
    value = np.stack([of_first, of_second])
    first = value[:, 0]
    np.testing.assert_allclose(first[:, 0], mean[:, 0], atol=1e-9)
    columns = first[:, 1:] - first[:, :1]
    between = 0.98 / np.sqrt(20.0 * 45.0)
    wanted = [[1 / 20, between], [between, 1 / 45]]
    np.testing.assert_allclose(columns @ columns.T, wanted, rtol=1e-9)
    # Of a cell that says nothing of b, b is left to its prior whatever k.
    assert value[1, 1, 2] == value[1, 1, 0] == pytest.approx(CENTRE)


def test_a_tie_is_the_square_of_a_correlation_less_two_standard_errors():
    k, b = np.array([1.0, -1.0, 2.0, -2.0]), np.array([1.0, -1.0, 2.0, -1.0])
    r = 8.0 / np.sqrt(10.0 * 7.0)

    def tie(first, second, df):
        return _tie(np.stack([first, second]), np.ones((2, 1)), df)

    assert tie(k, b, 103.0) == pytest.approx(np.tanh(np.arctanh(r) - 0.2) ** 2)
    assert tie(k, -b, 103.0) == tie(k, b, 103.0)
    assert tie(k, k, 1e12) == pytest.approx(0.9999**2, rel=1e-6)
    assert tie(k, b, 3.0) == tie(k, b, 4.0) == tie(k, 0.0 * b, 103.0) == 0.0
