"""Coordinates of spreads against dense Gaussian algebra in 60 digits."""

import mpmath
import numpy as np
import pytest
from mpmath import mp

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
