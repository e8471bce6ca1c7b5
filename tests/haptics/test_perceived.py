"""Z_h three ways: Eq. 11 and 13 as written, the distance form, and what the coupling shows."""

import numpy as np
import pytest

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    Mode,
    TabulatedDevice,
    coupling_impedance,
    device_impedance,
    effective_impedance,
    environment_impedance,
    hold,
    perceived_impedance,
)
from percept.haptics.perceived import perceived_magnitude

T = 1e-3
NO_DEVICE = Device(0.0, 0.0)
LOOP = Loop(NO_DEVICE, T)
OMEGA = np.geomspace(0.5, 3100.0, 30)
FLEXIBLE = Device(1.0, 5.0, (Mode(0.05, 2e4, 0.3), Mode(0.02, 6e4, 0.0)))
TABLE = TabulatedDevice([0.1, 10.0, 3141.0], [5 + 0.1j, 6 + 10j, 9 + 3000j])
ENVIRONMENT, COUPLING = Environment(1000.0, 2.0, 0.1), Coupling(5e4, 100.0)


@pytest.mark.parametrize(
    "device", [Device(1.0, 5.0), FLEXIBLE, TABLE], ids=["rigid", "flexible", "table"]
)
@pytest.mark.parametrize("kind", ["average", "true"])
def test_equations_11_to_13_as_written(device, kind):
    z_d = device_impedance(Loop(device, T), OMEGA)
    z_e = environment_impedance(LOOP, OMEGA, ENVIRONMENT)
    zoh = hold(Loop(NO_DEVICE, T, kind), OMEGA)
    direct = perceived_impedance(Loop(device, T, kind), OMEGA, ENVIRONMENT)
    np.testing.assert_allclose(direct, z_d + zoh * z_e, rtol=1e-11)
    for discretization in ("tustin", "backward"):
        z_c = coupling_impedance(LOOP, OMEGA, COUPLING, discretization=discretization)
        share = z_c / (z_e + z_c)
        k, b = effective_impedance(
            LOOP, OMEGA, ENVIRONMENT, COUPLING, discretization=discretization
        )
        rate = 2 / T * np.tan(OMEGA * T / 2)
        np.testing.assert_allclose(b - 1j * k / rate, z_e * share, rtol=1e-11)
        coupled = perceived_impedance(
            Loop(device, T, kind),
            OMEGA,
            ENVIRONMENT,
            coupling=COUPLING,
            discretization=discretization,
        )
        np.testing.assert_allclose(coupled, z_d + zoh * z_e * share, rtol=1e-11)
        magnitude = perceived_magnitude(Loop(device, T, kind), OMEGA, k, b)
        np.testing.assert_allclose(magnitude, np.abs(coupled), rtol=1e-11)


def test_each_equation_has_its_own_discretization():
    by_default = perceived_impedance(Loop(FLEXIBLE, T), OMEGA, ENVIRONMENT, coupling=COUPLING)
    tustin = perceived_impedance(
        Loop(FLEXIBLE, T), OMEGA, ENVIRONMENT, coupling=COUPLING, discretization="tustin"
    )
    np.testing.assert_array_equal(by_default, tustin)
    z = np.exp(1j * OMEGA * T)
    np.testing.assert_allclose(
        coupling_impedance(LOOP, OMEGA, COUPLING),
        100.0 + 5e4 * T * z / (z - 1),
        rtol=1e-11,
    )


def test_device_modes_are_passive_and_add_their_mass_at_low_frequency():
    rng = np.random.default_rng(5)
    omega = np.geomspace(1e-4, np.pi / T, 200)
    for _ in range(50):
        mode = Mode(*10 ** rng.uniform([-3, 0, -3], [1, 7, 2]))
        added = device_impedance(Loop(Device(0.0, 0.0, (mode,)), T), omega)
        assert (added.real >= 0).all()
        assert added[0].imag == pytest.approx(mode.mass * omega[0], rel=1e-3)
        s = 2j / T * np.tan(omega[:-1] * T / 2)
        m, k, b = mode.mass, mode.stiffness, mode.damping
        np.testing.assert_allclose(
            added[:-1], m * s * (b * s + k) / (m * s * s + b * s + k), rtol=1e-9
        )
