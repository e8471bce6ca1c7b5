"""Walls rendered without a coupling: known closed forms, motion in time, edges of the region."""

import mpmath as mp
import numpy as np
import pytest
from scipy import signal

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Mode,
    coupling_impedance,
    environment_impedance,
    perceived_impedance,
    required_damping,
)
from percept.haptics.axis import warp
from percept.haptics.loop import Hold
from percept.haptics.rendering import (
    coupled_region,
    direct_region,
    largest_passive_stiffness,
    passivity_damping,
)
from percept.haptics.velocity import VelocityFilter, filter_response, filtered_damper
from reports.evidence.loop import GROWS, PERIOD, coupling_outcome, outcome, random_wall
from tests import LONG

T = PERIOD


@pytest.mark.evidence(reduced=True)
def test_motion_grows_where_a_wall_is_called_unstable_and_never_elsewhere():
    rng = np.random.default_rng(3)
    outcomes = [outcome(rng) for _ in range(500 if LONG else 30)]
    unstable = [one for one in outcomes if not one.called_stable]
    stable = [one for one in outcomes if one.called_stable]
    assert len(unstable) > len(outcomes) / 4
    assert len(stable) > len(outcomes) / 4
    assert [one for one in unstable if one.largest_growth <= GROWS] == []
    assert [one for one in stable if one.largest_growth > GROWS] == []


@pytest.mark.evidence(reduced=True)
def test_a_coupling_with_a_rigid_wall_is_a_wall():
    """Colgate and Schenkel are right of it; Eq. 10 calls some stable that grow."""
    rng = np.random.default_rng(4)
    outcomes = [coupling_outcome(rng) for _ in range(150 if LONG else 12)]
    as_walls = [
        one.called_stable["Colgate and Schenkel, the coupling as a wall"] for one in outcomes
    ]
    assert [one.grows for one in outcomes] == [not stable for stable in as_walls]
    by_eq_10 = [one for one in outcomes if one.called_stable["Eq. 10, average hold"]]
    assert any(one.grows for one in by_eq_10)


def test_damping_needed_is_the_most_that_any_frequency_asks_for():
    """The loop written with scipy's filter and z, on a fine grid."""
    rng = np.random.default_rng(8)
    angles = np.concatenate([np.geomspace(1e-3, 0.1, 40), np.linspace(0.1, np.pi, 800)])
    for _ in range(12):
        setup = random_wall(rng)
        seen = max(setup.asked(angle) for angle in angles)
        found, _ = setup.needed
        # scipy's polynomials lose digits next to z = 1.
        assert found >= seen * (1 - 1e-7)
        assert found == pytest.approx(seen, rel=1e-3)


@pytest.mark.parametrize("delay", [1.0, 2.0, 5.0])
def test_a_delayed_spring_needs_half_a_sample_and_its_delay(delay):
    """For whole samples U_2d(cos h)/2 is largest at DC: b > kT(d + ½), in both models."""
    needed = passivity_damping(Environment([1e3, 2e4], 0.0), T, delay=delay)
    expected = np.array([1e3, 2e4]) * T * (delay + 0.5)
    assert needed.colgate == pytest.approx(expected, rel=1e-12)
    assert needed.paper == pytest.approx(expected, rel=1e-12)
    limit = largest_passive_stiffness(7.0, 0.0, T, delay=delay)
    assert limit == pytest.approx(7.0 / (T * (delay + 0.5)), rel=1e-12)


