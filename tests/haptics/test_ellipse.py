"""Ranges over ellipses: turning points in 60 digits, brute force, degenerate cases."""

import itertools

import mpmath as mp
import numpy as np
import pytest

from percept.haptics import (
    Device,
    Environment,
    Loop,
    corner_curves,
    perceived_impedance,
)
from percept.haptics.envelope import Ellipse, magnitude_envelope_ellipse
from percept.haptics.perceived import perceived_magnitude

T = 1e-3
DEVICE = Device(1.0, 5.0)


def on_edge(omega, device, centre, shape, radius, period):
    """Smallest and largest abs(Z_h) on an edge, whether it vanishes inside, and its terms' size.

    In 60 digits. abs(Z_h)² has two harmonics of the angle on the edge: a coarse grid brackets its
    turning points.
    """
    with mp.workdps(60):
        half = mp.mpf(omega) * mp.mpf(period) / 2
        rate = 2 / mp.mpf(period) * mp.tan(half)
        held = mp.cos(half) * mp.expj(-half)
        z_d = mp.mpc(device.damping, device.mass * rate)
        k, b = (mp.mpf(float(value)) for value in centre)
        lower = mp.cholesky(mp.matrix([[mp.mpf(float(value)) for value in row] for row in shape]))
        lower *= mp.mpf(radius)

        def felt(along, across):
            return held * mp.mpc(
                lower[1, 0] * along + lower[1, 1] * across, -lower[0, 0] * along / rate
            )

        centre_felt = z_d + held * mp.mpc(b, -k / rate)

        def at(angle):
            return centre_felt + felt(mp.cos(angle), mp.sin(angle))

        def slope(angle):
            return (mp.conj(at(angle)) * felt(-mp.sin(angle), mp.cos(angle))).real

        ends = []
        angles = [2 * mp.pi * step / 64 for step in range(65)]
        for low, high in itertools.pairwise(angles):
            if slope(low) * slope(high) <= 0:
                turning = mp.findroot(slope, (low, high), solver="anderson", verify=False)
                ends.append(abs(at(turning)))
        zero = -z_d / held
        first = (-zero.imag * rate - k) / lower[0, 0]
        second = (zero.real - b - lower[1, 0] * first) / lower[1, 1]
        # What the inputs' own rounding is relative to.
        reach_k, reach_b = (mp.mpf(radius) * mp.sqrt(shape[at][at]) for at in (0, 1))
        size = abs(z_d) + abs(held) * (abs(b) + reach_b + (abs(k) + reach_k) / rate)
        return min(ends), max(ends), first**2 + second**2 <= 1, size


def random_ellipses(count, seed):
    rng = np.random.default_rng(seed)
    for index in range(count):
        period = 10 ** rng.uniform(-5, -1)
        omega = np.pi / period * 10 ** rng.uniform(-6, -1e-3)
        device = Device(*10 ** rng.uniform([-3, -2], [3, 3]))
        centre = rng.normal(size=2) * 10 ** rng.uniform([0, -2], [5, 3])
        if index % 3 == 0:
            # Around the point where Z_h vanishes.
            rate = 2 / period * np.tan(omega * period / 2)
            centre = np.array(
                [
                    rate**2 * (device.mass + device.damping * period / 2),
                    device.mass * rate**2 * period / 2 - device.damping,
                ]
            ) * (1 + rng.normal(size=2) * 10 ** rng.uniform(-4, 0))
        sd = np.abs(centre) * 10 ** rng.uniform(-4, 1, 2)
        correlation = rng.choice([0.0, rng.uniform(-1, 1), 1 - 10 ** rng.uniform(-6, -1)])
        cross = correlation * sd[0] * sd[1]
        yield (
            omega,
            device,
            centre,
            [[sd[0] ** 2, cross], [cross, sd[1] ** 2]],
            rng.uniform(0.1, 4),
            period,
        )


def test_ends_are_the_stationary_points_on_the_edge():
    inside = 0
    for omega, device, centre, shape, radius, period in random_ellipses(60, 11):
        lower, upper = magnitude_envelope_ellipse(
            Loop(device, period), omega, Ellipse(centre, shape, radius)
        )
        nearest, farthest, holds_origin, size = on_edge(
            omega, device, centre, shape, radius, period
        )
        inside += bool(holds_origin)
        condition = max(1.0, float(size / farthest))
        assert upper == pytest.approx(float(farthest), rel=1e-13 * condition)
        if holds_origin:
            assert lower == 0
        else:
            # The shorter axis of the shape is known to eps/√(1 − ρ²) only.
            correlation = shape[0][1] / np.sqrt(shape[0][0] * shape[1][1])
            condition = max(1.0, float(size / nearest) / np.sqrt(max(1 - correlation**2, 1e-16)))
            assert lower == pytest.approx(float(nearest), rel=1e-13 * condition)
    assert inside >= 5


