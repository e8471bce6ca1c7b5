"""A delay in the loop: against polynomials, the companion matrix of whole loops, and no delay."""

import numpy as np
import pytest
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial import polynomial as plain

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    absolute_stability,
    max_coupling_stiffness,
    perceived_impedance,
    required_damping,
    required_damping_at,
)
from percept.haptics.loop import Hold
from percept.scene import Scene
from tests import LONG
from tests.haptics.scenes import LOWER, UPPER, contradiction, scenes

T = 1e-3
COUPLING = Coupling(50e3, 100.0)


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
        Coupling(stiffness, damping), T, discretization=discretization, hold=Hold(delay=delay)
    )
    assert need.damping.shape == need.omega.shape == (12,)
    for k_c, b_c, found in zip(stiffness, damping, need.damping, strict=True):
        beta = b_c + k_c * T / 2 if discretization == "backward" else b_c
        assert found == pytest.approx(largest_by_polynomials(k_c * T, beta, delay), rel=1e-9)


@pytest.mark.parametrize("delay", [0.3, 1.0, 7.7, 100.0])
@pytest.mark.parametrize("kind", ["average", "true"])
def test_no_frequency_asks_for_more_than_the_searched_damping(kind, delay):
    omega = np.linspace(0, np.pi / T, 300_001)
    hold = Hold(kind, delay)
    for coupling in (COUPLING, Coupling(1e3, 500.0), Coupling(0.0, 10.0)):
        need = required_damping(coupling, T, hold=hold)
        seen = required_damping_at(omega, coupling, T, hold=hold).max()
        assert seen <= need.damping * (1 + 1e-13)
        # Between points of the grid a lobe of a delay of 100 samples rises by 1e-6 of its height.
        assert seen >= need.damping * (1 - 1e-6)
    assert required_damping(Coupling(1.0, 0.0), T, discretization="tustin", hold=hold).damping == (
        np.inf
    )
    assert required_damping(Coupling(0.0, 0.0), T, hold=hold).damping == 0


@pytest.mark.parametrize("discretization", ["backward", "tustin"])
@pytest.mark.parametrize("hold", [Hold("average", 1.0), Hold("true", 0.6)])
def test_largest_stiffness_needs_the_device_damping(hold, discretization):
    device = np.array([[5.0], [20.0]])
    damping = np.array([0.5, 2.0, 4.0])
    limit = max_coupling_stiffness(device, damping, T, discretization=discretization, hold=hold)
    assert limit.shape == (2, 3)
    assert (limit > 0).all()
    need = required_damping(
        Coupling(limit, damping), T, discretization=discretization, hold=hold
    ).damping
    assert need == pytest.approx(np.broadcast_to(device, (2, 3)), rel=1e-9)
    none = max_coupling_stiffness(5.0, 1e3, T, discretization=discretization, hold=hold)
    assert none == 0


def test_a_delay_turns_what_the_hold_puts_out():
    """Eq. 13 as it is written, at frequencies where nothing cancels."""
    omega = np.array([5.0, 300.0, 2500.0])
    h = omega * T / 2
    s = 2j / T * np.tan(h)
    z_e = 0.2 * s + 3.0 + 2e3 / s
    for delay in (0.4, 2.0):
        late = np.cos(h) * np.exp(-1j * h * (1 + 2 * delay))
        found = perceived_impedance(
            omega, Device(1.0, 5.0), Environment(2e3, 3.0, 0.2), T, hold=Hold(delay=delay)
        )
        assert found == pytest.approx(s + 5.0 + late * z_e, rel=1e-12)


@pytest.mark.parametrize("kind", ["average", "true"])
def test_ends_of_the_range_are_limits(kind):
    """At DC a delayed spring takes k(d + ½)T off the damping."""
    hold = Hold(kind, 1.5)
    at_dc = perceived_impedance(0.0, Device(1.0, 5.0), Environment(1e3, 2.0), T, hold=hold)
    assert at_dc.real == pytest.approx(5.0 + 2.0 - 1e3 * 2.0 * T, rel=1e-14)
    assert at_dc.imag == -np.inf
    near = perceived_impedance(1e-6, Device(1.0, 5.0), Environment(1e3, 2.0), T, hold=hold)
    assert near.real == pytest.approx(at_dc.real, rel=1e-12)
    at_nyquist = perceived_impedance(
        np.pi / T, Device(0.0, 5.0), Environment(1e3, 2.0), T, hold=hold
    )
    below = perceived_impedance(
        np.pi / T * (1 - 1e-9), Device(0.0, 5.0), Environment(1e3, 2.0), T, hold=hold
    )
    assert at_nyquist == pytest.approx(below, rel=1e-6)


