"""What a sampled loop renders with every passive hand: closed forms, motion in time, any device."""

import numpy as np
import pytest

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    Mode,
    TabulatedDevice,
    VelocityFilter,
)
from percept.haptics.aliases import aliases
from percept.haptics.rendering import (
    can_render,
    needed_damping,
    rendered_region,
    rendering_load,
    rendering_margins,
)
from reports.evidence.loop import (
    PERIOD,
    Hand,
    Motion,
    device_impedance_in_time,
    grows_beyond,
    outcome,
    transfer,
)
from tests import LONG

T = PERIOD
LOOP = Loop(Device(1.0, 1.0), T)
SOFT = Environment(1e3, 1.0)
STIFFNESS = np.array([10.0, 1e3, 1e4, 25e3, 50e3])
DAMPING = np.array([0.1, 1.0, 10.0, 25.0, 50.0])
ANGLES = np.concatenate([np.geomspace(1e-3, 0.1, 60), np.linspace(0.1, np.pi, 900)])


def asked(motion, angles=ANGLES):
    """Damping that each angle ωT asks of a rigid device, from H(z) as a fraction in z⁻¹."""
    z = np.exp(1j * angles)
    top, bottom = transfer(motion)
    force = np.polyval(top[::-1], 1 / z) / np.polyval(bottom[::-1], 1 / z)
    fraction, whole = np.modf(motion.loop.delay)
    sine = np.sin(angles / 2)
    one = T * (1 - 1 / z) * force * z**-whole / (4 * sine**2)
    turn = (1 - fraction) + fraction / z
    mean = (one * turn).real
    # A fraction of a delay turns each alias by another angle: b² − b·Re W̄ = f(1 − f)·sin² h·|W|².
    spread = 2 * np.sqrt(fraction * (1 - fraction)) * sine * np.abs(one)
    return (mean + np.hypot(mean, spread)) / 2


def test_published_environments_directly_and_through_the_coupling():
    walls = Environment(STIFFNESS, DAMPING)
    directly = needed_damping(LOOP, walls)
    coupled = needed_damping(LOOP, walls, coupling=Coupling(50e3, 100.0))
    assert [f"{value:.4g}" for value in directly.damping] == ["0.105", "1.5", "15", "37.5", "75"]
    assert [f"{value:.3g}" for value in coupled.damping] == [
        "0.105",
        "1.48",
        "13.4",
        "28.8",
        "46.9",
    ]
    assert coupled.omega == pytest.approx(np.full(5, np.pi / T))
    rigid = needed_damping(
        LOOP, None, coupling=Coupling([160e3, 50e3, 110e3], [24.0, 100.0, 100.0])
    )
    assert rigid.damping == pytest.approx([104.0, 125.0, 155.0], rel=1e-15)


def test_a_coupling_that_meets_eq_10_diverges_against_a_rigid_wall():
    device = Device(1.0, 20.3)
    coupling = Coupling(160e3, 24.0)
    assert Motion(Loop(device, T), None, coupling).growth(Hand()) == pytest.approx(1.0185, abs=5e-5)
    found = can_render(Loop(device, T), None, coupling=coupling)
    assert (found.verdict, found.needed_damping) == ("cannot", pytest.approx(104.0))
    assert rendered_region(Loop(device, T)).stiffness[0] == pytest.approx(40_600.0, rel=1e-14)


def test_closed_forms_are_the_most_that_any_angle_asks_for():
    rng = np.random.default_rng(1)
    for case in range(300):
        wall = Environment(*(10 ** rng.uniform([0, -2], [5, 2])))
        coupling = Coupling(*(10 ** rng.uniform([0, -2], [5, 2])))
        mass = float(10 ** rng.uniform(-4, 0))
        ways = [(Environment(wall.stiffness, wall.damping, mass), None), (None, coupling)]
        environment, joined = (*ways, (wall, coupling))[case % 3]
        seen = asked(Motion(LOOP, environment, joined))
        needed = needed_damping(LOOP, environment, coupling=joined).damping
        assert needed == pytest.approx(seen[-1], rel=1e-12)
        assert (seen[:-1] <= needed * (1 + 1e-9)).all()


@pytest.mark.evidence(reduced=True)
def test_no_hand_makes_grow_what_can_be_rendered_and_some_do_beyond():
    rng = np.random.default_rng(2)
    outcomes = [outcome(rng, 60 if LONG else 12) for _ in range(200 if LONG else 12)]
    assert not any(one.below for one in outcomes)
    # The worst hands are right at eight aliases to either side.
    assert np.mean([one.above for one in outcomes]) > 0.8


@pytest.mark.evidence(reduced=True)
def test_limits_are_tight():
    """1.05 × with hands tuned to Nyquist and its aliases."""
    rng = np.random.default_rng(3)
    assert all(grows_beyond(rng) for _ in range(50 if LONG else 10))


