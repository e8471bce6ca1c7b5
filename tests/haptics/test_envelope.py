"""Exact range of abs(Z_h) over a box: brute force."""

import numpy as np
import pytest

from percept.haptics import Device, Loop, magnitude_envelope

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