@pytest.mark.parametrize(
    "shape",
    [
        [[0.0, 0.0], [0.0, 0.0]],
        [[25.0, 0.0], [0.0, 0.0]],
        [[0.0, 0.0], [0.0, 4.0]],
        [[25.0, 10.0], [10.0, 4.0]],
    ],
)
def test_flat_ellipses_are_segments_and_points(shape):
    omega = np.array([0.5, 11.0, 3000.0])
    u = np.linspace(-1, 1, 200_001)
    # A correlation that is one in decimals is off by √eps in the square root of 1 − ρ².
    k, b = 15.0 + 2 * np.sqrt(shape[0][0]) * u, 0.7 + 2 * np.sqrt(shape[1][1]) * u
    seen = perceived_magnitude(Loop(DEVICE, T), omega[:, None], k, b)
    lower, upper = magnitude_envelope_ellipse(
        Loop(DEVICE, T), omega, Ellipse((15.0, 0.7), shape, 2.0)
    )
    np.testing.assert_allclose(upper, seen.max(axis=1), rtol=1e-7)
    np.testing.assert_allclose(lower, seen.min(axis=1), rtol=1e-6)


def test_log_ellipse_against_its_curve_and_its_inside(ellipse_edge):
    rng = np.random.default_rng(13)
    held = 0
    for index in range(40):
        omega = 10 ** rng.uniform(-1, 3.4)
        device = Device(*10 ** rng.uniform([-2, -2], [1, 1]))
        centre = rng.uniform([0, -2], [10, 4])
        sd = rng.uniform(0.05, 1.2, 2)
        if index % 2:
            omega, device = 10 ** rng.uniform(2, 3.4), Device(1.0, 0.5)
            rate = 2 / T * np.tan(omega * T / 2)
            zero = (
                rate**2 * (device.mass + device.damping * T / 2),
                device.mass * rate**2 * T / 2 - device.damping,
            )
            if zero[1] > 0:
                centre = np.log(zero) + rng.normal(size=2) * sd
        cross = rng.uniform(-0.95, 0.95) * sd[0] * sd[1]
        shape = np.array([[sd[0] ** 2, cross], [cross, sd[1] ** 2]])
        lower, upper = magnitude_envelope_ellipse(
            Loop(device, T), omega, Ellipse(centre, shape, 1.5, log=True)
        )
        edge = perceived_magnitude(
            Loop(device, T), omega, *np.exp(ellipse_edge(centre, shape, 1.5))
        )
        assert upper >= edge.max() * (1 - 1e-13)
        assert upper == pytest.approx(edge.max(), rel=1e-6)
        radii = np.sqrt(rng.uniform(0, 1, 20_000))
        within = (
            np.array(centre)[:, None]
            + (ellipse_edge(centre, shape, 1.5, 20_000) - centre[:, None]) * radii
        )
        filled = perceived_magnitude(Loop(device, T), omega, *np.exp(within))
        assert lower <= min(edge.min(), filled.min()) * (1 + 1e-12)
        if lower == 0:
            held += 1
            assert filled.min() < 0.2 * edge.max()
        else:
            assert lower == pytest.approx(edge.min(), rel=1e-3)
    assert held >= 5


def test_log_ellipse_at_the_ends_and_by_broadcasting():
    lower, upper = magnitude_envelope_ellipse(
        Loop(Device([[0.0], [1.0]], 5.0), T),
        [0.0, np.pi / T],
        Ellipse((1.0, 1.0), np.eye(2), 1.0, log=True),
    )
    np.testing.assert_array_equal(lower, [[np.inf, 5.0], [np.inf, np.inf]])
    np.testing.assert_array_equal(upper, [[np.inf, 5.0], [np.inf, np.inf]])


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("hold", ["average", "true"])
def test_a_mass_of_the_environment_moves_every_curve(hold, log, ellipse_edge):
    """Against impedances of environments on the edge, one by one."""
    omega, mass = np.array([0.5, 20.0, 300.0]), 0.4
    loop = Loop(DEVICE, T, hold)
    centre = np.array([900.0, 3.0])
    shape = np.array([[25_000.0, 4.0], [4.0, 0.2]])
    if log:
        centre, shape = np.log(centre), shape / np.outer(centre, centre)
    edge = ellipse_edge(centre, shape, 1.5)
    around = Environment(*(np.exp(edge) if log else edge), mass)
    felt = np.abs(perceived_impedance(loop, omega[:, None], around))
    ellipse = Ellipse(centre, shape, 1.5, log=log)
    lower, upper = magnitude_envelope_ellipse(loop, omega, ellipse, mass=mass)
    np.testing.assert_allclose(upper, felt.max(axis=1), rtol=1e-6)
    np.testing.assert_allclose(lower, felt.min(axis=1), rtol=1e-4)


def test_corner_curves_are_those_of_both_corners():
    omega, loop = np.array([0.5, 20.0, 300.0]), Loop(DEVICE, T)
    ends = corner_curves(loop, omega, (800, 1000), (2, 4), mass=0.4)
    for curve, k, b in zip(ends, (800, 1000), (2, 4), strict=True):
        felt = np.abs(perceived_impedance(loop, omega, Environment(k, b, 0.4)))
        np.testing.assert_allclose(curve, felt, rtol=1e-12)
