"""The paper's rule over a range of ω, against fine grids and closed forms."""

import dataclasses

import numpy as np
import pytest

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    Mode,
    TabulatedDevice,
    VelocityFilter,
    device_impedance,
    effective_impedance,
    magnitude_envelope,
    perceived_impedance,
)
from percept.haptics.perceived import Display
from percept.haptics.shown import ON_LIMIT, departure, shown_limits

T, LOWER, UPPER = 1e-3, 0.1, 100.0
OMEGA = np.geomspace(LOWER, UPPER, 10_000)
OMEGA[[0, -1]] = LOWER, UPPER


def scenes(count, seed):
    """Rigid, modal and tabulated devices in turn, in any loop, with the limits of k and b."""
    rng = np.random.default_rng(seed)

    def modes(least, number):
        return tuple(Mode(*10 ** rng.uniform((-3, 1, least), (0, 5, 1))) for _ in range(number))

    for number in range(count):
        rigid = Device(*10 ** rng.uniform([-1.5, -1], [0.7, 1.5]))
        if number % 3 == 1:
            spring = 10 ** rng.uniform(0, 5) if rng.random() < 0.5 else 0.0
            rigid = dataclasses.replace(
                rigid, modes=modes(-4, rng.integers(1, 4)), stiffness=spring
            )
        device = rigid
        if number % 3 == 2:
            omega = np.unique([0.09, 101.0, *10 ** rng.uniform(-1, 2, rng.integers(5, 200))])
            flexible = dataclasses.replace(rigid, modes=modes(-1, rng.integers(0, 3)))
            smooth = device_impedance(Loop(flexible, T), omega)
            device = TabulatedDevice(omega, smooth * np.exp(rng.normal(0, 0.03, omega.size)))
        velocity_filter = None
        if rng.random() < 0.3:
            velocity_filter = VelocityFilter(10 ** rng.uniform(1.5, 3.2), int(rng.integers(1, 4)))
        loop = Loop(
            device,
            T,
            "true" if rng.random() < 0.3 else "average",
            velocity_filter,
            rng.choice([0.0, 0.0, 2.0, rng.uniform(0, 6)]),
        )
        k, b = 10 ** rng.uniform([2, -0.5], [5, 2])
        mass = 10 ** rng.uniform(-2, 1) if rng.random() < 0.3 else 0.0
        coupling = None
        if rng.random() < 0.65:
            coupling = Coupling(*10 ** rng.uniform([2.5, -1], [5.3, 2.5]))
        off, half = rng.normal(0, 0.15, 2), 10 ** rng.uniform(-1.5, 0, 2)
        limits = (
            tuple(k * np.exp(off[0] + half[0] * np.array([-1, 1]))),
            tuple(b * np.exp(3 * (off[1] + half[1] * np.array([-1, 1])))),
        )
        yield Display(loop, Environment(k, b, mass), coupling), limits


def on_grid(display, limits, omega):
    """Departures at frequencies, by the public functions."""
    environment = display.environment
    low, high = magnitude_envelope(display.loop, omega, *limits, mass=environment.mass)
    felt = perceived_impedance(display.loop, omega, environment, coupling=display.coupling)
    with np.errstate(divide="ignore"):
        return np.maximum(np.log(np.abs(felt) / high), np.log(low / np.abs(felt)))


def test_no_point_of_a_grid_departs_by_more_and_the_largest_is_right():
    verdicts = set()
    for display, limits in scenes(60, 11):
        found = departure(display, *limits, LOWER, UPPER)
        seen = on_grid(display, limits, OMEGA).max()
        assert seen <= found.largest + 1e-12
        assert on_grid(display, limits, found.omega) == pytest.approx(found.largest, abs=1e-10)
        verdicts.add(found.verdict)
    assert verdicts >= {"inside", "outside"}


def test_a_spike_of_a_table_between_close_rows_is_seen():
    omega = np.array([0.1, 10.0, 10.0001, 10.0002, 100.0])
    limits = ((900.0, 1100.0), (0.5, 4.0))
    # Above its limits in damping alone, the display leaves only where the device's own damping is
    # large.
    for spike, verdict in ((0.0, "inside"), (300.0, "inside"), (1000.0, "outside")):
        table = TabulatedDevice(omega, np.array([5, 5, 5 + spike, 5, 5], dtype=complex))
        found = departure(Display(Loop(table, T), Environment(1000.0, 6.0)), *limits, LOWER, 50.0)
        assert found.verdict == verdict
    assert 10.0 < found.omega < 10.0002


def test_a_display_on_one_corner_s_curve_is_marginal_and_a_hair_beyond_outside():
    limits = ((900.0, 1100.0), (0.5, 4.0))
    for beyond, verdict in ((-1e-8, "inside"), (0.0, "marginal"), (1e-8, "outside")):
        wall = Environment(1100.0 * (1 + beyond), 4.0 * (1 + beyond))
        found = departure(Display(Loop(Device(0.0, 5.0), T), wall), *limits, LOWER, UPPER)
        assert found.verdict == verdict
        assert abs(found.largest) < max(ON_LIMIT, 2 * abs(beyond))


def test_a_mass_of_the_environment_belongs_to_what_users_adjust():
    """A coupling so stiff that it hides nothing leaves a reference as far inside as none."""
    own, loop = Environment(1000.0, 3.0, 0.7), Loop(Device(1.0, 5.0), T)
    limits = ((900.0, 1100.0), (2.0, 4.0))
    direct = departure(Display(loop, own), *limits, LOWER, UPPER)
    through = departure(Display(loop, own, Coupling(1e12, 1.0)), *limits, LOWER, UPPER)
    assert direct.verdict == through.verdict == "inside"
    assert through.largest == pytest.approx(direct.largest, rel=1e-3)


@pytest.mark.parametrize("mass", [0.0, 0.5, 20.0])
@pytest.mark.parametrize("velocity_filter", [None, VelocityFilter(40.0, 2)])
@pytest.mark.parametrize("coupling", [Coupling(2e4, 6.0), Coupling(9e3, 40.0)])
def test_limits_of_what_couplings_show(mass, velocity_filter, coupling):
    loop = Loop(Device(1.0, 5.0), T, velocity_filter=velocity_filter)
    own = Environment(5e3, 3.0, mass)
    found = shown_limits(Display(loop, own, coupling), LOWER, UPPER)
    omega = np.geomspace(LOWER, UPPER, 200_001)
    stiffness, damping = effective_impedance(loop, omega, own, coupling)
    stiffness = stiffness + mass * (2 / T * np.tan(omega * T / 2)) ** 2
    for limits, seen in zip(found, (stiffness, damping), strict=True):
        np.testing.assert_allclose(limits, [seen.min(), seen.max()], rtol=1e-4)
        assert limits[0] <= seen.min() * (1 + 1e-12)
        assert limits[1] >= seen.max() * (1 - 1e-12)
