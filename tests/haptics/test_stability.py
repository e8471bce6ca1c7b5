"""Required damping, margins, the bound of Fig. 4, verdicts: known numbers, searches, limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Loop,
    Mode,
    TabulatedDevice,
    absolute_stability,
    device_impedance,
    max_coupling_stiffness,
    required_damping,
    required_damping_at,
    stability_margin,
)
from percept.haptics.stability import coupling_bound

T = 1e-3
NO_DEVICE = Device(0.0, 0.0)
LOOP = Loop(NO_DEVICE, T)
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
    need = required_damping(LOOP, Coupling(stiffness, 100.0), discretization=discretization)
    assert f"{need.damping:.6g}" == damping
    if omega:
        assert f"{need.omega:.6g}" == omega


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
    loop = Loop(NO_DEVICE, T, kind)
    options = {"discretization": discretization}
    need = required_damping(loop, coupling, **options)
    seen = required_damping_at(loop, OMEGA, coupling, **options).max()
    if np.isinf(need.damping):
        assert discretization == "tustin"
        assert damping == 0
        assert np.isinf(seen)
        return
    assert seen <= need.damping * (1 + 1e-14)
    # The densest part of the grid has 40 000 points: a parabola's top is missed by less than 1e-8.
    assert seen >= need.damping * (1 - 1e-7)
    at_binding = required_damping_at(loop, need.omega, coupling, **options)
    assert at_binding == pytest.approx(need.damping, rel=1e-13)


def test_tustin_without_damping_is_never_stable():
    need = required_damping(LOOP, Coupling([0.0, 1e3], 0.0), discretization="tustin")
    np.testing.assert_array_equal(need.damping, [0.0, np.inf])
    for kind in ("average", "true"):
        at = required_damping_at(
            Loop(NO_DEVICE, T, kind),
            [0.0, 1.0, np.pi / T],
            Coupling(1e3, 0.0),
            discretization="tustin",
        )
        np.testing.assert_array_equal(at, np.inf)


def test_margin_where_nothing_is_asked_or_given():
    omega = np.array([100.0, np.pi / T])
    np.testing.assert_array_equal(
        stability_margin(Loop(Device(1.0, 0.0), T), omega, Coupling(1e3, 1.0)), 0.0
    )
    np.testing.assert_array_equal(coupling_bound(Loop(Device(1.0, 0.0), T), omega), np.inf)
    np.testing.assert_array_equal(
        stability_margin(Loop(Device(1.0, 1.0), T), omega, Coupling(0.0, 0.0)), np.inf
    )


@pytest.mark.parametrize("discretization", ["backward", "tustin"])
@pytest.mark.parametrize("kind", ["average", "true"])
def test_verdict_turns_at_the_required_damping(discretization, kind):
    loop = Loop(NO_DEVICE, T, kind)
    options = {"discretization": discretization}
    need = required_damping(loop, COUPLING, **options)
    verdicts = [
        absolute_stability(Loop(Device(1.0, need.damping * factor), T, kind), COUPLING, **options)
        for factor in (1 - 1e-10, 1 - 1e-13, 1.0, 1 + 1e-13, 1 + 1e-10)
    ]
    assert [verdict.verdict for verdict in verdicts] == ["not met", *["on its limit"] * 3, "met"]
    for verdict in verdicts[1:4]:
        assert verdict.smallest_margin == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    "device", [Device(1.0, 20.0), Device(1.0, 20.0, MODES)], ids=["rigid", "flexible"]
)
def test_the_smallest_margin_is_that_of_a_fine_grid(device):
    verdict = absolute_stability(Loop(device, T), COUPLING)
    dense = stability_margin(Loop(device, T), np.linspace(0, np.pi / T, 500_001), COUPLING)
    assert verdict.smallest_margin <= dense.min() * (1 + 1e-14)
    assert verdict.smallest_margin == pytest.approx(dense.min(), rel=1e-8)


def test_a_spring_is_no_matter_of_stability():
    sprung = Device(1.0, 5.0, stiffness=300.0)
    coupling = Coupling(20e3, 20.0)
    for hold, delay in (("average", 0.0), ("true", 0.7)):
        without = absolute_stability(Loop(Device(1.0, 5.0), T, hold, delay=delay), coupling)
        assert absolute_stability(Loop(sprung, T, hold, delay=delay), coupling) == without


def test_table_is_judged_over_its_range_and_may_be_active():
    whole = np.linspace(1, np.pi / T, 50)
    passive = absolute_stability(Loop(TabulatedDevice(whole, 30 + 1j * whole), T), COUPLING)
    assert passive.verdict == "met"
    omega = np.linspace(1, 3000, 50)
    active = absolute_stability(
        Loop(TabulatedDevice(omega, np.where(omega > 2000, -1, 30)), T), COUPLING
    )
    assert active.verdict == "not met"
    assert "active" in active.reason


def test_a_table_of_a_part_of_the_range_shows_no_stability():
    """The rigid device behind it is unstable, at a frequency the table leaves out."""
    device, coupling = Device(1.0, 5.0), Coupling(50e3, 100.0)
    whole = absolute_stability(Loop(device, T), coupling)
    assert whole.verdict == "not met"
    for first, last in ((0.05, 120.0), (0.05, 0.99 * np.pi / T), (10.0, 0.9995 * np.pi / T)):
        omega = np.geomspace(first, last, 300)
        table = TabulatedDevice(omega, device_impedance(Loop(device, T), omega))
        found = absolute_stability(Loop(table, T), coupling)
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
        absolute_stability(Loop(TabulatedDevice(omega, 5.0 + 1j * omega), T), coupling).verdict
        == "undecided"
    )
    omega = np.linspace(500.0, np.pi / T, 50)
    found = absolute_stability(
        Loop(TabulatedDevice(omega, np.full(50, 5.0)), T), Coupling(100.0, 1.0)
    )
    assert found.smallest_margin > 1
    assert found.verdict == "undecided"


@settings(max_examples=200, deadline=None)
@given(
    damping=st.floats(1e-6, 1e6),
    ratio=st.one_of(st.just(0.0), st.floats(1e-9, 20.0)),
    discretization=st.sampled_from(["backward", "tustin"]),
    hold=st.sampled_from(["average", "true"]),
)
def test_largest_stiffness_needs_exactly_the_damping_there_is(damping, ratio, discretization, hold):
    loop = Loop(Device(0.0, damping), T, hold)
    b_c = ratio * damping
    limit = float(max_coupling_stiffness(loop, b_c, discretization=discretization))
    # Where it is 0 even a negligible stiffness asks too much, or Tustin's coupling has no damping.
    coupling = Coupling(limit or 1e-9 * damping / T, b_c)
    need = required_damping(loop, coupling, discretization=discretization).damping
    if limit == 0:
        assert need >= damping * (1 - 1e-12)
    else:
        # At the edge of the region K is a square root of what is left, so the forward problem is
        # the milder.
        assert need == pytest.approx(damping, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: absolute_stability(Loop(Device(1.0, [5.0, 6.0]), T), COUPLING),
            "one device, one environment and one coupling",
        ),
        (
            lambda: absolute_stability(Loop(Device(1.0, 5.0), T), Coupling([1.0, 2.0], 1.0)),
            "one device, one environment and one coupling",
        ),
        (
            lambda: absolute_stability(
                Loop(TabulatedDevice([4000.0, 5000.0], [1.0, 1.0]), T), COUPLING
            ),
            "begins above the Nyquist frequency.*not Hz",
        ),
        (
            lambda: max_coupling_stiffness(Loop(Device(0.0, 1.0), T, delay=1.0), 1.0),
            "a rigid device without delay and filter",
        ),
        (lambda: max_coupling_stiffness(LOOP, np.nan), "coupling damping must be finite"),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
