"""Llewellyn's verdict: margins, poles, the marginal case, and networks that must be found unstable."""

import mpmath
import numpy as np
import pytest

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Mode,
    TabulatedDevice,
    TwoPort,
    absolute_stability,
    device_impedance,
    llewellyn,
    required_damping,
    stability_margin,
    two_port,
)

T = 1e-3
COUPLING = Coupling(110e3, 100.0)
MODES = (Mode(0.05, 2e4, 0.3), Mode(0.02, 5e4, 0.2))


@pytest.mark.parametrize("discretization", ["backward", "tustin"])
@pytest.mark.parametrize("kind", ["average", "true"])
def test_verdict_turns_at_the_required_damping(discretization, kind):
    options = {"discretization": discretization, "hold": kind}
    need = required_damping(COUPLING, T, **options)
    verdicts = [
        absolute_stability(Device(1.0, need.damping * factor), COUPLING, T, **options)
        for factor in (1 - 1e-10, 1 - 1e-13, 1.0, 1 + 1e-13, 1 + 1e-10)
    ]
    assert [verdict.verdict for verdict in verdicts] == ["unstable", *["marginal"] * 3, "stable"]
    for verdict in verdicts[1:4]:
        assert verdict.smallest_margin == pytest.approx(1.0, abs=verdict.rounding)
        assert verdict.poles_allowed is True


def test_binding_frequency_of_the_published_coupling():
    verdict = absolute_stability(Device(1.0, 20.0), COUPLING, T)
    assert verdict.verdict == "unstable"
    assert f"{verdict.binding_omega:.6g}" == "2022.65"
    assert verdict.smallest_margin == pytest.approx(20 / 20.25479906887036, rel=1e-14)
    assert len(repr(verdict)) < 300
    assert verdict.reason == "The smallest margin is 0.98742, at 2022.65 rad/s."


@pytest.mark.parametrize("device", [Device(1.0, 20.0), Device(1.0, 20.0, MODES)], ids=["rigid", "flexible"])
def test_general_criterion_gives_the_same_margins(device):
    verdict = absolute_stability(device, COUPLING, T)
    inner = verdict.omega[1:-1]
    general = llewellyn(two_port(inner, device, COUPLING, T))
    np.testing.assert_allclose(general.margin, verdict.margin[1:-1], rtol=1e-13)
    dense = stability_margin(np.linspace(0, np.pi / T, 500_001), device, COUPLING, T)
    assert verdict.smallest_margin <= dense.min() * (1 + 1e-14)
    assert verdict.smallest_margin == pytest.approx(dense.min(), rel=1e-8)


def test_modes_add_margin():
    rigid = absolute_stability(Device(1.0, 20.0), COUPLING, T)
    flexible = absolute_stability(Device(1.0, 20.0, MODES), COUPLING, T)
    assert rigid.verdict == "unstable"
    assert flexible.verdict == "stable"


def test_equation_4():
    network = two_port([0.0, 10.0], Device(1.0, 5.0), COUPLING, T)
    z = np.exp(1j * 10.0 * T)
    s = 2 / T * (z - 1) / (z + 1)
    assert network.p11[1] == pytest.approx(s + 5, rel=1e-12)
    assert network.p12[1] == pytest.approx((z + 1) / (2 * z), rel=1e-12)
    np.testing.assert_array_equal(network.p21, -1)
    assert network.p22[1] == pytest.approx(1 / (100 + 110e3 * T * z / (z - 1)), rel=1e-12)


@pytest.mark.parametrize(
    "mode", [Mode(0.05, 2e4, 0.3), Mode(0.05, 2e4, 900.0), Mode(0.05, 0.0, 3.0), Mode(0.05, 2e4, 0.0)]
)
@pytest.mark.parametrize("discretization", ["backward", "tustin"])
def test_poles_are_where_the_network_is_singular(mode, discretization):
    device = Device(1.0, 5.0, (mode,))
    network = two_port([1.0], device, COUPLING, T, discretization=discretization)
    assert len(network.poles) == (4 if mode.stiffness == 0 else 5)
    with mpmath.workdps(40):
        for pole in network.poles:
            if pole == 0:
                continue
            z = mpmath.mpmathify(complex(pole)) + mpmath.mpf("1e-12")
            s = 2 / mpmath.mpf(T) * (z - 1) / (z + 1)
            tustin = 100 + 110e3 / s
            z_c = tustin if discretization == "tustin" else 100 + 110e3 * T * z / (z - 1)
            flexible = mode.mass * s * (mode.damping * s + mode.stiffness)
            flexible /= mode.mass * s**2 + mode.damping * s + mode.stiffness
            assert max(abs(s), abs(flexible), abs(1 / z_c)) > 1e6


def test_passive_parts_have_allowed_poles_even_undamped():
    twins = (Mode(0.05, 2e4, 0.0), Mode(0.05, 2e4, 0.0))
    verdict = absolute_stability(Device(1.0, 25.0, twins), COUPLING, T)
    assert verdict.poles_allowed is True
    assert np.isclose(np.abs(verdict.poles), 1).sum() == 3


def flat(**changes):
    parts = {
        "p11": [10.0, 10.0],
        "p12": [1.0, 1.0],
        "p21": [-1.0, -1.0],
        "p22": [0.1, 0.1],
        "poles": [0.5],
    } | changes
    return llewellyn(TwoPort([1.0, 2.0], **parts))