def stiffest_spring_of_a_mass(mass, damping, delay):
    """Largest stable stiffness with a mass alone, N/m, from its characteristic equation.

    The mass moves exactly between samples, under the force of the position `delay` samples ago. A
    fraction of a sample puts out the older force first. On the edge a root is e^{jθ}.
    """
    with mp.workdps(40):
        period = mp.mpf(T)
        whole = int(np.floor(delay))
        first = (mp.mpf(delay) - whole) * period
        tau = mp.mpf(mass) / damping

        def moved(time):
            left = mp.exp(-time / tau)
            free = mp.matrix([[1, tau * (1 - left)], [0, left]])
            return free, mp.matrix([time - tau * (1 - left), 1 - left]) / damping

        free_first, by_older = moved(first)
        free_last, by_newer = moved(period - first)
        free = free_last * free_first
        older = free_last * by_older

        def characteristic(stiffness, theta):
            z = mp.mpc(mp.cos(theta), mp.sin(theta))
            force = by_newer * z**-whole + older * z ** -(whole + 1)
            matrix = z * mp.eye(2) - free
            matrix[0, 0] += stiffness * force[0]
            matrix[1, 0] += stiffness * force[1]
            return mp.det(matrix) / slow**2

        guess = damping / (period * (mp.mpf(delay) + 0.5))
        slow = period * mp.sqrt(guess / mass)

        def parts(share, turn):
            value = characteristic(share * guess, turn * slow)
            return value.real, value.imag / slow

        return float(mp.findroot(parts, (1, 1))[0] * guess)


@pytest.mark.parametrize("delay", [0.0, 1.0, 3.0, 0.5, 2.3])
def test_a_heavy_mass_swings_from_the_stiffness_that_half_a_sample_and_the_delay_allow(delay):
    """b = kT(d + ½) for masses that swing slowly, as published for delayed walls.

    Derived from the characteristic equation here: the appendix of Brown (1995) and Hulin et al.
    (2014) were not at hand. For whole samples no passive hand does worse than such a mass.
    """
    damping = 5.0
    limit = damping / (T * (delay + 0.5))
    errors = []
    for mass in (10.0, 1e3):
        found = stiffest_spring_of_a_mass(mass, damping, delay)
        errors.append(abs(found / limit - 1))
    assert errors[1] < 1e-4
    assert errors[1] < errors[0] / 20
    passive = largest_passive_stiffness(damping, 0.0, T, delay=delay)
    if delay % 1:
        assert passive < limit
    else:
        assert passive == pytest.approx(limit, rel=1e-12)


def test_a_delayed_damper_or_mass_needs_as_much_as_without_delay():
    """abs(cos) is 1 somewhere; a mass asks for 2m/T at Nyquist by whole samples."""
    damper = passivity_damping(Environment(0.0, [1.0, 3.0]), T, delay=2.0).colgate
    assert damper == pytest.approx([1.0, 3.0], rel=1e-9)
    mass = passivity_damping(Environment(0.0, 0.0, 0.01), T, delay=2.0).colgate
    assert mass == pytest.approx(2 * 0.01 / T, rel=1e-9)


def test_the_papers_model_is_the_real_part_of_what_the_hand_feels():
    omega = np.linspace(1e-3, np.pi / T, 200_001)
    for wall in (Environment(1e3, 2.0, 0.1), Environment(5e3, 20.0, 0.0, VelocityFilter(300.0))):
        needed = passivity_damping(wall, T, delay=1.3).paper
        felt = perceived_impedance(omega, Device(1.0, needed), wall, T, hold=Hold(delay=1.3))
        assert felt.real.min() >= -1e-9 * needed
        assert felt.real.min() <= 1e-6 * needed


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 2.3])
@pytest.mark.parametrize("velocity_filter", [None, VelocityFilter(400.0, 2)])
def test_walls_on_the_edge_need_the_damping_of_the_device(delay, velocity_filter):
    edge = direct_region(10.0, T, delay=delay, velocity_filter=velocity_filter)
    inner = slice(0, -2, 9)
    walls = Environment(edge.stiffness[inner], edge.damping[inner], 0.0, velocity_filter)
    needed = passivity_damping(walls, T, delay=delay).colgate
    assert needed == pytest.approx(np.full(needed.shape, 10.0), rel=1e-8)
    # The end of the edge has damping alone.
    assert edge.stiffness[-2] == pytest.approx(0.0, abs=1e-6 * edge.stiffness[0])


