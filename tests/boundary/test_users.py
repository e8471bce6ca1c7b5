"""Shares of users within a disc: against draws of users, and one order of integrals by the
other."""

import numpy as np
import pytest

from percept.boundary.shares import DiscIntegral, Users, share_within
from percept.haptics import Device, Loop
from percept.haptics.perceived import DistancePlane, perceived_magnitude

PERIOD = 1e-3
DEVICE = Device(mass=0.5, damping=5.0)
OMEGA = np.geomspace(0.1, 100.0, 7)
DRAWN = 400_000


def users(*, log, correlation=0.6):
    """Two populations about 500 N/m and 2 N·s/m."""
    mean = np.array([[500.0, 520.0], [2.0, 1.5]])
    sd = np.array([[50.0, 20.0], [0.6, 0.3]])
    if log:
        return Users(True, np.log(mean), sd / mean, np.full(2, correlation))
    return Users(False, mean, sd, np.full(2, correlation))


def drawn_magnitudes(population, draw, omega, rng):
    """abs(Z_h) of users drawn from one population, (users, frequencies)."""
    scores = rng.standard_normal((2, DRAWN))
    rho = population.correlation[draw]
    scores[1] = rho * scores[0] + np.sqrt(1.0 - rho**2) * scores[1]
    k, b = population.mean[:, draw, None] + population.sd[:, draw, None] * scores
    if population.log:
        k, b = np.exp(k), np.exp(b)
    return perceived_magnitude(Loop(DEVICE, PERIOD), omega, k[:, None], b[:, None])


def disc(k, b, omega=OMEGA):
    plane = DistancePlane.of(Loop(DEVICE, PERIOD).at(omega)).flat()
    return plane, perceived_magnitude(Loop(DEVICE, PERIOD), omega, k, b)


@pytest.mark.parametrize("log", [True, False])
@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.6])
def test_against_drawn_users(log, correlation):
    population = users(log=log, correlation=correlation)
    plane, radius = disc(540.0, 1.7)
    shares = share_within(population.column(), plane, radius, DiscIntegral(0, 96))
    rng = np.random.default_rng(3)
    for draw in range(population.size):
        counted = (drawn_magnitudes(population, draw, OMEGA, rng) <= radius).mean(axis=0)
        error = np.sqrt(counted * (1.0 - counted) / DRAWN) + 1.0 / DRAWN
        assert np.all(np.abs(shares[draw] - counted) <= 4.5 * error)
