"""A device on a spring to ground: Eqs 10 and 13 in 50 digits, verdicts, crossings, scenes."""

import mpmath as mp
import numpy as np
import pytest

from percept import Scene, UsageError
from percept.haptics import (
    Coupling,
    Device,
    Loop,
    absolute_stability,
)
from percept.haptics.perceived import DistancePlane

T = 1e-3
DEVICE = Device(1.0, 5.0, stiffness=300.0)


def exact_plane(omega, delay):
    """Parts of Z_d·e^{j(1 + 2d)h} as they are written, in 50 digits."""
    with mp.workdps(50):
        h = mp.mpf(omega) * mp.mpf(T) / 2
        s = mp.mpc(0, 2 / mp.mpf(T) * mp.tan(h))
        return (s + 5 + 300 / s) * mp.expj((1 + 2 * mp.mpf(delay)) * h)


@pytest.mark.parametrize("delay", [0.0, 0.4, 3.0])
def test_the_plane_of_a_device_on_a_spring_keeps_its_digits(delay):
    omega = np.array([0.0, 1e-9, 1e-3, 2.0, 300.0, 3000.0])
    plane = DistancePlane.of(Loop(DEVICE, T, delay=delay).at(omega))
    for index, rate in enumerate(omega[1:], start=1):
        exact = exact_plane(rate, delay)
        assert plane.real[index] == pytest.approx(float(exact.real), rel=1e-12)
        assert plane.imaginary[index] == pytest.approx(float(exact.imag), rel=1e-12)
    assert plane.real[0] == pytest.approx(float(exact_plane(1e-12, delay).real), rel=1e-12)
    assert plane.imaginary[0] == -np.inf


def test_a_spring_is_no_matter_of_stability():
    coupling = Coupling(20e3, 20.0)
    for hold, delay in (("average", 0.0), ("true", 0.7)):
        without = absolute_stability(Loop(Device(1.0, 5.0), T, hold, delay=delay), coupling)
        assert absolute_stability(Loop(DEVICE, T, hold, delay=delay), coupling) == without


def test_a_measured_response_has_its_spring():
    with pytest.raises(UsageError, match="a measured response holds mass, damping, stiffness"):
        Scene(device={"response": "zd.csv", "stiffness": 10.0, "period": T})
    with pytest.raises(UsageError, match=r"device.stiffness = -1\.0: must be 0 or more"):
        Scene(device={"mass": 1.0, "damping": 5.0, "stiffness": -1.0, "period": T})
