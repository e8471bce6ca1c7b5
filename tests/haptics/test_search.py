"""Solvers: minima seen on a grid, and roots inside a bracket."""

import numpy as np
import pytest

from percept.haptics.search import local_minima, rising_root


@pytest.mark.parametrize("place", [0.37, 0.43])
def test_a_minimum_on_either_side_of_the_lowest_point_of_the_grid_is_found(place):
    found = local_minima(lambda x: (x - place) ** 2, np.linspace(0.0, 1.0, 11))
    # A parabola is flat to rounding within the root of a double's digits.
    np.testing.assert_allclose(found, [place], rtol=0, atol=1e-7)


def test_roots_are_found_over_many_decades_and_where_newton_alone_would_leave_the_bracket():
    exact = np.array([0.0, 1e-150, 3e-7, 1.0, 40.0])

    def cubic(which, x):
        return x**3 - exact[which] ** 3, 3 * x**2

    def arctangent(which, x):
        return np.arctan(x - exact[which]), 1 / (1 + (x - exact[which]) ** 2)

    low, high = np.zeros(5), np.full(5, 100.0)
    np.testing.assert_allclose(rising_root(arctangent, high, low, high), exact, rtol=1e-15, atol=1e-14)
    np.testing.assert_allclose(rising_root(cubic, high, low, high)[2:], exact[2:], rtol=1e-15)
