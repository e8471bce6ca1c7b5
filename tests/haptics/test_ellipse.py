"""Ranges over ellipses: roots of a quartic in 60 digits, brute force, degenerate cases."""

import mpmath
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


def quartic(omega, device, centre, shape, radius, period):
    """Nearest and farthest stationary point, whether the origin is inside, the terms' size.

    In 60 digits. With u = e^{iφ} the derivative of |c + M(cos φ, sin φ)|² is a polynomial of degree
    four in u.
    """
    with mpmath.workdps(60):
        half = mpmath.mpf(omega) * mpmath.mpf(period) / 2
        rate = 2 / mpmath.mpf(period) * mpmath.tan(half)
        y = mpmath.cos(half)
        (kk, kb), (_, bb) = [[mpmath.mpf(float(v)) for v in row] for row in shape]
        k, b = (mpmath.mpf(float(v)) for v in centre)
        m, b_d, t = mpmath.mpf(device.mass), mpmath.mpf(device.damping), mpmath.mpf(period)
        c = mpmath.matrix(
            [y * (b + b_d - m * rate**2 * t / 2), y * (k / rate - rate * (m + b_d * t / 2))]
        )
        r = mpmath.mpf(radius)
        l11 = mpmath.sqrt(kk)
        l21 = kb / l11
        l22 = mpmath.sqrt(bb - l21**2)
        rows = [[y * r * l21, y * r * l22], [y * r * l11 / rate, mpmath.mpf(0)]]
        # |c + M p|² with p = (cos φ, sin φ): α cos 2φ + β sin 2φ + γ cos φ + δ sin φ + const.
        g11 = rows[0][0] ** 2 + rows[1][0] ** 2
        g22 = rows[0][1] ** 2 + rows[1][1] ** 2
        g12 = rows[0][0] * rows[0][1] + rows[1][0] * rows[1][1]
        alpha, beta = (g11 - g22) / 2, g12
        gamma = 2 * (c[0] * rows[0][0] + c[1] * rows[1][0])
        delta = 2 * (c[0] * rows[0][1] + c[1] * rows[1][1])
        j = mpmath.mpc(0, 1)
        coefficients = [
            beta + j * alpha,
            (delta + j * gamma) / 2,
            mpmath.mpf(0),
            (delta - j * gamma) / 2,
            beta - j * alpha,
        ]
        distances = []
        for root in mpmath.polyroots(coefficients[::-1], maxsteps=500, extraprec=400, asc=True):
            if abs(abs(root) - 1) < mpmath.mpf("1e-15"):
                cos, sin = root.real / abs(root), root.imag / abs(root)
                distances.append(
                    mpmath.hypot(
                        c[0] + rows[0][0] * cos + rows[0][1] * sin,
                        c[1] + rows[1][0] * cos + rows[1][1] * sin,
                    )
                )
        u1 = -c[1] / rows[1][0]
        u2 = (-c[0] - rows[0][0] * u1) / rows[0][1]
        # Everything that is added up to a distance: what the inputs' own rounding is relative to.
        size = y * (abs(b) + b_d + m * rate**2 * t / 2 + r * mpmath.sqrt(bb))
        size += y * ((abs(k) + r * mpmath.sqrt(kk)) / rate + rate * (m + b_d * t / 2))
        return min(distances), max(distances), u1**2 + u2**2 <= 1, size


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
        nearest, farthest, holds_origin, size = quartic(
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


@pytest.mark.parametrize("hold", ["average", "true"])
def test_a_mass_of_the_environment_moves_every_curve(hold, ellipse_edge):
    """Against impedances of environments on the edge, one by one."""
    omega, mass = np.array([0.5, 20.0, 300.0]), 0.4
    centre, shape = (
        np.array([900.0, 3.0]),
        np.array([[250.0, 4.0], [4.0, 0.2]]) * [[100, 1], [1, 1]],
    )
    edge = ellipse_edge(centre, shape, 1.5)
    around = Environment(edge[0], edge[1], mass)
    felt = np.abs(perceived_impedance(Loop(DEVICE, T, hold), omega[:, None], around))
    lower, upper = magnitude_envelope_ellipse(
        Loop(DEVICE, T, hold), omega, Ellipse(centre, shape, 1.5), mass=mass
    )
    np.testing.assert_allclose(upper, felt.max(axis=1), rtol=1e-6)
    np.testing.assert_allclose(lower, felt.min(axis=1), rtol=1e-4)
    small = shape / np.outer(centre, centre)
    edge = np.exp(ellipse_edge(np.log(centre), small, 1.5))
    felt = np.abs(
        perceived_impedance(
            Loop(DEVICE, T, hold), omega[:, None], Environment(edge[0], edge[1], mass)
        )
    )
    lower, upper = magnitude_envelope_ellipse(
        Loop(DEVICE, T, hold), omega, Ellipse(np.log(centre), small, 1.5, log=True), mass=mass
    )
    np.testing.assert_allclose(upper, felt.max(axis=1), rtol=1e-6)
    np.testing.assert_allclose(lower, felt.min(axis=1), rtol=1e-4)
    ends = corner_curves(Loop(DEVICE, T, hold), omega, (800, 1000), (2, 4), mass=mass)
    for curve, k, b in zip(ends, (800, 1000), (2, 4), strict=True):
        felt = np.abs(perceived_impedance(Loop(DEVICE, T, hold), omega, Environment(k, b, mass)))
        np.testing.assert_allclose(curve, felt, rtol=1e-12)
