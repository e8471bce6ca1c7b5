"""Oracles shared by the tests of haptics."""

import numpy as np
import pytest

T = 1e-3


@pytest.fixture(scope="session")
def plain_impedance():
    """Z_h of a rigid device as Eq. 13 is written, in complex arithmetic; k and b of any sign."""

    def impedance(omega, device, k, b, mass=0.0):
        h = omega * T / 2
        s = 2j / T * np.tan(h)
        return (
            device.mass * s + device.damping + np.cos(h) * np.exp(-1j * h) * (mass * s + b + k / s)
        )

    return impedance


@pytest.fixture(scope="session")
def ellipse_edge():
    """Points (k, b) around an ellipse, closed."""

    def edge(centre, shape, radius, count=40_001):
        angle = np.linspace(0, 2 * np.pi, count)
        circle = np.array([np.cos(angle), np.sin(angle)])
        return np.array(centre)[:, None] + radius * np.linalg.cholesky(shape) @ circle

    return edge
