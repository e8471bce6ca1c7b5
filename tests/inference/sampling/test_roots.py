"""Roots against closed forms; how many calls they take; what happens where steps cannot be
trusted."""

import numpy as np
import pytest

from percept.inference.sampling.roots import root


class Counted:
    """A function with its slope, and the places it was called at."""

    def __init__(self, value, slope):
        self._value, self._slope = value, slope
        self.places = []

    def __call__(self, x):
        self.places.append(x)
        return self._value(x), self._slope(x)


def bent():
    """x + x³/10 - c, whose roots are known: those of c = r + r³/10."""
    wanted = np.array([-2.0, -0.3, 0.0, 0.7, 1.9])
    c = wanted + 0.1 * wanted**3
    return Counted(lambda x: x + 0.1 * x**3 - c, lambda x: 1.0 + 0.3 * x * x), wanted


def test_roots_side_by_side_are_each_exact():
    function, wanted = bent()
    found = root(function, np.ones(5), np.full(5, -5.0), np.full(5, 5.0), np.ones(5), 1e-16)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=4e-16)


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
