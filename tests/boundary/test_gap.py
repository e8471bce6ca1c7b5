"""Distances between boundaries, against logarithms worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from percept.boundary.gap import curve_gap
from percept.boundary.records import Boundary
from percept.errors import UsageError


def boundary(lower, upper, omega=(0.1, 1.0, 10.0)):
    omega = np.array(omega)
    curve = np.ones_like(omega)
    return Boundary(
        environment="VE1", omega=omega, reference=curve, coupled=None, departure=None,
        lower=lower * curve, upper=upper * curve, shape="envelope", kind="user", method="classical",
        family="lognormal", joint="marginal", level=0.99,
    )  # fmt: skip


def test_ratios_of_constant_curves():
    gaps = curve_gap(boundary(1.0, 10.0), boundary(2.0, 5.0))
    assert gaps["lower"].area == pytest.approx(np.log(2.0), rel=1e-14)
    assert gaps["lower"].largest == pytest.approx(np.log(2.0), rel=1e-14)
    assert gaps["upper"].area == pytest.approx(np.log(2.0), rel=1e-14)
    assert gaps["upper"].largest == pytest.approx(-np.log(2.0), rel=1e-14)


def test_an_upper_limit_far_away_hides_nothing():
    """Two subjects leave upper limits that have run away; the lower ones still differ by what they do."""
    gaps = curve_gap(boundary(2.0, 7.9e12), boundary(686.0, 3.6e4))
    assert gaps["lower"].largest == pytest.approx(np.log(343.0), rel=1e-14)
    assert gaps["upper"].largest == pytest.approx(np.log(3.6e4 / 7.9e12), rel=1e-14)


def test_lower_limits_of_zero_count_as_a_millionth_of_the_smaller_upper_limit():
    gaps = curve_gap(boundary(0.0, 100.0), boundary(1.0, 10.0))
    assert gaps["lower"].largest == pytest.approx(np.log(1e5), rel=1e-14)
    assert curve_gap(boundary(0.0, 100.0), boundary(0.0, 10.0))["lower"].area == 0.0


def test_only_the_range_in_common_counts():
    gaps = curve_gap(boundary(1.0, 2.0), boundary(1.0, 4.0, omega=(1.0, 3.0, 100.0)))
    assert 1.0 <= gaps["upper"].omega <= 10.0
    with pytest.raises(UsageError, match="no range of omega in common"):
        curve_gap(boundary(1.0, 2.0), boundary(1.0, 4.0, omega=(20.0, 30.0)))


def test_ranges_that_touch_in_one_point_have_no_range_in_common():
    with pytest.raises(UsageError, match="no range of omega in common"):
        curve_gap(boundary(1.0, 2.0), boundary(1.0, 4.0, omega=(10.0, 20.0)))


def test_the_largest_gap_is_the_farthest_either_way():
    gap = curve_gap(boundary(1.0, 2.0), boundary(0.01, np.array([4.0, 2.0, 0.2])))["upper"]
    assert gap.largest == pytest.approx(np.log(0.1), rel=1e-14)
    assert gap.omega == 10.0
