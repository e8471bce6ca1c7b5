import numpy as np
import pytest

from percept.haptics import Device, Loop, magnitude_envelope
from reports.hbfd import devices


def felt(s, zoh, device, k, b, coupling=None):
    """|Z_h| by Eqs 11 to 13 as they stand."""
    mass, damping = device
    z_e = b + k / s
    if coupling is not None:
        z_c = coupling[1] + coupling[0] / s
        z_e = z_e * z_c / (z_e + z_c)
    return abs(mass * s + damping + zoh * z_e)


def slow(panel, device, period, points):
    """A panel's statement, one frequency at a time."""
    for omega in np.linspace(*panel.window, points):
        z = np.exp(1j * omega * period)
        s, zoh = 2 / period * (z - 1) / (z + 1), (z + 1) / (2 * z)
        low, high = sorted(
            felt(s, zoh, device, panel.wall.stiffness[i], panel.wall.damping[i]) for i in (0, 1)
        )
        direct = felt(s, zoh, device, panel.wall.k, panel.wall.b)
        coupled = felt(s, zoh, device, panel.wall.k, panel.wall.b, (50e3, 100.0))
        true = {
            "7b": direct < low and coupled < low,
            "7d": low <= coupled < direct <= high,
            "7f": coupled < low and high < direct,
        }[panel.name]
        if not true:
            return False
    return True


@pytest.mark.parametrize("index", [0, 1, 2])
def test_over_devices_agrees_with_a_slow_twin(index, published):
    panel = devices.panels(published)[index]
    masses, dampings = devices.MASSES[::10], devices.DAMPINGS[::12]
    found = devices.over_devices(published, panel, masses, dampings[:, None])
    wanted = [[slow(panel, (m, b), published.period, 9) for m in masses] for b in dampings]
    assert found.tolist() == wanted


def test_panels_take_the_windows_of_the_scene(published):
    assert [(p.name, p.wall.name, p.window) for p in devices.panels(published)] == [
        ("7b", "VE1", (9.89, 10.11)),
        ("7d", "VE2", (9.9, 10.1)),
        ("7f", "VE4", (9.3, 10.6)),
    ]


def test_curves_of_an_array_of_devices_are_those_of_each(published):
    wall, omega = published.walls[1], np.array([1.0, 10.0, 50.0])
    masses, dampings = np.array([0.1, 2.0]), np.array([3.0, 0.5])
    both = devices.curves(published, wall, omega, Device(masses, dampings))
    for row, (mass, damping) in enumerate(zip(masses, dampings, strict=True)):
        one = devices.curves(published, wall, omega, Device(mass, damping))
        for name in ("lower", "upper", "direct", "coupled"):
            np.testing.assert_allclose(getattr(both, name)[row], getattr(one, name), rtol=1e-15)
        assert (one.lower <= one.upper).all()


@pytest.mark.parametrize("limit", [0.0123, 1.0, 7.77])
def test_largest_finds_the_limit(limit):
    found = devices.largest(lambda x: x <= limit, np.geomspace(0.01, 10.0, 20))
    assert found == pytest.approx(limit, rel=1e-11)
    assert found <= limit


def test_largest_at_the_ends():
    scale = np.geomspace(0.01, 10.0, 20)
    assert devices.largest(lambda x: x > 0, scale) == np.inf
    assert devices.largest(lambda x: x < 0, scale) is None


def test_boundaries_are_of_the_next_user(published):
    # Massless, undamped device at low ω: |Z_h| is k/Ω, and the limits are the lognormal
    # prediction's.
    omega = np.array([1e-3])
    limits = published.next_user[1]
    seen = magnitude_envelope(Loop(Device(0.0, 0.0), published.period), omega, *limits)
    mean, sd = 981.03, 35.200
    spread = np.sqrt(np.log1p((sd / mean) ** 2))
    centre = np.log(mean) - spread**2 / 2
    wanted = np.exp(centre + np.array([-1, 1]) * 3.40846 * spread) / omega
    np.testing.assert_allclose(np.ravel(seen), wanted, rtol=2e-4)
