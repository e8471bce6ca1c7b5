"""A delay and a velocity filter in the loop: 50 digits, polynomials, whole loops in time."""

import dataclasses

import mpmath as mp
import numpy as np
import pytest
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial import polynomial as plain
from scipy import signal

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    VelocityFilter,
    absolute_stability,
    perceived_impedance,
    required_damping,
    required_damping_at,
)
from percept.scene import Scene
from tests import LONG

T = 1e-3
DEVICE = Device(1.0, 5.0)


def largest_by_polynomials(stretch, beta, delay):
    """Largest Re Z_d that Eq. 10 asks for with a delay of whole samples, by roots in y = cos h.

    1 − cos((1 + 2d)h) is 1 − T_{2d+1}(y), which 1 − y divides.
    """
    turned = Chebyshev.basis(2 * delay + 1).convert(kind=Polynomial)
    quotient, rest = divmod(1 - turned, Polynomial([1, -1]))
    assert abs(rest(0.0)) < 1e-9
    y = Polynomial([0, 1])
    top = y * quotient * (beta * (1 - y * y) + stretch**2 / (4 * beta) * y * y)
    bottom = 2 * (1 + y)
    roots = (top.deriv() * bottom - top * bottom.deriv()).roots()
    real = roots[np.abs(roots.imag) < 1e-6].real
    candidates = np.append(real[(real > 0) & (real < 1)], [0.0, 1.0])
    return float((top(candidates) / bottom(candidates)).max())


@pytest.mark.parametrize("delay", [1, 2, 3, 5])
@pytest.mark.parametrize("discretization", ["backward", "tustin"])
def test_the_searched_damping_is_the_root_of_a_polynomial(delay, discretization):
    rng = np.random.default_rng(delay)
    stiffness = 10 ** rng.uniform(1, 6, 12)
    damping = 10 ** rng.uniform(0, 3, 12)
    need = required_damping(
        Loop(DEVICE, T, delay=delay), Coupling(stiffness, damping), discretization=discretization
    )
    assert need.damping.shape == need.omega.shape == (12,)
    for k_c, b_c, found in zip(stiffness, damping, need.damping, strict=True):
        beta = b_c + k_c * T / 2 if discretization == "backward" else b_c
        assert found == pytest.approx(largest_by_polynomials(k_c * T, beta, delay), rel=1e-9)


@pytest.mark.parametrize("kind", ["average", "true"])
def test_ends_of_the_range_are_limits(kind):
    """At DC a delayed spring takes k(d + ½)T off the damping."""
    wall = Environment(1e3, 2.0)
    loop = Loop(DEVICE, T, kind, delay=1.5)
    at_dc, near = perceived_impedance(loop, [0.0, 1e-6], wall)
    assert at_dc.real == pytest.approx(5.0 + 2.0 - 1e3 * 2.0 * T, rel=1e-14)
    assert at_dc.imag == -np.inf
    assert near.real == pytest.approx(at_dc.real, rel=1e-12)
    light = Loop(Device(0.0, 5.0), T, kind, delay=1.5)
    at_nyquist, below = perceived_impedance(light, np.pi / T * np.array([1, 1 - 1e-9]), wall)
    assert at_nyquist == pytest.approx(below, rel=1e-6)


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
        direct = Loop(Device(0.0, 0.0), period, "average", velocity_filter)
        direct = complex(perceived_impedance(direct, omega, Environment(k, b)))
        late = Loop(DEVICE, period, "average", velocity_filter, 1.5)
        needed = float(required_damping_at(late, omega, Coupling(k_c, b_c)))
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


def closed_loop(loop, wall, coupling, hand):
    """Characteristic polynomial in q = 1/z of Eq. 11's loop, with a hand and whole samples."""
    unit = 2 / T

    def element(m, b, k):
        # m·s + b + k/s over (1 − q)(1 + q), with s = (2/T)(1 − q)/(1 + q).
        mass = m * unit * np.array([1, -2, 1])
        return mass + b * np.array([1, 0, -1]) + k / unit * np.array([1, 2, 1])

    top, bottom = np.ones(1), np.ones(1)
    if loop.velocity_filter is not None:
        own = loop.velocity_filter
        top, bottom = signal.butter(own.order, own.cutoff, fs=2 * np.pi / T)
    held = element(loop.device.mass + hand[0], loop.device.damping + hand[1], hand[2])
    z_e = element(wall.mass, wall.damping, wall.stiffness)
    spring = element(0.0, coupling.stiffness * T / 2, coupling.stiffness)
    damper = element(0.0, coupling.damping, 0.0)
    z_c = plain.polyadd(plain.polymul(spring, bottom), plain.polymul(damper, top))
    delay = int(loop.delay)
    late = np.zeros(delay + 2)
    late[delay:] = 0.5
    joined = plain.polyadd(plain.polymul(z_e, bottom), z_c)
    shown = plain.polymul(late, plain.polymul(z_e, z_c))
    return plain.polyadd(plain.polymul(held, joined), shown)


