"""Frequencies for curves, membership in boundaries and distances between them, against lines by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from percept.boundary.curves import curve_gap, depth_membership, drawing_grid, magnitude_membership
from percept.boundary.records import Boundary
from percept.errors import UsageError
from percept.haptics import Device, Environment, corner_curves, magnitude_envelope, perceived_impedance


def drawn(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One own curve with a dip at 31.6 rad/s, and an envelope and a pair of corners about it."""
    device, limits = Device(1.0, 5.0), ((800.0, 1200.0), (2.0, 8.0))
    own = np.abs(perceived_impedance(omega, device, Environment(1000.0, 4.0), 1e-3))[None]
    outlines = [magnitude_envelope(omega, device, *limits, 1e-3), corner_curves(omega, device, *limits, 1e-3)]
    return own, np.array(outlines)


def test_grid_is_even_with_resonances_turns_and_crossings() -> None:
    grid = drawing_grid(drawn, 0.1, 1000.0, np.array([np.sqrt(1000.0), 1e9]))
    assert np.isin(np.geomspace(0.1, 1000.0, 161), grid).all()
    assert (np.diff(np.log(grid)) > 1.9e-3).all()
    fine = np.geomspace(0.1, 1000.0, 400_001)
    own, limits = drawn(fine)
    rows = np.concatenate([own, limits.reshape(-1, fine.size)])
    inner = rows[:, 1:-1]
    turns = ((inner - rows[:, :-2]) * (rows[:, 2:] - inner) < 0).any(axis=0)
    gaps = np.stack([limits[1, 1] - limits[1, 0], own[0] - limits[1, 0], own[0] - limits[1, 1]])
    crossings = (gaps[:, :-1] * gaps[:, 1:] < 0).any(axis=0)
    known = np.concatenate([fine[1:-1][turns], fine[:-1][crossings]])
    assert known.size > 5
    nearest = np.abs(np.log(known[:, None] / grid)).min(axis=1)
    # Where a parabola or a line puts them, or a point that is nearer than points may be.
    assert nearest.max() < 4e-3


def test_lines_between_the_points_follow_the_curves() -> None:
    grid = drawing_grid(drawn, 0.1, 1000.0, np.array([np.sqrt(1000.0)]))
    fine = np.geomspace(0.1, 1000.0, 20_011)
    for curve, points in zip(
        drawn(fine)[1].reshape(-1, fine.size), drawn(grid)[1].reshape(-1, grid.size), strict=True
    ):
        line = np.interp(np.log(fine), np.log(grid), np.log(points))
        assert np.abs(line - np.log(curve)).max() < 0.03


def test_a_pole_is_left_out() -> None:
    def curve(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(divide="ignore"):
            own = (1.0 + omega / np.abs(1.0 - (omega / 50.0) ** 2))[None]
        return own, np.stack([0.5 * own, 2.0 * own], axis=1)

    grid = drawing_grid(curve, 0.1, 1000.0, np.array([50.0]))
    assert 50.0 not in grid
    assert np.isfinite(curve(grid)[0]).all()


@pytest.mark.parametrize(("lower", "upper"), [(0.0, 1.0), (2.0, 1.0)])
def test_wrong_range(lower: float, upper: float) -> None:
    with pytest.raises(UsageError, match="0 < lower < upper"):
        drawing_grid(drawn, lower, upper, np.empty(0))


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
        environment="VE1", omega=omega, reference=curve, coupled=None,
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
