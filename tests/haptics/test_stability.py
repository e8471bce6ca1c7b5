"""Required damping, margins, the bound of Fig. 4, verdicts: known numbers, searches, limits."""

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
    absolute_stability,
    coupling_impedance,
    device_impedance,
    required_damping,
    required_damping_at,
    stability_margin,
)
from percept.haptics.impedance import coupling_admittance
from percept.haptics.stability import coupling_bound

T = 1e-3
COUPLING = Coupling(110e3, 100.0)
MODES = (Mode(0.05, 2e4, 0.3), Mode(0.02, 5e4, 0.2))


@pytest.mark.parametrize(
    ("stiffness", "discretization", "damping", "omega"),
    [
        (110e3, "backward", "20.2548", "2022.65"),
        (50e3, "backward", "15.8384", "2073.2"),
        (110e3, "tustin", "14.0492", None),
        (50e3, "tustin", "12.7705", None),
    ],
)
def test_published_couplings(stiffness, discretization, damping, omega):
    need = required_damping(Coupling(stiffness, 100.0), T, discretization=discretization)
    assert f"{need.damping:.6g}" == damping
    if omega:
        assert f"{need.omega:.6g}" == omega


def test_true_hold_asks_most_at_nyquist():
    need = required_damping(Coupling(110e3, 100.0), T, hold="true")
    assert f"{need.damping:.2f}" == "49.34"
    assert need.omega == np.pi / T


def test_low_frequency_keeps_fifteen_digits():
    value = float(required_damping_at(1e-6, Coupling(110e3, 100.0), T))
    assert abs(value - 4.879032258064516) <= 1e-15 * value


OMEGA = np.concatenate(
    [[0.0], np.geomspace(1e-3, np.pi / T, 40_001), np.linspace(0, np.pi / T, 40_001)]
)


@settings(max_examples=60, deadline=None)
@given(
    stretch=st.floats(1e-4, 1e4),
    damping=st.one_of(st.just(0.0), st.floats(1e-4, 1e4)),
    discretization=st.sampled_from(["backward", "tustin"]),
    kind=st.sampled_from(["average", "true"]),
)
def test_closed_form_is_the_maximum_over_omega(stretch, damping, discretization, kind):
    coupling = Coupling(stretch / T, damping)
    options = {"discretization": discretization, "hold": kind}
    need = required_damping(coupling, T, **options)
    seen = required_damping_at(OMEGA, coupling, T, **options).max()
    if np.isinf(need.damping):
        assert discretization == "tustin"
        assert damping == 0
        assert np.isinf(seen)
        return
    assert seen <= need.damping * (1 + 1e-14)
    # The densest part of the grid has 40 000 points: a parabola's top is missed by less than 1e-8.
    assert seen >= need.damping * (1 - 1e-7)
    at_binding = required_damping_at(need.omega, coupling, T, **options)
    assert at_binding == pytest.approx(need.damping, rel=1e-13)


def test_binding_frequency_slides_into_dc():
    # The maximum leaves ω = 0 where K² = 3.2β²; just before, its place needs care with 1 − cos.
    beta = 100.0
    for excess in (1e-3, 1e-6, 1e-9, 1e-12):
        coupling = Coupling(np.sqrt(3.2 * (1 - excess)) * beta / T, beta)
        need = required_damping(coupling, T, discretization="tustin")
        assert need.omega > 0
        value = required_damping_at(
            need.omega * np.array([0.5, 1.0, 1.5]), coupling, T, discretization="tustin"
        )
        assert value[1] >= value.max() * (1 - 4e-16)
    past = required_damping(
        Coupling(np.sqrt(3.2 * (1 + 1e-9)) * beta / T, beta), T, discretization="tustin"
    )
    assert past.omega == 0
    assert past.damping == pytest.approx(3.2 * beta / 16, rel=1e-8)


