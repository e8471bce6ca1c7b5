"""A filtered velocity: against 50 digits, scipy's filter in whole loops, and fine grids."""

import mpmath as mp
import numpy as np
import pytest
from numpy.polynomial import polynomial as plain
from scipy import signal

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    absolute_stability,
    perceived_impedance,
    required_damping,
    required_damping_at,
    stability_margin,
)
from percept.haptics.loop import Hold
from percept.haptics.velocity import VelocityFilter
from tests import LONG
from tests.haptics.scenes import LOWER, UPPER, contradiction, scenes

T = 1e-3


def precise_filter(h, velocity_filter, period):
    """F in the context's digits: poles on a circle, the cutoff prewarped."""
    x = mp.tan(h) / mp.tan(mp.mpf(velocity_filter.cutoff) * period / 2)
    order = velocity_filter.order
    response = mp.mpf(1)
    for pole in range(order):
        angle = mp.pi * (2 * pole + 1) / (2 * order)
        response /= mp.mpc(mp.sin(angle), x - mp.cos(angle))
    return response


def sweep(count):
    """Frequencies from 1e-9 rad/s to next to Nyquist, filters and parameters over 20 decades."""
    rng = np.random.default_rng(12)
    for number in range(count):
        period = 10 ** rng.uniform(-6, 0)
        nyquist = np.pi / period
        share = 1 - 10 ** rng.uniform(-12, 0) if number % 2 else 10 ** rng.uniform(-9, 0)
        cutoff = nyquist * 10 ** rng.uniform(-4, -0.05)
        velocity_filter = VelocityFilter(cutoff, int(rng.integers(1, 5)))
        k, b, k_c, b_c = 10 ** rng.uniform(-10, 10, 4)
        yield period, nyquist * share, velocity_filter, k, b, k_c, b_c


def test_filtered_walls_and_couplings_keep_their_digits():
    """Errors relative to the largest term: a filter's own parts may cancel, and then no more."""
    worst = 0.0
    for period, omega, velocity_filter, k, b, k_c, b_c in sweep(400 if LONG else 60):
        wall = Environment(k, b, 0.0, velocity_filter)
        coupling = Coupling(k_c, b_c, velocity_filter)
        direct = complex(perceived_impedance(omega, Device(0.0, 0.0), wall, period))
        needed = float(required_damping_at(omega, coupling, period, hold=Hold(delay=1.5)))
        with mp.workdps(60):
            t = mp.mpf(period)
            h = mp.mpf(omega) * t / 2
            s = mp.mpc(0, 2 / t * mp.tan(h))
            response = precise_filter(h, velocity_filter, t)
            z_e = mp.mpf(b) * response + mp.mpf(k) / s
            felt = mp.cos(h) * mp.expj(-h) * z_e
            size = mp.cos(h) * (abs(mp.mpf(b) * response) + abs(mp.mpf(k) / s))
            # The filter's angle and tangents have the condition of h next to Nyquist.
            condition = 1 + velocity_filter.order * h / mp.cos(h)
            worst = max(worst, float(abs(direct - felt) / size / condition))
            z = mp.expj(2 * h)
            z_c = mp.mpf(b_c) * response + mp.mpf(k_c) * t * z / (z - 1)
            if z_c.real <= 0:
                assert needed == np.inf
                continue
            late = mp.cos(h) * (1 - mp.cos(4 * h))
            exact = late / 2 * abs(z_c) ** 2 / z_c.real
            real_size = abs(mp.mpf(b_c) * response) + mp.mpf(k_c) * t / 2
            condition *= 1 + real_size / z_c.real + 4 * h / abs(mp.tan(2 * h))
            worst = max(worst, float(abs(needed - exact) / exact / condition))
    assert worst < 1e-13


