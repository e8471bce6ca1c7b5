"""Frequencies for curves, membership in boundaries and distances between them, against lines by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from percept.boundary.curves import FLOOR, adaptive_grid, curve_gap, depth_membership, magnitude_membership
from percept.boundary.records import Boundary
from percept.errors import UsageError
from percept.haptics import Device, magnitude_envelope


def envelope(omega: np.ndarray) -> np.ndarray:
    return np.stack(magnitude_envelope(omega, Device(1.0, 5.0), (8000.0, 10500.0), (7.0, 14.0), 1e-3))


def dense_error(omega: np.ndarray, values: np.ndarray) -> float:
    """Independent of the module's own measure: log-log interpolation on a fine grid, curve by curve."""
    fine = np.geomspace(omega[0], omega[-1], 20_011)
    true = envelope(fine)
    floor = FLOOR * true.max(axis=0)
    worst = 0.0
    for curve, points in zip(true, values, strict=True):
        line = np.exp(np.interp(np.log(fine), np.log(omega), np.log(np.maximum(points, 1e-300))))
        kept = curve > floor
        worst = max(worst, float(np.abs(line / curve - 1.0)[kept].max()))
    return worst


def test_lines_between_the_points_follow_a_resonant_envelope() -> None:
    grid = adaptive_grid(envelope, 0.1, 1000.0)
    assert dense_error(grid.omega, grid.values) < grid.departure <= 1e-3
    uniform = np.geomspace(0.1, 1000.0, grid.omega.size)
    assert dense_error(uniform, envelope(uniform)) > 3e-3  # the same number of points, evenly spread


def test_fewer_points_for_a_looser_tolerance() -> None:
    loose, tight = (adaptive_grid(envelope, 0.1, 1000.0, tolerance=t).omega for t in (1e-2, 1e-4))
    assert loose.size < tight.size / 2


def test_a_narrow_peak_is_found_where_it_is_pointed_at() -> None:
    def peak(omega: np.ndarray) -> np.ndarray:
        return 1.0 + 5.0 / (1.0 + (np.log(omega / 3.21) / 1e-3) ** 2)[None]

    blind = adaptive_grid(peak, 0.1, 100.0).omega
    seen = adaptive_grid(peak, 0.1, 100.0, including=np.array([3.21, 1e9])).omega
    assert seen.size > blind.size + 10
    assert 3.21 in seen
    assert seen[-1] == 100.0


def test_rows_that_are_not_followed_ask_for_no_points() -> None:
    def rough(omega: np.ndarray) -> np.ndarray:
        return np.stack([omega, omega * (1.0 + 0.1 * np.sin(1e4 * omega))])

    grid = adaptive_grid(rough, 0.1, 100.0, followed=np.array([True, False]))
    assert grid.omega.size < 60
    np.testing.assert_array_equal(grid.values, rough(grid.omega))


def test_a_corner_anywhere_in_an_interval_stays_within_the_tolerance() -> None:
    fine = np.geomspace(0.1, 100.0, 200_001)
    for corner in np.geomspace(2.0, 2.7, 40):

        def bent(omega: np.ndarray, corner: float = corner) -> np.ndarray:
            return np.maximum(1.0, omega / corner)[None]

        grid = adaptive_grid(bent, 0.1, 100.0)
        line = np.interp(np.log(fine), np.log(grid.omega), np.log(grid.values[0]))
        assert np.abs(line - np.log(bent(fine)[0])).max() <= grid.departure <= 1e-3


def test_what_no_number_of_points_can_follow_is_admitted() -> None:
    def rough(omega: np.ndarray) -> np.ndarray:
        return (1.0 + 0.1 * np.sin(1e6 * omega))[None]

    grid = adaptive_grid(rough, 0.1, 100.0)
    assert grid.departure > 1e-2
    assert 4096 <= grid.omega.size < 3 * 4096


def test_departure_is_twice_what_was_seen_in_the_middle() -> None:
    bend = 5e-4
    start = adaptive_grid(lambda omega: np.ones((1, omega.size)), 0.1, 10.0).omega[::2]

    def bent(omega: np.ndarray) -> np.ndarray:
        return np.where(np.isin(omega, start), 1.0, np.exp(0.5 * bend))[None]

    grid = adaptive_grid(bent, 0.1, 10.0)
    assert grid.omega.size == 2 * start.size - 1
    assert grid.departure == pytest.approx(bend)