@pytest.mark.parametrize("hold", ["average", "true", Hold("average", 1.5)])
def test_couplings_on_the_edge_need_the_damping_of_the_device(hold):
    edge = coupled_region(Device(0.3, 10.0), T, hold)
    inner = slice(1, -3, 9)
    coupling = Coupling(edge.stiffness[inner], edge.damping[inner])
    needed = required_damping(coupling, T, hold=hold).damping
    assert needed == pytest.approx(np.full(needed.shape, 10.0), rel=1e-8)
    flexible = coupled_region(Device(0.3, 10.0, (Mode(0.01, 1e4, 0.1),)), T, hold)
    assert flexible.stiffness.max() >= edge.stiffness.max() * (1 - 1e-6)


@pytest.mark.parametrize("order", [1, 2, 3, 6])
def test_the_filter_is_scipys_butterworth(order):
    cutoff = 700.0
    top, bottom = signal.butter(order, cutoff, fs=2 * np.pi / T)
    omega = np.array([0.0, 1e-3, 30.0, 699.0, 700.0, 1500.0, 3100.0])
    _, expected = signal.freqz(top, bottom, worN=omega * T)
    grid = warp(omega, T)
    found = filter_response(grid, VelocityFilter(cutoff, order))
    assert found == pytest.approx(expected, rel=1e-7, abs=1e-9)
    assert abs(found[4]) == pytest.approx(np.sqrt(0.5), rel=1e-14)
    shown = filtered_damper(grid, VelocityFilter(cutoff, order))
    rate = grid.rate
    assert shown.damping == pytest.approx(expected.real, rel=1e-7, abs=1e-9)
    assert shown.stiffness == pytest.approx(-rate * expected.imag, rel=1e-6, abs=1e-6)


def test_a_filter_ends_at_zero_and_keeps_its_limits():
    nyquist = np.array([np.pi / T * (1 - 1e-12), np.pi / T])
    for order in (1, 2, 3):
        velocity_filter = VelocityFilter(500.0, order)
        response = filter_response(warp(nyquist, T), velocity_filter)
        assert response[1] == 0
        shown = filtered_damper(warp(nyquist, T), velocity_filter)
        warped = 2 / T * np.tan(0.25) if order == 1 else 0.0
        assert shown.stiffness == pytest.approx([warped, warped], rel=1e-9, abs=1e-6)


def test_a_filter_multiplies_the_damper_alone():
    omega = np.array([5.0, 300.0, 2500.0])
    velocity_filter = VelocityFilter(400.0, 2)
    response = filter_response(warp(omega, T), velocity_filter)
    h = omega * T / 2
    s = 2j / T * np.tan(h)
    wall = Environment(1e3, 20.0, 0.1, velocity_filter)
    assert environment_impedance(omega, wall, T) == pytest.approx(
        0.1 * s + 20.0 * response + 1e3 / s, rel=1e-12
    )
    coupling = Coupling(5e4, 100.0, velocity_filter)
    z = np.exp(1j * omega * T)
    z_c = 100.0 * response + 5e4 * T * z / (z - 1)
    assert coupling_impedance(omega, coupling, T) == pytest.approx(z_c, rel=1e-11)
    z_e = environment_impedance(omega, Environment(1e3, 20.0, 0.1), T)
    late = np.cos(h) * np.exp(-3j * h)
    felt = perceived_impedance(
        omega,
        Device(1.0, 5.0),
        Environment(1e3, 20.0, 0.1),
        T,
        coupling=coupling,
        discretization="backward",
        hold=Hold(delay=1.0),
    )
    assert felt == pytest.approx(s + 5.0 + late * z_e * z_c / (z_e + z_c), rel=1e-11)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: VelocityFilter(0.0), "must be one number above zero, in rad/s"),
        (lambda: VelocityFilter([1.0, 2.0]), "cutoff in Hz is multiplied by 2π"),
        (lambda: VelocityFilter(100.0, 9), "order of the velocity filter must be 1 to 8"),
        (
            lambda: filter_response(warp(1.0, T), VelocityFilter(4000.0)),
            "does not lie below the Nyquist frequency, 3141.59 rad/s",
        ),
        (lambda: largest_passive_stiffness(-1.0, 0.0, T), "device damping must not be negative"),
        (lambda: largest_passive_stiffness(1.0, 0.0, T, delay=-1.0), "one number of samples"),
        (lambda: passivity_damping(Environment(1.0, 1.0), 0.0), "period must be one positive"),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
