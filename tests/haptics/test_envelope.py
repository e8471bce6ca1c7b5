"""Exact range of abs(Z_h) over a box: brute force, corners, crossings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.haptics import Device, Loop, Mode, corner_curves, magnitude_envelope
from percept.haptics.envelope import corner_crossings
from percept.haptics.perceived import perceived_magnitude

T = 1e-3
TABLE_1 = [
    ((10.808, 19.02), (0.0356, 1.3335)),
    ((944.85, 1017.2), (1.2404, 1.5316)),
    ((8979.9, 9954.1), (8.188, 13.146)),
    ((23316.0, 24968.0), (21.447, 27.549)),
    ((39498.0, 47829.0), (79.933, 112.34)),
]


@pytest.mark.parametrize(
    "limits", [*TABLE_1, ((-300.0, 500.0), (-8.0, 9.0)), ((5.0, 5.0), (1.0, 1.0))]
)
@pytest.mark.parametrize("mass", [0.0, 0.2])
def test_against_a_million_points_of_the_box(limits, mass, plain_impedance):
    (k_low, k_high), (b_low, b_high) = limits
    device = Device(1.0, 5.0)
    k = np.linspace(k_low, k_high, 1000)[:, None]
    b = np.linspace(b_low, b_high, 1000)
    for omega in (0.1, 11.4, 31.7, 99.8, 700.0, 3000.0):
        seen = np.abs(plain_impedance(omega, device, k, b, mass))
        lower, upper = magnitude_envelope(Loop(device, T), omega, *limits, mass=mass)
        assert lower <= seen.min() * (1 + 1e-12)
        assert upper >= seen.max() * (1 - 1e-12)
        # One cell of the grid away at most.
        cell = np.hypot((k_high - k_low) / 999 / omega, (b_high - b_low) / 999)
        assert upper == pytest.approx(seen.max(), rel=1e-12)
        assert seen.min() - lower <= cell + 1e-12 * seen.min()


interval = st.tuples(st.floats(-1e4, 1e4), st.floats(0, 1e4)).map(lambda p: (p[0], p[0] + p[1]))


@settings(max_examples=150, deadline=None)
@given(
    k=interval,
    b=interval,
    omega=st.floats(1e-3, 3141.0),
    mass=st.floats(0, 10),
    share=st.lists(st.floats(0, 1), min_size=2, max_size=2),
    kind=st.sampled_from(["average", "true"]),
)
def test_no_point_and_no_corner_lies_outside(k, b, omega, mass, share, kind):
    device = Device(mass, 5.0, (Mode(0.05, 2e4, 0.3),))
    lower, upper = magnitude_envelope(Loop(device, T, kind), omega, k, b)
    inside = [low + part * (high - low) for (low, high), part in zip((k, b), share, strict=True)]
    inside = [min(value, high) for value, (_, high) in zip(inside, (k, b), strict=True)]
    values = [
        perceived_magnitude(Loop(device, T, kind), omega, *inside),
        *corner_curves(Loop(device, T, kind), omega, k, b),
    ]
    size = upper * 1e-14
    assert all(lower - size <= value <= upper + size for value in values)


@pytest.mark.parametrize(
    ("limits", "omega"), list(zip(TABLE_1[:3], ("11.4", "31.7", "100"), strict=True))
)
def test_published_corner_curves_cross(limits, omega):
    device = Device(1.0, 5.0)
    (crossing,) = corner_crossings(Loop(device, T), *limits)
    assert f"{crossing:.3g}" in (omega, "99.8")
    at_low, at_high = corner_curves(
        Loop(device, T), crossing * np.array([0.99, 1.0, 1.01]), *limits
    )
    assert at_low[0] < at_high[0]
    assert at_low[1] == pytest.approx(at_high[1], rel=1e-12)
    assert at_low[2] > at_high[2]
    lower, upper = magnitude_envelope(Loop(device, T), crossing, *limits)
    assert lower < at_low[1] < upper


def test_crossings_are_all_there_are():
    rng = np.random.default_rng(8)
    omega = np.linspace(1e-2, np.pi / T * 0.999, 40_001)
    for _ in range(20):
        device = Device(*10 ** rng.uniform(-2, 1, 2))
        k_low, b_low = rng.normal(0, [3e3, 3.0])
        k, b = (k_low, k_low + 10 ** rng.uniform(0, 4)), (b_low, b_low + 10 ** rng.uniform(-1, 1))
        found = corner_crossings(Loop(device, T), k, b)
        low, high = corner_curves(Loop(device, T), omega, k, b)
        seen = omega[:-1][np.diff(np.sign(high - low)) != 0]
        expected = found[(found > omega[0]) & (found < omega[-1])]
        np.testing.assert_allclose(seen, expected, atol=2 * (omega[1] - omega[0]))


def test_no_crossing_without_mass_or_width():
    assert corner_crossings(Loop(Device(0.0, 5.0), T), *TABLE_1[0]).size == 0
    assert corner_crossings(Loop(Device(1.0, 5.0), T), (5.0, 5.0), (1.0, 1.0)).size == 0
    assert corner_crossings(Loop(Device(0.0, 0.0), T), (1.0, 1.0), (1.0, 2.0)).size == 0
