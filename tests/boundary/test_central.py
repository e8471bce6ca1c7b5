"""Central ranges of abs(Z_h) hold their share of drawn users, and decide as margins do."""

from __future__ import annotations

import numpy as np
import pytest

from percept.boundary.couplings import CouplingJudge, magnitude_ranges
from percept.boundary.feels_real import feels_real, search_grid
from percept.boundary.shares import Users
from percept.haptics import Coupling, Device, Environment, Loop
from percept.haptics.perceived import Display, DistancePlane, Point
from tests import LONG

WALL = Environment(stiffness=500.0, damping=2.0)
DISPLAY = Display(Loop(Device(mass=0.5, damping=5.0), 1e-3), WALL)


def populations(*, log, count=12, seed=2):
    """Users of the wall, with means and spreads that differ from draw to draw."""
    rng = np.random.default_rng(seed)
    centre = np.array([[500.0], [2.0]])
    sd = 0.1 * np.exp(0.3 * rng.standard_normal((2, count)))
    shift = 0.1 * rng.standard_normal((2, count))
    mean = np.log(centre) + shift if log else centre * (1.0 + shift)
    return Users(log, mean, sd if log else sd * centre, rng.uniform(-0.9, 0.9, count))


@pytest.mark.parametrize("log", [True, False])
def test_ranges_hold_their_share_of_drawn_users(log):
    users = populations(log=log)
    omega = np.array([0.1, 10.0, np.sqrt(1000.0), 60.0])
    plane = DistancePlane.of(DISPLAY.loop.at(omega)).flat()
    ranges = magnitude_ranges(users, plane, 0.9)
    rng = np.random.default_rng(3)
    scores = rng.standard_normal((2, 40_000))
    for draw in range(users.size):
        rho = users.correlation[draw]
        first = scores[0]
        second = rho * scores[0] + np.sqrt(1.0 - rho**2) * scores[1]
        values = users.mean[:, [draw]] + users.sd[:, [draw]] * np.stack([first, second])
        stiffness, damping = np.exp(values) if log else values
        for column in range(omega.size):
            there = plane.select(np.array([column]))
            magnitude = there.distance(Point(stiffness, damping))
            below = np.mean(magnitude < ranges.low[draw, column])
            above = np.mean(magnitude > ranges.high[draw, column])
            # Three binomial errors and a half, of 96 shares.
            assert (below, above) == pytest.approx((0.05, 0.05), abs=0.004)


@pytest.mark.evidence(reduced=True)
def test_couplings_are_judged_as_one_by_one():
    users = populations(log=True, count=200)
    omega = search_grid(0.1, 100.0, np.array([np.sqrt(1000.0)]), 0.05)
    dense = np.union1d(omega, np.geomspace(20.0, 50.0, 60))
    judge = CouplingJudge(DISPLAY, users, dense, central=0.99)
    rng = np.random.default_rng(4)
    stiffness = 500.0 * 10.0 ** rng.uniform(0.3, 2.0, 20)
    damping = rng.uniform(0.0, 40.0, 20)
    together = judge.probabilities(Coupling(stiffness, damping), users.size)
    some = slice(None, None, 1 if LONG else 3)
    alone = []
    for k, b in zip(stiffness[some], damping[some], strict=True):
        display = Display(DISPLAY.loop, WALL, Coupling(float(k), float(b)))
        evidence = feels_real(display, users, omega, central=0.99, decision=0.95)
        alone.append(evidence.probability)
    np.testing.assert_allclose(together[some], alone, atol=0.02)
    assert np.ptp(together[some]) > 0.5
    # Asked again in another order: ranges that were worked out are kept.
    again = judge.probabilities(Coupling(stiffness[::-1], damping[::-1]), users.size)
    np.testing.assert_array_equal(again[::-1], together)
