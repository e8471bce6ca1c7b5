from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from percept.boundary.gap import curve_gap
from percept.boundary.membership import depth_membership, magnitude_membership
from percept.boundary.realism import Displayed, Populations, realism
from percept.boundary.records import Boundary
from percept.errors import UsageError
from percept.haptics import Device, Environment, magnitude_envelope, perceived_impedance

OMEGA = np.array([1.0, 10.0, 100.0])


def boundary(omega: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Boundary:
    return Boundary(
        environment="VE1", kind="mean", method="classical", family="normal", joint="marginal",
        shape="envelope", level=0.99, omega=omega, lower=lower, upper=upper, reference=lower,
    )  # fmt: skip


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


def test_refused() -> None:
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


def test_gap_of_curves_on_different_grids() -> None:
    first = boundary(np.geomspace(1, 100, 5), np.full(5, 1.0), np.full(5, 2.0))
    omega = np.geomspace(10, 1000, 9)
    second = boundary(omega, np.full(9, 1.0), 2.0 * omega / 10.0)
    gaps = curve_gap(first, second)
    assert (gaps["lower"].area, gaps["lower"].largest) == (0.0, 0.0)
    assert gaps["upper"].largest == pytest.approx(np.log(10.0))
    assert gaps["upper"].omega == pytest.approx(100.0)
    assert gaps["upper"].area == pytest.approx(np.log(10.0) / 2.0)
    with pytest.raises(UsageError, match="no range of omega in common"):
        curve_gap(first, boundary(np.array([200.0, 300.0]), np.ones(2), np.ones(2)))


def test_realism_equals_a_loop_over_draws_and_frequencies() -> None:
    rng = np.random.default_rng(5)
    device, period, omega = Device(1.0, 5.0), 1e-3, np.geomspace(0.1, 100.0, 9)
    k_low, b_low = np.exp(rng.normal(6.85, 0.06, 200)), rng.normal(0.5, 0.3, 200)
    k_high, b_high = k_low * 1.15, b_low + 1.0
    shown = Environment(950.0, 1.2)
    displayed = Displayed(
        omega, np.abs(perceived_impedance(omega, device, shown, period)), np.full(9, 950.0), np.full(9, 1.2)
    )
    elsewhere = dataclasses.replace(displayed, magnitude=10.0 * displayed.magnitude)
    users = Populations((k_low, k_high), (b_low, b_high))
    far, found = realism([elsewhere, displayed], users, device, period)
    plane = (k_low <= 950) & (k_high >= 950) & (b_low <= 1.2) & (b_high >= 1.2)
    inside = np.empty((9, 200), dtype=bool)
    for m, s in np.ndindex(inside.shape):
        box = (k_low[s], k_high[s]), (b_low[s], b_high[s])
        lower, upper = magnitude_envelope(omega[m], device, *box, period)
        inside[m, s] = lower <= displayed.magnitude[m] <= upper
    assert found.plane_throughout == plane.mean()
    np.testing.assert_array_equal(found.plane, np.full(9, plane.mean()))
    np.testing.assert_array_equal(found.magnitude, inside.mean(axis=1))
    assert found.magnitude_throughout == inside.all(axis=0).mean()
    assert 0.1 < found.plane_throughout < found.magnitude_throughout < 0.9
    assert far.magnitude_throughout == 0.0
    assert far.plane_throughout == found.plane_throughout


def test_realism_throughout_counts_every_frequency_however_many_draws() -> None:
    draws = 1 << 17  # too many for three frequencies at once
    device, omega, ones = Device(1.0, 5.0), np.array([1.0, 10.0, 100.0]), np.ones(3)
    users = Populations(
        (np.full(draws, 900.0), np.full(draws, 1100.0)), (np.full(draws, 1.0), np.full(draws, 3.0))
    )
    stiffness = np.array([2000.0, 1000.0, 1000.0])  # outside at the first omega alone
    shown = np.abs(perceived_impedance(omega, device, Environment(stiffness, 2.0), 1e-3))
    (found,) = realism([Displayed(omega, shown, stiffness, 2.0 * ones)], users, device, 1e-3)
    assert found.magnitude.tolist() == found.plane.tolist() == [0.0, 1.0, 1.0]
    assert (found.magnitude_throughout, found.plane_throughout) == (0.0, 0.0)


def test_the_limits_of_a_population_are_real_themselves() -> None:
    users = Populations((np.array([900.0]), np.array([1100.0])), (np.array([1.0]), np.array([3.0])))
    device, omega = Device(1.0, 5.0), np.ones(1)
    limits = magnitude_envelope(omega, device, users.stiffness, users.damping, 1e-3)
    for magnitude, stiffness, damping in zip(limits, users.stiffness, users.damping, strict=True):
        (found,) = realism([Displayed(omega, magnitude, stiffness, damping)], users, device, 1e-3)
        assert (found.magnitude_throughout, found.plane_throughout) == (1.0, 1.0)


def test_realism_needs_draws() -> None:
    nothing = (np.empty(0), np.empty(0))
    displayed = Displayed(*(np.ones(1) for _ in range(4)))
    with pytest.raises(UsageError, match="at least one posterior draw"):
        realism([displayed], Populations(nothing, nothing), Device(1.0, 5.0), 1e-3)


def test_displays_are_judged_at_the_same_frequencies() -> None:
    one, other = (Displayed(np.full(1, omega), *(np.ones(1) for _ in range(3))) for omega in (1.0, 2.0))
    limits = (np.zeros(3), np.ones(3))
    with pytest.raises(UsageError, match="need the same omega"):
        realism([one, other], Populations(limits, limits), Device(1.0, 5.0), 1e-3)


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
