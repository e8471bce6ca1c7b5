"""Coupling design: published limits, the forward problem, and the shape of the stable region."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Mode,
    TabulatedDevice,
    best_coupling_damping,
    max_coupling_stiffness,
    max_coupling_stiffness_at,
    required_damping,
    required_damping_at,
    stable_region,
)

T = 1e-3
BOTH = [(d, h) for d in ("backward", "tustin") for h in ("average", "true")]


@pytest.mark.parametrize(
    ("device_damping", "limit"), [(15, 37_951), (16, 52_292), (18, 79_991), (20, 106_664), (25, 170_099)]
)
def test_largest_stiffness_at_100(device_damping, limit):
    assert round(float(max_coupling_stiffness(device_damping, 100.0, T))) == limit


def test_nothing_below_an_eighth():
    np.testing.assert_array_equal(max_coupling_stiffness([0.0, 5.0, 12.5], 100.0, T), 0.0)
    assert max_coupling_stiffness(12.5 * (1 + 1e-12), 100.0, T) > 0


def test_best_damping_of_a_stiffness():
    best = best_coupling_damping(1 / T, T)
    assert f"{best.coupling_damping:.4g}" == "0.1248"
    assert f"{best.device_damping:.5g}" == "0.10695"
    assert required_damping(Coupling(110e3, 0.0), T).damping == pytest.approx(110e3 * T / 8, rel=1e-15)


@pytest.mark.parametrize(("discretization", "kind"), BOTH)
def test_best_damping_is_the_lowest_of_many(discretization, kind):
    options = {"discretization": discretization, "hold": kind}
    best = best_coupling_damping([1e3, 2e5], T, **options)
    need = required_damping(Coupling([1e3, 2e5], best.coupling_damping), T, **options)
    np.testing.assert_allclose(need.damping, best.device_damping, rtol=1e-14)
    others = required_damping(Coupling(2e5, np.linspace(0, 500, 20_001)), T, **options).damping
    assert others.min() >= best.device_damping[1] * (1 - 1e-14)
    assert others.min() <= best.device_damping[1] * (1 + 1e-3)


@settings(max_examples=200, deadline=None)
@given(
    device=st.floats(1e-6, 1e6),
    ratio=st.one_of(st.just(0.0), st.floats(1e-9, 20.0)),
    case=st.sampled_from(BOTH),
)
def test_largest_stiffness_needs_exactly_the_damping_there_is(device, ratio, case):
    options = dict(zip(("discretization", "hold"), case, strict=True))
    coupling = ratio * device
    limit = float(max_coupling_stiffness(device, coupling, T, **options))
    if limit == 0:
        # Even a negligible stiffness asks too much, or Tustin's coupling has no damping.
        need = required_damping(Coupling(1e-9 * device / T, coupling), T, **options).damping
        assert need >= device * (1 - 1e-12)
    else:
        need = required_damping(Coupling(limit, coupling), T, **options).damping
        # At the edge of the region K is a square root of what is left, so the forward problem is the milder.
        assert need == pytest.approx(device, rel=1e-12)


@pytest.mark.parametrize(("discretization", "kind"), BOTH)
def test_limit_at_each_omega_solves_equation_10(discretization, kind):
    options = {"discretization": discretization, "hold": kind}
    omega = np.concatenate([[0.0], np.geomspace(1e-6, 3141.0, 40)])[:, None]
    b_c = np.array([0.0, 1.0, 90.0, 400.0])
    device = Device(1.0, 20.0, (Mode(0.05, 2e4, 0.3),))
    limit = max_coupling_stiffness_at(omega, device, b_c, T, **options)
    available = np.array([[float(_available(device, w))] for w in omega[:, 0]])
    need = np.where(
        limit > 0, required_damping_at(omega, Coupling(np.minimum(limit, 1e90), b_c), T, **options), np.nan
    )
    met = np.isfinite(limit) & (limit > 0)
    np.testing.assert_allclose(need[met], np.broadcast_to(available, need.shape)[met], rtol=1e-12)
    none = required_damping_at(omega, Coupling(1e-9, b_c), T, **options)
    assert (none[limit == 0] >= np.broadcast_to(available, none.shape)[limit == 0] * (1 - 1e-9)).all()


def _available(device, omega):
    from percept.haptics import device_impedance

    return device_impedance(omega, device, T).real


def test_smallest_limit_over_omega_is_the_rigid_limit():
    omega = np.concatenate([[0.0], np.linspace(1.0, np.pi / T, 20_001)])
    for b_d, b_c in ((15.0, 100.0), (20.0, 20.0), (20.0, 5.0)):
        seen = max_coupling_stiffness_at(omega, Device(3.0, b_d), b_c, T).min()
        assert seen == pytest.approx(max_coupling_stiffness(b_d, b_c, T), rel=1e-6)


def test_limit_at_nyquist_and_for_an_active_device():
    assert max_coupling_stiffness_at(np.pi / T, Device(1.0, 5.0), 10.0, T) == np.inf
    active = TabulatedDevice([1.0, 100.0], [-1.0, -1.0])
    np.testing.assert_array_equal(max_coupling_stiffness_at([1.0, 50.0], active, 10.0, T), 0.0)


@pytest.mark.parametrize(("discretization", "kind"), BOTH)
def test_region_has_its_edge_where_the_device_is_used_up(discretization, kind):
    options = {"discretization": discretization, "hold": kind}
    region = stable_region(20.0, T, points=65, **options)
    k, b = region.stiffness, region.damping
    need = required_damping(Coupling(k, b), T, **options).damping
    corner = (k == 0) & ((b == 0) | (kind == "true"))
    np.testing.assert_allclose(need[~corner], 20.0, rtol=1e-12)
    assert (need[corner] <= 20.0 * (1 + 1e-12)).all()
    # Inside: between neighbours and towards the middle; outside: further out.
    middle = required_damping(
        Coupling((k + np.roll(k, 1)) / 2, (b + np.roll(b, 1)) / 2), T, **options
    ).damping
    assert (middle[k + np.roll(k, 1) > 0] <= 20.0 * (1 + 1e-12)).all()
    out = required_damping(Coupling(1.001 * k, 1.001 * b), T, **options).damping
    assert (out[~corner] > 20.0).all()


def test_region_reaches_the_stiffest_coupling():
    region = stable_region(20.0, T, points=2049)
    stiffest = 20.0 / best_coupling_damping(1.0, T).device_damping
    assert region.stiffness.max() == pytest.approx(stiffest, rel=1e-6)
    assert region.stiffness.max() <= stiffest * (1 + 1e-14)
    assert region.damping.max() == pytest.approx(160.0)
    assert region.device_damping == 20.0


@pytest.mark.parametrize(("discretization", "kind"), BOTH)
def test_the_polygon_of_a_region_has_the_area_under_the_largest_stiffness(discretization, kind):
    options = {"discretization": discretization, "hold": kind}
    region = stable_region(2.0, T, points=4001, **options)
    k, b = region.stiffness, region.damping
    area = 0.5 * abs(np.sum(k * np.roll(b, -1) - b * np.roll(k, -1)))
    lines = np.linspace(0.0, 20.0, 20_001)  # N·s/m; at most 8 times 2 are stable
    top = max_coupling_stiffness(2.0, lines, T, **options)
    assert top[-1] == 0
    # Where an edge ends on its way trapezoids miss half of one, less than 2e-4 of the area.
    assert area == pytest.approx(np.trapezoid(top, lines), rel=1e-3)


def test_no_stiffness_where_the_coupling_damping_alone_asks_too_much_at_nyquist():
    options = {"discretization": "tustin", "hold": "true"}
    nyquist = np.pi / T
    # b_c/π is asked for at Nyquist, whatever the stiffness.
    assert required_damping_at(nyquist, Coupling(1e-6, 100.0), T, **options) == pytest.approx(100 / np.pi)
    assert max_coupling_stiffness_at(nyquist, Device(0.0, 31.0), 100.0, T, **options) == 0.0
    assert max_coupling_stiffness_at(nyquist, Device(0.0, 32.0), 100.0, T, **options) == np.inf


def test_region_of_a_device_without_damping_is_a_point():
    region = stable_region(0.0, T, discretization="tustin")
    assert region.stiffness.max() == 0
    assert region.damping.max() == 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: max_coupling_stiffness(-1.0, 1.0, T), "device damping must not be negative"),
        (lambda: max_coupling_stiffness(1.0, np.nan, T), "coupling damping must be finite"),
        (lambda: max_coupling_stiffness(1.0, 1.0, T, hold="foh"), "hold must be one of"),
        (lambda: best_coupling_damping(-1.0, T), "stiffness must not be negative"),
        (lambda: stable_region([1.0, 2.0], T), "one device damping"),
        (lambda: stable_region(1.0, T, points=1), "points must be a whole number of at least 2"),
        (lambda: stable_region(1.0, T, points=2.5), "points must be a whole number of at least 2"),
        (lambda: stable_region(1.0, T, discretization="zoh"), "discretization must be one of"),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
