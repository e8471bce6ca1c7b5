"""Simultaneous bands against enumeration and simulation."""

import itertools

import numpy as np
import pytest

from percept.calibration.bands import EcdfBand, ecdf_band


def test_probability_equals_enumeration():
    """All ways to put 6 values into 4 bins, each with its multinomial probability."""
    band = EcdfBand(6, 4, 0.2)
    inside = 0
    for bins in itertools.product(range(4), repeat=6):
        below = np.cumsum(np.bincount(bins, minlength=4))[:3]
        inside += np.all((below >= band.lower) & (below <= band.upper))
    assert abs(band.probability() - inside / 4**6) < 1e-13


@pytest.mark.parametrize(("count", "error"), [(50, 0.05), (400, 0.01)])
def test_band_holds_uniform_values_as_often_as_stated(count, error):
    band = ecdf_band(count, 20, error)
    assert 1 - error <= band.probability() < 1 - 0.6 * error  # counts are whole: a little wide at most
    rng = np.random.default_rng(1)
    repeats = 4000
    held = sum(band.holds(rng.random(count)) for _ in range(repeats))
    sd = np.sqrt(repeats * band.probability() * (1 - band.probability()))
    assert abs(held - repeats * band.probability()) < 4.5 * sd


def test_narrower_bands_would_fail():
    band = ecdf_band(200, 20, 0.01)
    assert EcdfBand(200, 20, 1.2 * band.tail).probability() < 0.99


@pytest.mark.parametrize("power", [0.7, 1.4])
def test_values_that_are_not_uniform_leave_the_band(power):
    values = np.random.default_rng(2).random(400) ** power
    band = ecdf_band(400, 20, 0.01)
    assert not band.holds(values)
    assert band.least_tail(values) < band.tail


def test_counts_and_tails_by_hand():
    band = EcdfBand(4, 2, 0.5)
    values = np.array([0.1, 0.5, 0.9, 0.2])
    assert band.below(values).tolist() == [2]  # a value on an edge is not below it
    assert band.least_tail(values) == 1.0
    assert band.least_tail(np.array([0.9, 0.8, 0.7, 0.6])) == pytest.approx(2 / 16)
