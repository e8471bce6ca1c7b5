"""Limits of functions of the coordinates, by densities on lines, against laws that are known."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.sampling.gate import Estimates, Settings
from percept.inference.sampling.lines import line_limits
from percept.inference.sampling.run import sample
from tests.inference.sampling.targets import Correlated

TARGET = Correlated(4)
WEIGHTS = np.array([1.0, -0.5, 0.2, 0.1]) @ TARGET.inverse


class First:
    """The mean of the first coordinate, to any accuracy that is asked."""

    def components(self, points):
        return points[:, :1]

    def estimates(self, components):
        centred = components - components.mean(axis=0)
        yield Estimates(("x[0]",), components.mean(axis=0), 3.0 * components.std(axis=0)), centred


@pytest.fixture(scope="module")
def run():
    return sample(TARGET, First(), Settings(tolerance=0.02, seed=3))


@pytest.mark.parametrize("level", [0.9, 0.99])
@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_limits_are_the_quantiles_of_the_function(run, level, bend):
    """A combination of normals, straight or bent, to within four of the errors that are stated."""
    sd = np.sqrt(1.0 + 0.5**2 + 0.2**2 + 0.1**2)

    def function(points):
        combined = points @ WEIGHTS
        return combined + bend * np.expm1(0.5 * combined)

    found = line_limits(TARGET, run, function, level)
    ends = sd * stats.norm.ppf([0.5 * (1.0 - level), 0.5 * (1.0 + level), 0.5])
    expected = ends + bend * np.expm1(0.5 * ends)
    half_width = 0.5 * (expected[1] - expected[0])
    allowed = (4.0 * found.error + 1e-3) * half_width
    assert abs(found.lower - expected[0]) < allowed
    assert abs(found.upper - expected[1]) < allowed
    assert abs(found.median - expected[2]) < allowed
    assert found.error <= 0.02


def test_what_a_line_leaves_out_is_told_as_error(run):
    """A function that no straight line follows has larger errors, and its limits keep to them."""

    def function(points):
        white = points @ TARGET.inverse.T
        return white[:, 0] + white[:, 1] ** 2

    found = line_limits(TARGET, run, function, 0.9)
    exact = TARGET.exact(400_000, np.random.default_rng(1))
    lower, upper = np.quantile(function(exact), [0.05, 0.95])
    allowed = (4.0 * found.error + 5e-3) * 0.5 * (upper - lower)
    assert abs(found.lower - lower) < allowed
    assert abs(found.upper - upper) < allowed