@pytest.mark.evidence(reduced=True)
def test_verdicts_over_a_range_hold_with_a_delay():
    omega = np.geomspace(LOWER, UPPER, 20_000 if LONG else 5_000)
    every = list(scenes(120 if LONG else 1, 17, delay=True))
    found = [contradiction(scene, omega) for scene in every]
    assert [wrong for wrong, _ in found if wrong] == []


def closed_loop(device, wall, coupling, hand, delay):
    """Characteristic polynomial, in 1/z, of Eq. 11's loop with a hand and a delay in samples."""

    def element(m, b, k):
        # m·s + b + k/s over (1 − q)(1 + q), with s = (2/T)(1 − q)/(1 + q), q = 1/z.
        square = np.array([m * 4 / T**2, 0.0, k]) * T / 2
        top = square[0] * np.array([1, -2, 1]) + square[2] * np.array([1, 2, 1])
        return top + b * np.array([1, 0, -1])

    own = element(device.mass + hand[0], device.damping + hand[1], hand[2])
    z_e = element(wall.mass, wall.damping, wall.stiffness)
    beta = coupling.damping + coupling.stiffness * T / 2
    z_c = element(0.0, beta, coupling.stiffness)
    late = np.zeros(delay + 2)
    late[delay:] = 0.5
    shown = plain.polymul(late, plain.polymul(z_e, z_c))
    return plain.polyadd(plain.polymul(own, plain.polyadd(z_e, z_c)), shown)


def poles_in_the_strip(device, wall, coupling, hand, delay):
    """Count poles with Re s > 0 and abs(Im s) < π/T by the argument principle, for any delay.

    A fraction of a sample leaves no polynomial. Device and hand A, wall and coupling S are passive,
    so 1 + ZOH·S/A has no poles there: its turns along the axis, and out along Im s = π/T, count its
    zeros. The lower half of the path is the mirror image of the upper one.
    """
    up = np.concatenate([np.geomspace(1e-9, 1, 8000), np.linspace(1e-6, 1, 8000)])
    up = np.unique(up[up < 1 - 1e-12])
    s = np.concatenate([1j * np.pi / T * up, (1j * np.pi + np.geomspace(1e-9, 60, 8000)) / T])
    while True:
        w = 2 / T * np.tanh(s * T / 2)
        a = (device.mass + hand[0]) * w + device.damping + hand[1] + hand[2] / w
        z_e = wall.mass * w + wall.damping + wall.stiffness / w
        z_c = coupling.damping + coupling.stiffness * T / 2 + coupling.stiffness / w
        late = (1 + np.exp(-s * T)) / 2 * np.exp(-s * T * delay)
        angle = np.unwrap(np.angle(1 + late * z_e * z_c / (z_e + z_c) / a))
        # A sharp resonance of the hand turns fast.
        fast = np.flatnonzero(np.abs(np.diff(angle)) > 1)
        if not fast.size:
            break
        s = np.insert(s, fast + 1, (s[fast] + s[fast + 1]) / 2)
    turns = (angle[0] - angle[-1]) / np.pi
    assert turns == pytest.approx(round(turns), abs=0.05)
    return round(turns)


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("whole", [True, False])
def test_poles_counted_along_a_path_are_those_of_the_polynomial_and_of_the_verdict(whole):
    """Whole samples have both; a fraction has the count alone."""
    rng = np.random.default_rng(5)
    found = {"met": 0, "not met": 0}
    for _ in range(300 if LONG else 10):
        delay = float(rng.integers(0, 4)) if whole else rng.uniform(0, 4)
        coupling = Coupling(*(10 ** rng.uniform([2, -1], [5.5, 2.5])))
        need = required_damping(coupling, T, hold=Hold(delay=delay)).damping
        device = Device(10 ** rng.uniform(-2, 0.5), need * 10 ** rng.uniform(-2, 0.5))
        verdict = absolute_stability(device, coupling, T, hold=Hold(delay=delay)).verdict
        for _ in range(4):
            wall = Environment(*(10 ** rng.uniform([0, -2, -3], [7, 2, 0])))
            hand = 10 ** rng.uniform([-2, -3, 0], [1, 1, 5])
            count = poles_in_the_strip(device, wall, coupling, hand, delay)
            found[verdict] += count > 0
            if whole:
                inverse = np.roots(closed_loop(device, wall, coupling, hand, int(delay))[::-1])
                assert count == (np.abs(inverse) < 1 - 1e-9).sum()
    assert found["met"] == 0
    assert found["not met"] >= 3


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Hold(delay=-1.0), "delay must be one number of samples, 0 to 1000"),
        (lambda: Hold(delay=[1.0, 2.0]), "delay must be one number of samples"),
        (lambda: Hold(delay=1e4), "delay in seconds is divided by the sampling period"),
        (lambda: Hold(delay=np.nan), "delay must be finite"),
        (lambda: Hold("zero"), "hold must be one of 'average', 'true'"),
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
