"""What a device can carry: published limits, forward problem, stable region, passive rendering."""

from pathlib import Path

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
    device_impedance,
    max_coupling_stiffness,
    required_damping,
    required_damping_at,
)
from percept.haptics.limits import (
    stiffness_limits,
)

T = 1e-3
GOLDEN = Path(__file__).resolve().parents[1] / "golden"
STIFFNESS = np.array([10.0, 1000.0, 10000.0, 25000.0, 50000.0])
DAMPING = np.array([0.1, 1.0, 10.0, 25.0, 50.0])
BOTH = [(d, h) for d in ("backward", "tustin") for h in ("average", "true")]


@pytest.mark.parametrize(
    ("device_damping", "limit"),
    [(15, 37_951), (16, 52_292), (18, 79_991), (20, 106_664), (25, 170_099)],
)
def test_largest_stiffness_at_100(device_damping, limit):
    assert round(float(max_coupling_stiffness(device_damping, 100.0, T))) == limit


def test_nothing_below_an_eighth():
    np.testing.assert_array_equal(max_coupling_stiffness([0.0, 5.0, 12.5], 100.0, T), 0.0)
    assert max_coupling_stiffness(12.5 * (1 + 1e-12), 100.0, T) > 0


def test_damping_that_an_undamped_coupling_needs():
    assert required_damping(Coupling(110e3, 0.0), T).damping == pytest.approx(
        110e3 * T / 8, rel=1e-15
    )


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
        # At the edge of the region K is a square root of what is left, so the forward problem is
        # the milder.
        assert need == pytest.approx(device, rel=1e-12)


@pytest.mark.parametrize("kind", ["average", "true"])
def test_limit_at_each_omega_solves_equation_10(kind):
    omega = np.concatenate([[0.0], np.geomspace(1e-6, 3141.0, 40)])[:, None]
    b_c = np.array([0.0, 1.0, 90.0, 400.0])
    device = Device(1.0, 20.0, (Mode(0.05, 2e4, 0.3),))
    limit = stiffness_limits(omega, device, b_c, T, kind)
    available = np.broadcast_to(device_impedance(omega, device, T).real, limit.shape)
    met = np.isfinite(limit) & (limit > 0)
    need = required_damping_at(omega, Coupling(np.where(met, limit, 0.0), b_c), T, hold=kind)
    np.testing.assert_allclose(need[met], available[met], rtol=1e-12)
    none = required_damping_at(omega, Coupling(1e-9, b_c), T, hold=kind)
    assert (none[limit == 0] >= available[limit == 0] * (1 - 1e-9)).all()


def test_smallest_limit_over_omega_is_the_rigid_limit():
    omega = np.concatenate([[0.0], np.linspace(1.0, np.pi / T, 20_001)])
    for b_d, b_c in ((15.0, 100.0), (20.0, 20.0), (20.0, 5.0)):
        seen = stiffness_limits(omega, Device(3.0, b_d), np.float64(b_c), T, "average").min()
        assert seen == pytest.approx(max_coupling_stiffness(b_d, b_c, T), rel=1e-6)


def test_limit_at_nyquist_and_for_an_active_device():
    ten = np.float64(10.0)
    assert stiffness_limits(np.pi / T, Device(1.0, 5.0), ten, T, "average") == np.inf
    active = TabulatedDevice([1.0, 100.0], [-1.0, -1.0])
    np.testing.assert_array_equal(stiffness_limits([1.0, 50.0], active, ten, T, "average"), 0.0)


def test_no_stiffness_where_the_coupling_damping_alone_asks_too_much_at_nyquist():
    nyquist, b_c = np.pi / T, np.float64(100.0)
    # b_c/π is asked for at Nyquist, whatever the stiffness.
    need = required_damping_at(nyquist, Coupling(1e-6, 100.0), T, hold="true")
    assert need == pytest.approx(100 / np.pi)
    assert stiffness_limits(nyquist, Device(0.0, 31.0), b_c, T, "true") == 0.0
    assert stiffness_limits(nyquist, Device(0.0, 32.0), b_c, T, "true") > 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: max_coupling_stiffness(-1.0, 1.0, T), "device damping must not be negative"),
        (lambda: max_coupling_stiffness(1.0, np.nan, T), "coupling damping must be finite"),
        (lambda: max_coupling_stiffness(1.0, 1.0, T, hold="foh"), "hold must be one of"),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
