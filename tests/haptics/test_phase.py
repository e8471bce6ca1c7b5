"""Exact range of the phase of Z_h over boxes and ellipses, against closed paths around them."""

import numpy as np

from percept.haptics import Device, phase_envelope, phase_envelope_ellipse

T = 1e-3
DEVICE = Device(1.0, 5.0)


def edge(limits, count=20_000):
    """Points around a box, closed."""
    (k_low, k_high), (b_low, b_high) = limits
    part = np.linspace(0, 1, count)
    k = np.concatenate(
        [
            k_low + part * (k_high - k_low),
            part * 0 + k_high,
            k_high - part * (k_high - k_low),
            part * 0 + k_low,
        ]
    )
    b = np.concatenate(
        [
            part * 0 + b_low,
            b_low + part * (b_high - b_low),
            part * 0 + b_high,
            b_high - part * (b_high - b_low),
        ]
    )
    return k, b


def compare_phase(angles, lower, upper):
    """A closed path's phase, unwrapped, against a range; or a full turn."""
    path = np.unwrap(angles)
    if abs(path[-1] - path[0]) > 3:
        assert (lower, upper) == (-np.pi, np.pi)
        return "turn"
    path += 2 * np.pi * np.round(((lower + upper) / 2 - path.mean()) / (2 * np.pi))
    assert -np.pi < lower <= upper
    assert lower <= path.min() + 1e-13
    assert upper >= path.max() - 1e-13
    assert path.min() - lower + upper - path.max() < 1e-3 * (upper - lower) + 1e-12
    return "range"


def test_phase_range_of_boxes(plain_impedance):
    rng = np.random.default_rng(9)
    seen = set()
    for _ in range(60):
        device = Device(*10 ** rng.uniform(-2, 1, 2))
        omega = 10 ** rng.uniform(-1, 3.4)
        point = rng.normal(0, [1e3, 5.0])
        half = 10 ** rng.uniform([0, -2], [4, 1.5])
        limits = (point[0] - half[0], point[0] + half[0]), (point[1] - half[1], point[1] + half[1])
        lower, upper = phase_envelope(omega, device, *limits, T)
        seen.add(compare_phase(np.angle(plain_impedance(omega, device, *edge(limits))), lower, upper))
    assert seen == {"turn", "range"}


def test_phase_at_dc_is_a_quarter_turn():
    np.testing.assert_array_equal(
        phase_envelope(0.0, Device(1, 5), (1.0, 2.0), (0.0, 1.0), T), [-np.pi / 2] * 2
    )
    np.testing.assert_array_equal(
        phase_envelope(0.0, Device(1, 5), (-1.0, 2.0), (0.0, 1.0), T), [-np.pi / 2, np.pi / 2]
    )
    np.testing.assert_array_equal(phase_envelope(0.0, Device(1, 5), (0.0, 0.0), (0.0, 1.0), T), [0.0, 0.0])


def test_phase_of_negative_real_impedances_is_half_a_turn_and_not_minus_it():
    np.testing.assert_array_equal(
        phase_envelope(0.0, Device(0.0, 0.0), (0.0, 0.0), (-2.0, -1.0), T), [np.pi, np.pi]
    )


def test_phase_range_of_ellipses(plain_impedance, ellipse_edge):
    rng = np.random.default_rng(12)
    seen = set()
    for _ in range(60):
        device = Device(*10 ** rng.uniform(-2, 1, 2))
        omega = 10 ** rng.uniform(-1, 3.4)
        centre = rng.normal(0, [1e3, 5.0])
        sd = 10 ** rng.uniform([0, -2], [3.5, 1.2])
        cross = rng.uniform(-0.99, 0.99) * sd[0] * sd[1]
        shape = [[sd[0] ** 2, cross], [cross, sd[1] ** 2]]
        lower, upper = phase_envelope_ellipse(omega, device, centre, shape, 1.5, T)
        angles = np.angle(plain_impedance(omega, device, *ellipse_edge(centre, shape, 1.5)))
        seen.add(compare_phase(angles, lower, upper))
    assert seen == {"turn", "range"}


def test_phase_range_of_points_segments_and_dc():
    point = phase_envelope_ellipse(10.0, DEVICE, (100.0, 1.0), [[0.0, 0.0], [0.0, 0.0]], 1.0, T)
    assert point[0] == point[1]
    segment = phase_envelope_ellipse(10.0, DEVICE, (0.0, 1.0), [[1e4, 0.0], [0.0, 0.0]], 1.0, T)
    ends = [
        phase_envelope_ellipse(10.0, DEVICE, (k, 1.0), np.zeros((2, 2)), 1.0, T)[0] for k in (-100.0, 100.0)
    ]
    np.testing.assert_allclose(segment, sorted(ends), atol=1e-14)
    # Damping from -1 to 1 and nothing else: Z_h vanishes in the middle.
    through = phase_envelope_ellipse(10.0, Device(0.0, 0.0), (0.0, 0.0), np.diag([0.0, 1.0]), 1.0, T)
    assert through == (-np.pi, np.pi)
    # Without any stiffness Z_h at DC is real, here 7 to 9 N·s/m.
    assert phase_envelope_ellipse(0.0, DEVICE, (0.0, 3.0), np.diag([0.0, 1.0]), 1.0, T) == (0.0, 0.0)
    shape = [[100.0, 0.0], [0.0, 1.0]]
    np.testing.assert_array_equal(
        phase_envelope_ellipse(0.0, DEVICE, (25.0, 1.0), shape, 2.0, T), [-np.pi / 2] * 2
    )
    np.testing.assert_array_equal(
        phase_envelope_ellipse(0.0, DEVICE, (15.0, 1.0), shape, 2.0, T), [-np.pi / 2, np.pi / 2]
    )