def brute_sums(device, omega, fraction):
    """Sums over 40,000 aliases to either side, the damping far above resonances summed exactly."""
    theta = omega[:, None] * T + 2 * np.pi * np.arange(-40_000, 40_001)
    far = device.damping + sum(mode.damping for mode in device.modes)
    part = 4 * (1 / device_impedance_in_time(device, theta / T).real - 1 / far) / theta**2
    turn = 1 - fraction + fraction * np.exp(-1j * omega * T)
    rigid = 1 / (far * np.sin(omega * T / 2) ** 2)
    late = (part * np.exp(-1j * fraction * theta)).sum(axis=1)
    return part.sum(axis=1) + rigid, late + rigid * turn


@pytest.mark.parametrize("fraction", [0.0, 0.37])
def test_what_a_flexible_device_dissipates_at_all_aliases(fraction):
    rng = np.random.default_rng(11)
    for count in (1, 2, 3):
        modes = [Mode(*(10 ** rng.uniform([-2, 1, -2], [0.5, 9, 2]))) for _ in range(count)]
        device = Device(1.0, 3.0, tuple(modes))
        omega = np.array([0.1, 12.0, 900.0, 3100.0])
        found = aliases(Loop(device, T, delay=fraction).at(omega))
        square = np.sin(omega * T / 2) ** 2
        rest, late = brute_sums(device, omega, fraction)
        assert found.constant / square + found.rest == pytest.approx(rest, rel=1e-9)
        assert found.constant * found.turn / square + found.late_rest == pytest.approx(
            late, rel=1e-9
        )


def table(device, last, floor):
    omega = np.concatenate([[0.0], np.geomspace(1.0, last, 6000)])
    safe = np.maximum(omega, 1e-9)
    return TabulatedDevice(omega, device_impedance_in_time(device, safe), floor)


@pytest.mark.parametrize("delay", [0.0, 0.4])
def test_a_table_is_judged_like_the_device_that_it_was_made_from(delay):
    device = Device(0.3, 5.0, (Mode(0.05, 2e4, 4.0),))
    coupling = Coupling(2e4, 10.0)
    whole = can_render(Loop(device, T, delay=delay), SOFT, coupling=coupling)
    # Above 20 times Nyquist the device dissipates what its dampers do together.
    measured = table(device, 20 * np.pi / T, 9.0)
    found = can_render(Loop(measured, T, delay=delay), SOFT, coupling=coupling)
    assert found.verdict == whole.verdict == "can"
    assert found.margin == pytest.approx(whole.margin, rel=1e-3)
    lower = can_render(Loop(table(device, 3e3, 5.0), T, delay=delay), SOFT, coupling=coupling)
    assert lower.margin < whole.margin


def test_a_table_certifies_only_with_a_floor():
    device = Device(0.3, 5.0)
    found = can_render(Loop(table(device, 3e3, None), T), SOFT)
    assert (found.verdict, found.reason) == (
        "undecided",
        "Above 3000 rad/s the device's table says nothing, and it states no floor of Re Z_d there.",
    )
    assert can_render(Loop(table(device, 3e3, 4.0), T), SOFT).verdict == "can"
    # Even if it dissipated all that is asked for above its end.
    assert can_render(Loop(table(device, 3e3, None), T), Environment(5e4, 50.0)).verdict == "cannot"
    late = TabulatedDevice([50.0, 4e3], [5.0, 5.0], 5.0)
    assert (
        can_render(Loop(late, T), SOFT).reason == "Below 50 rad/s the device's table says nothing."
    )


def test_poles_of_a_filtered_coupling_are_those_of_its_polynomial():
    rng = np.random.default_rng(5)
    counts = {True: 0, False: 0}
    for _ in range(60):
        velocity_filter = VelocityFilter(10 ** rng.uniform(1.5, 3.2), int(rng.integers(1, 4)))
        loop = Loop(Device(1.0, 1.0), T, velocity_filter=velocity_filter)
        coupling = Coupling(*(10 ** rng.uniform([1, -1], [4, 2.5])))
        wall = Environment(*(10 ** rng.uniform([1, -1], [4, 0])), 10 ** rng.uniform(-2, 0))
        _, bottom = transfer(Motion(loop, wall, coupling))
        largest = np.abs(np.roots(bottom)).max()
        if abs(largest - 1) < 1e-3:
            continue
        needed = needed_damping(loop, wall, coupling=coupling).damping
        assert np.isinf(needed) == (largest > 1)
        counts[bool(largest > 1)] += 1
    assert min(counts.values()) > 5
    loop = Loop(Device(1.0, 1e6), T, velocity_filter=VelocityFilter(60.0, 3))
    unstable = Coupling(10.0, 100.0)
    found = can_render(loop, Environment(10.0, 0.1, 0.5), coupling=unstable)
    assert found.verdict == "cannot"
    assert found.reason == "The velocity filter makes the virtual environment itself unstable."


