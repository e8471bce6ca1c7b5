"""Oracles shared by the tests of haptics."""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def ellipse_edge():
    """Points (k, b) around an ellipse, closed."""

    def edge(centre, shape, radius, count=40_001):
        angle = np.linspace(0, 2 * np.pi, count)
        circle = np.array([np.cos(angle), np.sin(angle)])
        return np.array(centre)[:, None] + radius * np.linalg.cholesky(shape) @ circle

    return edge