def test_what_is_called_stable_keeps_its_poles_inside_the_circle():
    """With random passive hands and walls."""
    rng = np.random.default_rng(6)
    left = {"met": 0, "not met": 0}
    for _ in range(80):
        velocity_filter = VelocityFilter(10 ** rng.uniform(2, 3.4), int(rng.integers(1, 3)))
        loop = Loop(DEVICE, T, "average", velocity_filter, float(rng.integers(0, 3)))
        coupling = Coupling(*(10 ** rng.uniform([2, -1], [5.5, 2.5])))
        need = float(required_damping(loop, coupling).damping)
        damping = min(need, 1e3) * 10 ** rng.uniform(-2, 0.5)
        loop = dataclasses.replace(loop, device=Device(10 ** rng.uniform(-2, 0.5), damping))
        verdict = absolute_stability(loop, coupling).verdict
        assert verdict == ("met" if damping > need else "not met")
        for _ in range(10):
            wall = Environment(*(10 ** rng.uniform([0, -2, -3], [7, 2, 0])))
            hand = 10 ** rng.uniform([-2, -3, 0], [1, 1, 5])
            inverse = np.roots(closed_loop(loop, wall, coupling, hand)[::-1])
            left[verdict] += bool((np.abs(inverse) < 1 - 1e-4).any())
    assert left["met"] == 0
    assert left["not met"] > 10


def test_an_active_coupling_is_named():
    """Beyond its cutoff a filter of the second order turns a damper by more than a quarter."""
    loop = Loop(Device(1.0, 1e3), T, velocity_filter=VelocityFilter(300.0, 2))
    found = absolute_stability(loop, Coupling(10.0, 100.0))
    assert found.verdict == "not met"
    assert found.reason.startswith("The velocity filter makes the coupling active at ")
    assert required_damping(loop, Coupling(10.0, 100.0)).damping == np.inf
    first_order = dataclasses.replace(loop, velocity_filter=VelocityFilter(300.0, 1))
    assert absolute_stability(first_order, Coupling(10.0, 100.0)).verdict == "met"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Loop(DEVICE, T, delay=-1.0), "delay must be one number of samples, 0 to 1000"),
        (lambda: Loop(DEVICE, T, delay=[1.0, 2.0]), "delay must be one number of samples"),
        (lambda: Loop(DEVICE, T, delay=1e4), "delay in seconds is divided by the sampling period"),
        (lambda: Loop(DEVICE, T, delay=np.nan), "delay must be finite"),
        (lambda: Loop(DEVICE, T, "zero"), "hold must be one of 'average', 'true'"),
        (
            lambda: Scene(
                device={"mass": 1.0, "damping": 5.0, "period": T, "delay": 1.0, "delay_seconds": T}
            ),
            "give delay in samples or delay_seconds, not both",
        ),
        (
            lambda: Scene(device={"mass": 1.0, "damping": 5.0, "period": T, "delay_seconds": 2.0}),
            "a delay of 2000 samples is above 1000",
        ),
        (
            lambda: Scene(
                device={
                    "mass": 1.0,
                    "damping": 5.0,
                    "period": T,
                    "velocity_filter": {"cutoff": 4000.0},
                }
            ),
            "velocity_filter.cutoff, 4000 rad/s, must lie below the Nyquist",
        ),
        (
            lambda: Scene(device={"mass": 1.0, "damping": 5.0, "period": T, "delay": -1.0}),
            "device.delay = -1.0: must be 0 or more",
        ),
    ],
)
def test_wrong_delays_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()


def test_the_scene_takes_samples_or_seconds():
    device = {"mass": 1.0, "damping": 5.0, "period": T}
    assert Scene(device=device).device.delay_in_samples == 0
    assert Scene(device={**device, "delay": 1.5}).device.delay_in_samples == 1.5
    assert Scene(device={**device, "delay_seconds": 0.0025}).device.delay_in_samples == 2.5
