"""Coordinates of spreads against dense Gaussian algebra in 60 digits."""

import mpmath
import numpy as np
import pytest
from mpmath import mp

from percept.inference.hierarchy.priors import SpreadMap

CENTRE = -1.6
WEIGHTS = {"all": (18.0, 18.0, 18.0, 18.0), "uneven": (38.0, 0.0, 2.0, 18.0), "none": (0.0, 0.0, 0.0, 0.0)}
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
    log_density += mp.log(mp.det(covariance)) / 2
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
    basis, weight = np.array([LOADINGS[loadings]]), np.array([WEIGHTS[weights]])
    found = SpreadMap(CENTRE, basis, ROUGH[None], weight)(u[None], np.full((1, 2), omega), trend[None])
    with mp.workdps(60):
        for w in range(2):
            arguments = (LOADINGS[loadings], WEIGHTS[weights], mp.mpf(omega), u[:, w], trend[:, w])
            value, given, log_density = dense(*arguments)
            for cell in range(4):
                assert abs(found.log_sigma[0, cell, w] - float(value[cell])) < 1e-12
            for part in range(2):
                assert abs(found.trend[0, part, w] - float(given[part])) < 1e-9
            assert abs(found.log_density[w] - float(log_density)) < 1e-10 * (1 + abs(float(log_density)))


@pytest.mark.parametrize("omega", [1e-70, 1e70])
def test_extreme_spreads_keep_their_digits(omega):
    basis, weight = np.array([LOADINGS["trend"]]), np.array([WEIGHTS["uneven"]])
    u, trend = np.array([[30.0], [-30.0], [0.0], [1.0]]), np.ones((2, 1))
    found = SpreadMap(CENTRE, basis, ROUGH[None], weight)(u[None], np.full((1, 1), omega), trend[None])
    with mp.workdps(400):
        arguments = (LOADINGS["trend"], WEIGHTS["uneven"], mp.mpf(omega), u[:, 0], trend[:, 0])
        value, given, log_density = dense(*arguments)
    for part, exact in ((found.log_sigma, value), (found.trend, given), (found.log_density, [log_density])):
        np.testing.assert_allclose(part.ravel(), np.array([float(one) for one in exact]), rtol=1e-13)