@pytest.mark.parametrize(("lower", "upper"), [(0.0, 1.0), (2.0, 1.0)])
def test_wrong_range(lower: float, upper: float) -> None:
    with pytest.raises(UsageError, match="0 < lower < upper"):
        adaptive_grid(envelope, lower, upper)


def test_wrong_tolerance() -> None:
    with pytest.raises(UsageError, match="tolerance must lie in"):
        adaptive_grid(envelope, 1.0, 2.0, tolerance=0.0)


def test_around_a_pole_no_halving_goes_on_for_ever() -> None:
    """An undamped mode: endless at its frequency, which is pointed at."""
    pole = 50.0

    def curve(omega: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return (1.0 + omega / np.abs(1.0 - (omega / pole) ** 2))[None]

    grid = adaptive_grid(curve, 0.1, 1000.0, including=np.array([pole]))
    assert np.all(np.diff(grid.omega) > 0)
    assert np.isfinite(grid.values).all()
    assert grid.omega.size < 2500
    assert grid.departure <= 1e-3
    fine = np.geomspace(0.1, 1000.0, 40_001)
    fine = fine[np.abs(fine / pole - 1.0) > 1e-8]
    line = np.exp(np.interp(np.log(fine), np.log(grid.omega), np.log(grid.values[0])))
    assert np.abs(line / curve(fine)[0] - 1.0).max() < 1e-3


OMEGA = np.array([1.0, 10.0, 100.0])


def test_the_omega_where_a_curve_leaves_is_that_of_the_straight_lines() -> None:
    # log10 of the curve rises from 0 to 2 over two decades and meets the limit 10 at omega 10.
    found = magnitude_membership(OMEGA, np.full(3, 0.1), np.full(3, 10.0), np.array([1.0, 10.0, 100.0]))
    assert found.leaves == (pytest.approx((10.0, 100.0)),)
    assert found.inside == pytest.approx(0.5)
    assert found.margin == pytest.approx(-np.log(10.0))
    assert found.margin_omega == 100.0


def test_crossed_corner_curves_hold_nothing() -> None:
    found = magnitude_membership(OMEGA, np.full(3, 2.0), np.full(3, 1.0), np.full(3, 1.5))
    assert found.inside == 0.0
    assert found.leaves == (pytest.approx((1.0, 100.0)),)


def test_an_impedance_that_vanishes_is_outside() -> None:
    omega, ones = np.array([1.0, 2.0, 4.0]), np.ones(3)
    member = magnitude_membership(omega, 0.4 * ones, 2.0 * ones, np.array([1.0, 0.0, 1.0]))
    assert 0.0 < member.inside < 0.01
    assert member.margin < -700.0
    assert member.margin_omega == 2.0


def test_a_lower_limit_of_zero_cannot_be_left() -> None:
    found = magnitude_membership(OMEGA, np.zeros(3), np.full(3, 2.0), np.full(3, 1e-9))
    assert (found.inside, found.leaves) == (1.0, ())


@pytest.mark.parametrize(
    ("lower", "upper", "curve", "inside", "margin"),
    [
        # An endless impedance is beyond a finite limit, and within one that is endless too.
        ([0.1] * 3, [2.0] * 3, [1.0, np.inf, 1.0], (0.0, 0.01), -700.0),
        ([0.1] * 3, [2.0, np.inf, 2.0], [1.0, np.inf, 1.0], (1.0, 1.0), np.log(2.0)),
        # Nothing but zero lies between zero and zero; no finite impedance beyond an endless limit.
        ([0.0] * 3, [2.0, 0.0, 2.0], [1.0] * 3, (0.0, 0.01), -700.0),
        ([0.0] * 3, [2.0, 0.0, 2.0], [1.0, 0.0, 1.0], (1.0, 1.0), 0.0),
        ([0.1, np.inf, 0.1], [2.0, np.inf, 2.0], [1.0] * 3, (0.0, 0.01), -700.0),
        # Poles of curve and limit alone, at one end.
        ([0.1] * 3, [np.inf, 2.0, 2.0], [np.inf, 1.0, 1.0], (1.0, 1.0), np.log(2.0)),
    ],
)
def test_endless_and_vanishing_limits_and_impedances(lower, upper, curve, inside, margin) -> None:
    found = magnitude_membership(OMEGA, *(np.array(part) for part in (lower, upper, curve)))
    assert inside[0] <= found.inside <= inside[1]
    assert (found.leaves == ()) == (inside == (1.0, 1.0))
    if margin < 0:
        assert found.margin < margin
        assert found.margin_omega == 10.0
    else:
        assert found.margin == pytest.approx(margin, abs=1e-15)


# Halves and odd quarters: curves cross the limits, but never touch them at a frequency.
_FOUR = {"min_size": 4, "max_size": 4}


@given(st.lists(st.integers(-4, 4), **_FOUR), st.lists(st.integers(-4, 4), **_FOUR))
def test_share_and_intervals_agree_with_a_fine_grid(lows: list[int], curves: list[int]) -> None:
    omega = np.geomspace(0.1, 100.0, 4)
    low, curve = 0.5 * np.array(lows), 0.5 * np.array(curves) + 0.25
    lower, shown = np.exp(low), np.exp(curve)
    found = magnitude_membership(omega, lower, 4.0 * lower, shown)
    x = np.linspace(np.log(0.1), np.log(100.0), 3001)
    line, base = (np.interp(x, np.log(omega), values) for values in (curve, low))
    outside = (line < base) | (line > base + np.log(4.0))
    assert found.inside == pytest.approx(1.0 - outside.mean(), abs=4e-3)
    spans = np.log(np.array(found.leaves)).reshape(-1, 2)
    assert np.ptp(spans, axis=1).sum() / np.log(1000.0) == pytest.approx(1.0 - found.inside, abs=1e-9)


def test_curves_and_frequencies_that_do_not_fit_are_refused() -> None:
    with pytest.raises(UsageError, match="one value per omega"):
        depth_membership(OMEGA, np.zeros((1, 2)))
    with pytest.raises(UsageError, match="must be positive and increase"):
        depth_membership(OMEGA[::-1], np.zeros((1, 3)))


@pytest.mark.parametrize("first", [0.0, -1.0])
def test_frequencies_begin_above_zero(first: float) -> None:
    with pytest.raises(UsageError, match="must be positive and increase"):
        depth_membership(np.array([first, 1.0, 2.0]), np.ones((1, 3)))


@pytest.mark.parametrize("curve", [1.0, 2.0])
def test_a_curve_along_a_limit_is_inside(curve: float) -> None:
    found = magnitude_membership(OMEGA, np.full(3, 1.0), np.full(3, 2.0), np.full(3, curve))
    assert (found.inside, found.leaves, found.margin) == (1.0, (), 0.0)


def test_nothing_and_everything_are_exact_shares():
    omega = np.geomspace(0.1, 97.3, 57)
    depth = 1.0 + np.random.default_rng(4).random((1, 57))
    assert depth_membership(omega, -depth).inside == 0.0
    assert depth_membership(omega, depth).inside == 1.0


def test_depths_beyond_the_square_root_of_the_largest_number_cross_once() -> None:
    # An ellipse's logarithmic scale gives -1e300 where it does not reach; products would overflow.
    found = depth_membership(OMEGA, np.array([[-1e300, -1e300, 1.0]]))
    assert found.leaves == (pytest.approx((1.0, 100.0)),)
    assert found.margin == -1e300


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


def test_gap_of_curves_on_different_grids():
    omega = np.geomspace(10, 1000, 9)
    first = boundary(1.0, 2.0, omega=np.geomspace(1, 100, 5))
    gaps = curve_gap(first, boundary(1.0, 2.0 * omega / 10.0, omega=omega))
    assert (gaps["lower"].area, gaps["lower"].largest) == (0.0, 0.0)
    assert gaps["upper"].largest == pytest.approx(np.log(10.0))
    assert gaps["upper"].omega == pytest.approx(100.0)
    assert gaps["upper"].area == pytest.approx(np.log(10.0) / 2.0)
