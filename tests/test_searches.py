"""Solvers: minima seen on a grid, and roots inside a bracket."""

import numpy as np
import pytest

from percept.searches import lowest, rising_root, root


def test_the_lowest_of_several_dips_is_found_though_another_looks_lower_on_the_grid():
    grid = np.linspace(0.0, 1.0, 11)
    place, depth = np.array([0.37, 0.43, 0.25]), np.array([1.0, 2.0, 0.5])

    def functions(x, which):
        # A dip between the grid's points, and one on it that is shallower by less than the grid
        # sees.
        deep = 50.0 * (x - place[which]) ** 2 - depth[which]
        return np.minimum(deep, 50.0 * (x - 0.9) ** 2 - depth[which] + 0.01)

    found = lowest(functions, grid, 3)
    # A parabola is flat to rounding within the root of a double's digits.
    np.testing.assert_allclose(found.x, place, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.value, -depth, rtol=1e-13)


def test_a_function_that_is_lowest_at_an_end_or_level_or_endless_is_lowest_there():
    grid, slopes = np.linspace(1.0, 2.0, 9), np.array([1.0, -1.0, 0.0])
    found = lowest(lambda x, which: slopes[which] * x, grid, 3)
    assert found.value.tolist() == [1.0, -2.0, 0.0]
    assert found.x[:2].tolist() == [1.0, 2.0]
    found = lowest(
        lambda x, which: np.full(np.broadcast_shapes(x.shape, which.shape), np.inf), grid, 2
    )
    assert found.value.tolist() == [np.inf, np.inf]


def test_roots_are_found_over_many_decades_and_where_newton_alone_would_leave_the_bracket():
    exact = np.array([0.0, 1e-150, 3e-7, 1.0, 40.0])

    def cubic(which, x):
        return x**3 - exact[which] ** 3, 3 * x**2

    def arctangent(which, x):
        return np.arctan(x - exact[which]), 1 / (1 + (x - exact[which]) ** 2)

    low, high = np.zeros(5), np.full(5, 100.0)
    np.testing.assert_allclose(
        rising_root(arctangent, high, low, high), exact, rtol=1e-15, atol=1e-14
    )
    np.testing.assert_allclose(rising_root(cubic, high, low, high)[2:], exact[2:], rtol=1e-15)


class Counted:
    """A function with its slope, and the places it was called at."""

    def __init__(self, value, slope):
        self._value, self._slope = value, slope
        self.places = []

    def __call__(self, x):
        self.places.append(x)
        return self._value(x), self._slope(x)


def test_a_step_out_of_the_bracket_becomes_its_middle():
    """Far out the slope of tanh is next to nothing and Newton's step leaves the bracket."""
    function = Counted(np.tanh, lambda x: 1.0 / np.cosh(x) ** 2)
    found = root(function, np.array([8.0]), np.array([-20.0]), np.array([10.0]), np.ones(1), 1e-16)
    np.testing.assert_array_equal(function.places[1], [-6.0])
    assert abs(found[0]) < 1e-16


@pytest.mark.parametrize("slope", [0.0, np.nan])
def test_without_slopes_brackets_are_halved(slope):
    function = Counted(lambda x: x - 0.3, lambda x: np.full_like(x, slope))
    found = root(function, np.array([0.9]), np.array([0.0]), np.array([1.0]), np.ones(1), 1e-12)
    assert abs(found[0] - 0.3) < 2e-12