def test_tustin_without_damping_is_never_stable():
    need = required_damping(Coupling([0.0, 1e3], 0.0), T, discretization="tustin")
    np.testing.assert_array_equal(need.damping, [0.0, np.inf])
    for kind in ("average", "true"):
        at = required_damping_at(
            [0.0, 1.0, np.pi / T], Coupling(1e3, 0.0), T, discretization="tustin", hold=kind
        )
        np.testing.assert_array_equal(at, np.inf)


def test_backward_difference_is_tustin_with_more_damping():
    omega = np.array([1e-3, 1.0, 500.0, 3000.0])
    backward = coupling_impedance(omega, Coupling(110e3, 100.0), T)
    tustin = coupling_impedance(
        omega, Coupling(110e3, 100.0 + 110e3 * T / 2), T, discretization="tustin"
    )
    np.testing.assert_array_equal(backward, tustin)


def test_margin_is_the_ratio_of_both_sides_of_equation_10():
    omega = np.geomspace(1.0, 3100.0, 50)
    device = Device(1.0, 20.0, (Mode(0.05, 2e4, 0.3),))
    coupling = Coupling(50e3, 100.0)
    bound = coupling_bound(omega, device, T)
    reached = coupling_admittance(omega, coupling, T).real
    np.testing.assert_allclose(
        stability_margin(omega, device, coupling, T), reached / bound, rtol=1e-13
    )


def test_margin_where_nothing_is_asked_or_given():
    omega = np.array([100.0, np.pi / T])
    np.testing.assert_array_equal(
        stability_margin(omega, Device(1.0, 0.0), Coupling(1e3, 1.0), T), 0.0
    )
    np.testing.assert_array_equal(coupling_bound(omega, Device(1.0, 0.0), T), np.inf)
    np.testing.assert_array_equal(
        stability_margin(omega, Device(1.0, 1.0), Coupling(0.0, 0.0), T), np.inf
    )


@pytest.mark.parametrize("discretization", ["backward", "tustin"])
@pytest.mark.parametrize("kind", ["average", "true"])
def test_verdict_turns_at_the_required_damping(discretization, kind):
    options = {"discretization": discretization, "hold": kind}
    need = required_damping(COUPLING, T, **options)
    verdicts = [
        absolute_stability(Device(1.0, need.damping * factor), COUPLING, T, **options)
        for factor in (1 - 1e-10, 1 - 1e-13, 1.0, 1 + 1e-13, 1 + 1e-10)
    ]
    assert [verdict.verdict for verdict in verdicts] == ["not met", *["on its limit"] * 3, "met"]
    for verdict in verdicts[1:4]:
        assert verdict.smallest_margin == pytest.approx(1.0, abs=1e-12)


def test_binding_frequency_of_the_published_coupling():
    verdict = absolute_stability(Device(1.0, 20.0), COUPLING, T)
    assert verdict.verdict == "not met"
    assert f"{verdict.binding_omega:.6g}" == "2022.65"
    assert verdict.smallest_margin == pytest.approx(20 / 20.25479906887036, rel=1e-14)
    assert verdict.reason == "The smallest margin is 0.98742, at 2022.65 rad/s."


def llewellyn(omega, device):
    """2·Re p11·Re p22/(Re p12p21 + |p12p21|) of Eq. 4 as it is written, in complex arithmetic."""
    z = np.exp(1j * omega * T)
    p12, p22 = (z + 1) / (2 * z), 1 / (100 + 110e3 * T * z / (z - 1))
    return 2 * device_impedance(omega, device, T).real * p22.real / (np.abs(p12) - p12.real)


@pytest.mark.parametrize(
    "device", [Device(1.0, 20.0), Device(1.0, 20.0, MODES)], ids=["rigid", "flexible"]
)
def test_general_criterion_gives_the_same_margins(device):
    verdict = absolute_stability(device, COUPLING, T)
    omega = np.geomspace(100.0, 3141.0, 2000)
    np.testing.assert_allclose(
        llewellyn(omega, device), stability_margin(omega, device, COUPLING, T), rtol=1e-9
    )
    dense = stability_margin(np.linspace(0, np.pi / T, 500_001), device, COUPLING, T)
    assert verdict.smallest_margin <= dense.min() * (1 + 1e-14)
    assert verdict.smallest_margin == pytest.approx(dense.min(), rel=1e-8)


