"""Coordinates of spreads against dense Gaussian algebra in 60 digits."""

import mpmath
import numpy as np
import pytest
from mpmath import mp

from percept.inference.model.rough import RoughLikelihood, _tie
from percept.inference.model.spreads import SpreadMap

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
    "three columns": ((1.0, 1.0, 1.0, 1.0), (-0.6, -0.1, 0.2, 0.5), (0.5, -0.5, 0.5, -0.5)),
    "more columns than cells": (
        (1.0, 1.0, 1.0, 1.0),
        (-0.6, -0.1, 0.2, 0.5),
        (0.5, -0.5, 0.5, -0.5),
        (0.5, 0.5, -0.5, -0.5),
        (0.3, 0.0, 0.0, 0.1),
    ),
    "no trend": ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
}
ROUGH = np.array([-0.9, -2.0, -1.7, -1.2])


def column(values):
    return mpmath.matrix([mp.mpf(float(v)) for v in values])


def dense(loadings, weights, omega):
    """Mean and covariance of log sigma given its rough likelihood, and its prior covariance."""
    basis = mpmath.matrix(np.array(loadings).T.tolist())
    prior = basis * basis.T + omega**2 * mpmath.eye(basis.rows)
    weight = mpmath.diag(weights)
    covariance = (prior**-1 + weight) ** -1
    mean = column([CENTRE] * basis.rows) + covariance * weight * column(ROUGH - CENTRE)
    return mean, covariance, prior


@pytest.mark.parametrize("omega", [1e-8, 1e-2, 0.4, 50.0])
@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("loadings", LOADINGS)
def test_map_is_dense_algebra(loadings, weights, omega):
    """Log SDs are their mean and a root of their covariance times u."""
    basis, weight = np.array(LOADINGS[loadings]), np.array(WEIGHTS[weights])
    # The columns of u are zero, each unit, and some point; so are those of the coefficients.
    u = np.hstack([np.zeros((4, 1)), np.eye(4), [[2.0], [-3.0], [0.1], [1.0]]])
    width = u.shape[1]
    trend = np.ones((len(basis), width))
    spreads = SpreadMap(CENTRE, basis, ROUGH, weight)(trend, u, np.full(width, omega))
    found = spreads.log_sigma
    columns = found[:, 1:5] - found[:, :1]
    with mp.workdps(60):
        mean, covariance, prior = dense(LOADINGS[loadings], WEIGHTS[weights], mp.mpf(omega))
        wanted = np.array(covariance.tolist(), dtype=float)
        np.testing.assert_allclose(found[:, 0], [float(m) for m in mean], atol=1e-12)
        np.testing.assert_allclose(columns @ columns.T, wanted, rtol=1e-8, atol=1e-14)
        off = column(found[:, 5] - CENTRE)
        log_density = -(off.T * prior**-1 * off)[0] / 2 - mp.log(mp.det(prior)) / 2
        log_density += (mp.log(mp.det(covariance)) - 4 * mp.log(2 * mp.pi)) / 2
        if omega >= 1e-2:
            assert spreads.log_density[5] == pytest.approx(float(log_density), rel=1e-9)


@pytest.mark.parametrize("omega", [1e-70, 1e70])
def test_extreme_spreads_are_finite(omega):
    basis, weight = np.array(LOADINGS["three columns"]), np.array(WEIGHTS["uneven"])
    u = np.array([[30.0], [-30.0], [0.0], [1.0]])
    spreads = SpreadMap(CENTRE, basis, ROUGH, weight)(np.ones((3, 1)), u, np.full(1, omega))
    for part in (spreads.log_sigma, spreads.multiples, spreads.log_density):
        assert np.isfinite(part).all()


def test_tied_spreads_have_the_rough_likelihood_s_correlation():
    """Under a flat prior the map is l + A u with AA' the covariance of the rough likelihood."""
    mean, weight = np.array([[-1.0, -2.0], [-1.5, -2.5]]), np.array([[20.0, 30.0], [45.0, 0.0]])
    rough = RoughLikelihood.tied(mean, weight, 0.98)
    u = np.concatenate([np.zeros((4, 1)), np.eye(4)], axis=1).reshape(2, 2, 5)
    omega, trend, basis = np.full(5, 1e7), np.zeros((2, 5)), np.zeros((2, 2))
    maps = [SpreadMap(CENTRE, basis, rough.mean[p], rough.weight[p]) for p in range(2)]
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