@pytest.mark.parametrize("delay", [1.0, 2.0, 5.0])
def test_a_delayed_spring_needs_half_a_sample_and_its_delay(delay):
    """For whole samples U_2d(cos h)/2 is largest at DC: b > kT(d + ½)."""
    needed = needed_damping(Loop(Device(1.0, 1.0), T, delay=delay), Environment([1e3, 2e4], 0.0))
    assert needed.damping == pytest.approx(np.array([1e3, 2e4]) * T * (delay + 0.5), rel=1e-12)


def test_a_delayed_damper_or_mass_needs_as_much_as_without_delay():
    """abs(cos) is 1 somewhere; a mass asks for 2m/T at Nyquist by whole samples."""
    damper = needed_damping(
        Loop(Device(1.0, 1.0), T, delay=2.0), Environment(0.0, [1.0, 3.0])
    ).damping
    assert damper == pytest.approx([1.0, 3.0], rel=1e-9)
    mass = needed_damping(Loop(Device(1.0, 1.0), T, delay=2.0), Environment(0.0, 0.0, 0.01)).damping
    assert mass == pytest.approx(2 * 0.01 / T, rel=1e-9)


def test_heavy_hands_bind_at_dc():
    """b_d > k_eff·T/2 − b_eff, with the coupling and the wall in series."""
    k_e, b_e, k_c, b_c = 2e4, 1.0, 5e4, 2.0
    k_eff = k_c * k_e / (k_c + k_e)
    b_eff = (b_e * k_c**2 + b_c * k_e**2) / (k_c + k_e) ** 2
    load = rendering_load(
        Loop(Device(1.0, 1.0), T), 0.0, Environment(k_e, b_e), coupling=Coupling(k_c, b_c)
    )
    assert load == pytest.approx(k_eff * T / 2 - b_eff, rel=1e-12)


def test_margins_of_many_couplings_are_those_of_each():
    device = Device(0.3, 5.0, (Mode(0.05, 2e4, 4.0),))
    couplings = Coupling(np.array([[1e3], [1e5]]), np.array([1.0, 30.0, 200.0]))
    wall = Environment(5e3, 3.0, 0.01)
    found = rendering_margins(Loop(device, T, delay=0.5), wall, coupling=couplings)
    assert found.shape == (2, 3)
    for place in np.ndindex(2, 3):
        one = Coupling(couplings.stiffness[place[0], 0], couplings.damping[place[1]])
        alone = can_render(Loop(device, T, delay=0.5), wall, coupling=one)
        assert found[place] == pytest.approx(alone.margin, rel=1e-7)


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 2.3])
@pytest.mark.parametrize("velocity_filter", [None, VelocityFilter(400.0, 2)])
@pytest.mark.parametrize("modes", [(), (Mode(0.05, 2e4, 4.0),)])
def test_walls_on_the_edge_are_at_their_limit(delay, velocity_filter, modes):
    device = Device(1.0, 10.0, modes)
    loop = Loop(device, T, velocity_filter=velocity_filter, delay=delay)
    edge = rendered_region(loop)
    assert (edge.damping[0], edge.stiffness[-1]) == (0.0, 0.0)
    for point in (0, 40, 128):
        wall = Environment(edge.stiffness[point], edge.damping[point])
        assert can_render(loop, wall).margin == pytest.approx(1.0, rel=1e-8)
    if not (delay or velocity_filter or modes):
        assert edge.stiffness == pytest.approx(2 * (10.0 - edge.damping) / T, abs=1e-9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: VelocityFilter(0.0), "must be one number above zero, in rad/s"),
        (lambda: VelocityFilter([1.0, 2.0]), "cutoff in Hz is multiplied by 2π"),
        (lambda: VelocityFilter(100.0, 9), "order of the velocity filter must be 1 to 8"),
        (
            lambda: Loop(Device(1.0, 1.0), T, velocity_filter=VelocityFilter(4000.0)),
            "does not lie below the Nyquist frequency, 3141.59 rad/s",
        ),
        (
            lambda: needed_damping(Loop(Device(1.0, 1.0), T, delay=-1.0), SOFT),
            "one number of samples",
        ),
        (lambda: needed_damping(Loop(Device(1.0, 1.0), 0.0), SOFT), "period must be one positive"),
        (
            lambda: can_render(Loop(Device(1.0, 5.0), T), Environment([1.0, 2.0], 1.0)),
            "a verdict is for one device, one environment and one coupling",
        ),
        (lambda: TabulatedDevice([1.0, 2.0], [1.0, 1.0], 0.0), "floor of a TabulatedDevice"),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
