"""Z_h three ways: Eq. 11 and 13 as written, the distance form, and what the coupling shows."""

import numpy as np
import pytest

from percept.haptics import (
    Coupling,
    Device,
    Environment,
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
OMEGA = np.geomspace(0.5, 3100.0, 30)
FLEXIBLE = Device(1.0, 5.0, (Mode(0.05, 2e4, 0.3), Mode(0.02, 6e4, 0.0)))
TABLE = TabulatedDevice([0.1, 10.0, 3141.0], [5 + 0.1j, 6 + 10j, 9 + 3000j])
ENVIRONMENT, COUPLING = Environment(1000.0, 2.0, 0.1), Coupling(5e4, 100.0)


@pytest.mark.parametrize(
    "device", [Device(1.0, 5.0), FLEXIBLE, TABLE], ids=["rigid", "flexible", "table"]
)
@pytest.mark.parametrize("kind", ["average", "true"])
def test_equations_11_to_13_as_written(device, kind):
    z_d = device_impedance(OMEGA, device, T)
    z_e = environment_impedance(OMEGA, ENVIRONMENT, T)
    zoh = hold(OMEGA, T, kind=kind)
    direct = perceived_impedance(OMEGA, device, ENVIRONMENT, T, hold=kind)
    np.testing.assert_allclose(direct, z_d + zoh * z_e, rtol=1e-11)
    for discretization in ("tustin", "backward"):
        z_c = coupling_impedance(OMEGA, COUPLING, T, discretization=discretization)
        share = z_c / (z_e + z_c)
        k, b = effective_impedance(OMEGA, ENVIRONMENT, COUPLING, T, discretization=discretization)
        rate = 2 / T * np.tan(OMEGA * T / 2)
        np.testing.assert_allclose(b - 1j * k / rate, z_e * share, rtol=1e-11)
        coupled = perceived_impedance(
            OMEGA,
            device,
            ENVIRONMENT,
            T,
            coupling=COUPLING,
            discretization=discretization,
            hold=kind,
        )
        np.testing.assert_allclose(coupled, z_d + zoh * z_e * share, rtol=1e-11)
        magnitude = perceived_magnitude(OMEGA, device, k, b, T, hold=kind)
        np.testing.assert_allclose(magnitude, np.abs(coupled), rtol=1e-11)


def test_each_equation_has_its_own_discretization():
    by_default = perceived_impedance(OMEGA, FLEXIBLE, ENVIRONMENT, T, coupling=COUPLING)
    tustin = perceived_impedance(
        OMEGA, FLEXIBLE, ENVIRONMENT, T, coupling=COUPLING, discretization="tustin"
    )
    np.testing.assert_array_equal(by_default, tustin)
    z = np.exp(1j * OMEGA * T)
    np.testing.assert_allclose(
        coupling_impedance(OMEGA, COUPLING, T), 100.0 + 5e4 * T * z / (z - 1), rtol=1e-11
    )


def test_a_rigid_coupling_is_no_coupling():
    stiff = perceived_impedance(OMEGA, FLEXIBLE, ENVIRONMENT, T, coupling=Coupling(1e18, 1e18))
    np.testing.assert_allclose(
        stiff, perceived_impedance(OMEGA, FLEXIBLE, ENVIRONMENT, T), rtol=1e-12
    )


def test_coupling_makes_the_environment_softer_but_not_always_the_display():
    # With the device's own mass in play abs(Z_h_vc) may exceed abs(Z_h); Z_eff alone is always
    # smaller.
    device, soft, coupling = Device(1.0, 5.0), Environment(10.0, 0.1), Coupling(50e3, 100.0)
    coupled = abs(perceived_impedance(10.0, device, soft, T, coupling=coupling))
    direct = abs(perceived_impedance(10.0, device, soft, T))
    assert f"{coupled:.6g}" == "10.3419"
    assert f"{direct:.6g}" == "10.3418"
    omega = np.geomspace(0.1, 100, 200)
    k, b = effective_impedance(omega, soft, coupling, T)
    effective = np.hypot(b, k / (2 / T * np.tan(omega * T / 2)))
    assert (effective < np.abs(environment_impedance(omega, soft, T))).all()


def test_static_stiffness_of_the_published_environments():
    stiffness = np.array([1000.0, 10000.0, 25000.0, 50000.0])
    shown, _ = effective_impedance(
        0.0, Environment(stiffness, stiffness / 1000), Coupling(50e3, 100.0), T
    )
    np.testing.assert_allclose(
        shown, [980.392156862745, 8333.33333333333, 16666.6666666667, 25000.0]
    )


def test_device_modes_are_passive_and_add_their_mass_at_low_frequency():
    rng = np.random.default_rng(5)
    omega = np.geomspace(1e-4, np.pi / T, 200)
    for _ in range(50):
        mode = Mode(*10 ** rng.uniform([-3, 0, -3], [1, 7, 2]))
        added = device_impedance(omega, Device(0.0, 0.0, (mode,)), T)
        assert (added.real >= 0).all()
        assert added[0].imag == pytest.approx(mode.mass * omega[0], rel=1e-3)
        s = 2j / T * np.tan(omega[:-1] * T / 2)
        m, k, b = mode.mass, mode.stiffness, mode.damping
        np.testing.assert_allclose(
            added[:-1], m * s * (b * s + k) / (m * s * s + b * s + k), rtol=1e-9
        )


def test_omega_by_environments_by_draws_equals_the_loop():
    rng = np.random.default_rng(3)
    omega = np.array([0.0, 0.3, 40.0, 3000.0, np.pi / T])
    stiffness, damping = rng.normal(100, 300, (3, 7)), rng.normal(1, 3, (3, 7))
    stiffness[0, 0] = 0.0
    cube = perceived_magnitude(omega[:, None, None], FLEXIBLE, stiffness, damping, T, mass=0.1)
    assert cube.shape == (5, 3, 7)
    for index in np.ndindex(cube.shape):
        one = perceived_magnitude(
            float(omega[index[0]]), FLEXIBLE, stiffness[index[1:]], damping[index[1:]], T, mass=0.1
        )
        assert cube[index] == one
    positive = Environment(np.abs(stiffness), np.abs(damping), 0.1)
    coupled = perceived_impedance(omega[:, None, None], FLEXIBLE, positive, T, coupling=COUPLING)
    assert coupled[2, 1, 4] == perceived_impedance(
        40.0,
        FLEXIBLE,
        Environment(abs(stiffness[1, 4]), abs(damping[1, 4]), 0.1),
        T,
        coupling=COUPLING,
    )