def test_general_networks():
    assert flat().verdict == "stable"
    assert flat().smallest_margin == np.inf
    # p12·p21 = j: 2·Re p11·Re p22 must reach 1.
    assert flat(p12=[1j, 1j], p22=[0.05, 0.05]).verdict == "marginal"
    low = flat(p12=[1j, 1j], p22=[0.05, 0.049])
    assert low.verdict == "unstable"
    assert low.binding_omega == 2.0
    assert flat(poles=None).poles_allowed is None


@pytest.mark.parametrize("poles", [[1.1], [0.5, 1.0001j], [1.0, 1.0], [-1.0, -1.0, 0.2]])
def test_poles_outside_or_double_on_the_circle_are_unstable(poles):
    verdict = flat(poles=poles)
    assert verdict.poles_allowed is False
    assert verdict.verdict == "unstable"
    assert "pole" in verdict.reason
    # The margins alone would have let it pass.
    assert verdict.smallest_margin > 1


@pytest.mark.parametrize("poles", [[1.0], [1.0, -1.0], [0.9, 0.9]])
def test_single_poles_on_the_circle_are_allowed(poles):
    assert flat(poles=poles).verdict == "stable"


def test_two_active_ports_do_not_make_a_passive_one():
    verdict = flat(p11=[10.0, -10.0], p22=[0.1, -0.1], p12=[1j, 1j])
    assert verdict.verdict == "unstable"
    assert verdict.binding_omega == 2.0
    assert "active" in verdict.reason


def test_table_is_judged_over_its_range_and_may_be_active():
    whole = np.linspace(1, np.pi / T, 50)
    passive = absolute_stability(TabulatedDevice(whole, 30 + 1j * whole), COUPLING, T)
    assert passive.verdict == "stable"
    assert passive.poles_allowed is None
    assert (passive.omega[0], passive.omega[-1]) == (1.0, np.pi / T)
    omega = np.linspace(1, 3000, 50)
    active = absolute_stability(TabulatedDevice(omega, np.where(omega > 2000, -1, 30)), COUPLING, T)
    assert active.verdict == "unstable"
    assert "active" in active.reason


def test_a_table_of_a_part_of_the_range_shows_no_stability():
    """The rigid device behind it is unstable, at a frequency the table leaves out."""
    device, coupling = Device(1.0, 5.0), Coupling(50e3, 100.0)
    whole = absolute_stability(device, coupling, T)
    assert whole.verdict == "unstable"
    for first, last in ((0.05, 120.0), (0.05, 0.99 * np.pi / T), (10.0, 0.9995 * np.pi / T)):
        omega = np.geomspace(first, last, 300)
        table = TabulatedDevice(omega, device_impedance(omega, device, T))
        found = absolute_stability(table, coupling, T)
        if first < whole.binding_omega < last and found.smallest_margin < 1:
            assert found.verdict == "unstable"
            continue
        assert found.verdict == "undecided"
        assert found.reason.startswith(f"From {first:g} to {last:g} rad/s the smallest margin is ")
        assert found.reason.endswith("of the rest, up to 3141.59 rad/s, the device's table says nothing.")
    omega = np.geomspace(0.05, 120.0, 300)
    assert absolute_stability(TabulatedDevice(omega, 5.0 + 1j * omega), coupling, T).verdict == "undecided"
    omega = np.linspace(500.0, np.pi / T, 50)
    found = absolute_stability(TabulatedDevice(omega, np.full(50, 5.0)), Coupling(100.0, 1.0), T)
    assert found.smallest_margin > 1
    assert found.verdict == "undecided"


def test_without_coupling_nothing_is_asked():
    assert absolute_stability(Device(1.0, 0.0), Coupling(0.0, 0.0), T).verdict == "stable"
    for damping in (0.0, 5.0):
        network = two_port([1.0, 10.0, 3000.0], Device(1.0, damping), Coupling(0.0, 0.0), T)
        found = llewellyn(network)
        assert (found.verdict, found.smallest_margin) == ("stable", np.inf)


def test_an_active_device_is_unstable_even_without_a_coupling():
    device = TabulatedDevice([1.0, 3000.0], [-1.0, -1.0])
    assert llewellyn(two_port([1.0, 10.0], device, Coupling(0.0, 0.0), T)).verdict == "unstable"


def test_tustin_without_damping_is_unstable():
    verdict = absolute_stability(Device(1.0, 1e6), Coupling(1.0, 0.0), T, discretization="tustin")
    assert verdict.verdict == "unstable"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: absolute_stability(Device(1.0, [5.0, 6.0]), COUPLING, T), "one device and one coupling"),
        (
            lambda: two_port([1.0], Device(1.0, 5.0), Coupling([1.0, 2.0], 1.0), T),
            "one device and one coupling",
        ),
        (lambda: TwoPort([1.0], [1.0, 2.0], [1.0], [1.0], [1.0]), "p11 and omega must be of one length"),
        (lambda: TwoPort([-1.0], [1.0], [1.0], [1.0], [1.0]), "TwoPort omega must not be negative"),
        (lambda: TwoPort([1.0], [np.nan], [1.0], [1.0], [1.0]), "TwoPort p11 holds NaN"),
        (lambda: TwoPort([1.0], [1.0], [1.0], [1.0], ["a"]), "TwoPort p22 must be complex numbers"),
        (lambda: TwoPort([1.0], [1.0], [1.0], [1.0], [1.0], poles=[np.nan]), "TwoPort poles holds NaN"),
        (
            lambda: absolute_stability(TabulatedDevice([4000.0, 5000.0], [1.0, 1.0]), COUPLING, T),
            "begins above the Nyquist frequency.*not Hz",
        ),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
