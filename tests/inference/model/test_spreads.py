"""Coordinates of spreads far out; `test_density` compares their law with the twin's."""

import numpy as np
import pytest

from percept.inference.model.spreads import SpreadMap


@pytest.mark.parametrize("omega", [1e-70, 1e70])
def test_extreme_spreads_are_finite(omega):
    columns = np.array([[1.0, 1.0, 1.0, 1.0], [-0.6, -0.1, 0.2, 0.5], [0.5, -0.5, 0.5, -0.5]])
    weight = np.array([38.0, 0.0, 2.0, 18.0])
    rough = np.array([-0.9, -2.0, -1.7, -1.2])
    u = np.array([[30.0], [-30.0], [0.0], [1.0]])
    spreads = SpreadMap(-1.6, columns, rough, weight)(np.ones((3, 1)), u, np.full(1, omega))
    for part in (spreads.log_sigma, spreads.multiples, spreads.log_density):
        assert np.isfinite(part).all()