@settings(max_examples=100, deadline=None)
@given(
    mode=st.tuples(*[st.one_of(st.just(0.0), st.floats(1e-6, 1e6))] * 3),
    coupling=st.tuples(*[st.one_of(st.just(0.0), st.floats(1e-6, 1e6))] * 2),
)
def test_no_pole_of_parts_that_are_not_negative_lies_outside_the_unit_circle(mode, coupling):
    """Why margins alone decide: poles of a mode by Tustin's method, and of both forms of 1/Z_c."""
    (m, k, b), (k_c, b_c) = mode, coupling
    s = np.roots([m, b, k]) if m else np.empty(0)
    poles = [*((2 + s * T) / (2 - s * T))]
    for beta in (b_c, b_c + k_c * T / 2):
        if k_c:
            # 1/Z_c = s/(β·s + k_c): in z its pole is where β·(2/T)(z − 1)/(z + 1) = −k_c.
            poles += [*np.roots([2 * beta / T + k_c, k_c - 2 * beta / T])]
    assert (np.abs(poles) <= 1 + 1e-12).all()


def test_table_is_judged_over_its_range_and_may_be_active():
    whole = np.linspace(1, np.pi / T, 50)
    passive = absolute_stability(TabulatedDevice(whole, 30 + 1j * whole), COUPLING, T)
    assert passive.verdict == "met"
    omega = np.linspace(1, 3000, 50)
    active = absolute_stability(TabulatedDevice(omega, np.where(omega > 2000, -1, 30)), COUPLING, T)
    assert active.verdict == "not met"
    assert "active" in active.reason


def test_a_table_of_a_part_of_the_range_shows_no_stability():
    """The rigid device behind it is unstable, at a frequency the table leaves out."""
    device, coupling = Device(1.0, 5.0), Coupling(50e3, 100.0)
    whole = absolute_stability(device, coupling, T)
    assert whole.verdict == "not met"
    for first, last in ((0.05, 120.0), (0.05, 0.99 * np.pi / T), (10.0, 0.9995 * np.pi / T)):
        omega = np.geomspace(first, last, 300)
        table = TabulatedDevice(omega, device_impedance(omega, device, T))
        found = absolute_stability(table, coupling, T)
        if first < whole.binding_omega < last and found.smallest_margin < 1:
            assert found.verdict == "not met"
            continue
        assert found.verdict == "undecided"
        assert found.reason.startswith(f"From {first:g} to {last:g} rad/s the smallest margin is ")
        assert found.reason.endswith(
            "of the rest, up to 3141.59 rad/s, the device's table says nothing."
        )
    omega = np.geomspace(0.05, 120.0, 300)
    assert (
        absolute_stability(TabulatedDevice(omega, 5.0 + 1j * omega), coupling, T).verdict
        == "undecided"
    )
    omega = np.linspace(500.0, np.pi / T, 50)
    found = absolute_stability(TabulatedDevice(omega, np.full(50, 5.0)), Coupling(100.0, 1.0), T)
    assert found.smallest_margin > 1
    assert found.verdict == "undecided"


def test_without_coupling_nothing_is_asked():
    for damping in (0.0, 5.0):
        found = absolute_stability(Device(1.0, damping), Coupling(0.0, 0.0), T)
        assert (found.verdict, found.smallest_margin) == ("met", np.inf)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: absolute_stability(Device(1.0, [5.0, 6.0]), COUPLING, T),
            "one device, one environment and one coupling",
        ),
        (
            lambda: absolute_stability(Device(1.0, 5.0), Coupling([1.0, 2.0], 1.0), T),
            "one device, one environment and one coupling",
        ),
        (
            lambda: absolute_stability(TabulatedDevice([4000.0, 5000.0], [1.0, 1.0]), COUPLING, T),
            "begins above the Nyquist frequency.*not Hz",
        ),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