@pytest.mark.parametrize("order", [1, 2, 3])
def test_demand_is_that_of_the_coupling_as_it_is(order):
    # scipy's polynomials lose digits next to z = 1.
    omega = np.linspace(30.0, 3100.0, 3000)
    coupling = Coupling(5e4, 100.0, VelocityFilter(300.0, order))
    z = np.exp(1j * omega * T)
    top, bottom = signal.butter(order, 300.0, fs=2 * np.pi / T)
    response = np.polyval(top, z) / np.polyval(bottom, z)
    z_c = 100.0 * response + 5e4 * T * z / (z - 1)
    hold = (z + 1) / 2 / z**2
    needed = (np.abs(hold) - hold.real) / (2 * (1 / z_c).real)
    found = required_damping_at(omega, coupling, T, hold=Hold(delay=1.0))
    active = (1 / z_c).real <= 0
    assert (found[active] == np.inf).all()
    needed[active] = np.inf
    assert found == pytest.approx(needed, rel=1e-6)
    margin = stability_margin(omega, Device(1.0, 7.0), coupling, T, hold=Hold(delay=1.0))
    assert margin == pytest.approx(7.0 / needed, rel=1e-6)
    need = required_damping(coupling, T, hold=Hold(delay=1.0))
    assert need.damping >= needed.max() * (1 - 1e-9)
    assert need.damping == pytest.approx(needed.max(), rel=1e-3)


def closed_loop(device, wall, coupling, hand, delay):
    """Characteristic polynomial in q = 1/z of a loop with a filtered coupling."""
    unit = 2 / T

    def element(m, b, k):
        # m·s + b + k/s over (1 − q)(1 + q).
        mass = m * unit * np.array([1, -2, 1])
        return mass + b * np.array([1, 0, -1]) + k / unit * np.array([1, 2, 1])

    velocity_filter = coupling.velocity_filter
    top, bottom = signal.butter(velocity_filter.order, velocity_filter.cutoff, fs=2 * np.pi / T)
    own = element(device.mass + hand[0], device.damping + hand[1], hand[2])
    z_e = element(wall.mass, wall.damping, wall.stiffness)
    spring = element(0.0, coupling.stiffness * T / 2, coupling.stiffness)
    damper = element(0.0, coupling.damping, 0.0)
    z_c = plain.polyadd(plain.polymul(spring, bottom), plain.polymul(damper, top))
    late = np.zeros(delay + 2)
    late[delay:] = 0.5
    joined = plain.polyadd(plain.polymul(z_e, bottom), z_c)
    shown = plain.polymul(late, plain.polymul(z_e, z_c))
    return plain.polyadd(plain.polymul(own, joined), shown)


def test_what_is_called_stable_keeps_its_poles_inside_the_circle():
    """With random passive hands and walls."""
    rng = np.random.default_rng(6)
    left = {"met": 0, "not met": 0}
    for _ in range(80):
        delay = int(rng.integers(0, 3))
        velocity_filter = VelocityFilter(10 ** rng.uniform(2, 3.4), int(rng.integers(1, 3)))
        coupling = Coupling(*(10 ** rng.uniform([2, -1], [5.5, 2.5])), velocity_filter)
        need = float(required_damping(coupling, T, hold=Hold(delay=delay)).damping)
        damping = min(need, 1e3) * 10 ** rng.uniform(-2, 0.5)
        device = Device(10 ** rng.uniform(-2, 0.5), damping)
        verdict = absolute_stability(device, coupling, T, hold=Hold(delay=delay)).verdict
        assert verdict == ("met" if damping > need else "not met")
        for _ in range(10):
            wall = Environment(*(10 ** rng.uniform([0, -2, -3], [7, 2, 0])))
            hand = 10 ** rng.uniform([-2, -3, 0], [1, 1, 5])
            inverse = np.roots(closed_loop(device, wall, coupling, hand, delay)[::-1])
            left[verdict] += bool((np.abs(inverse) < 1 - 1e-4).any())
    assert left["met"] == 0
    assert left["not met"] > 10


def test_an_active_coupling_is_named():
    """Beyond its cutoff a filter of the second order turns a damper by more than a quarter."""
    coupling = Coupling(10.0, 100.0, VelocityFilter(300.0, 2))
    found = absolute_stability(Device(1.0, 1e3), coupling, T)
    assert found.verdict == "not met"
    assert found.reason.startswith("The velocity filter makes the coupling active at ")
    assert required_damping(coupling, T).damping == np.inf
    softer = Coupling(10.0, 100.0, VelocityFilter(300.0, 1))
    assert absolute_stability(Device(1.0, 1e3), softer, T).verdict == "met"


@pytest.mark.evidence(reduced=True)
def test_verdicts_over_a_range_hold_with_a_filter():
    omega = np.geomspace(LOWER, UPPER, 20_000 if LONG else 5_000)
    every = list(scenes(90 if LONG else 1, 19, filtered=True))
    found = [contradiction(scene, omega) for scene in every]
    assert [wrong for wrong, _ in found if wrong] == []
